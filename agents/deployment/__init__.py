"""Controllers and plants outside of Python: C, FMU, and a rehearsal in real time."""
