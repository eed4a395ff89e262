"""Transient responses against physical ranges; reduction of the closed loop."""
