"""Logs of tests: one value for simulated and measured ones, and the formats of their files."""
