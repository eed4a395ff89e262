"""Compiled repeats of the dynamics, for numba; never the reference. Imported on first use."""
