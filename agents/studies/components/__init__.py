"""Figures of the nonlinear parts of a table."""
