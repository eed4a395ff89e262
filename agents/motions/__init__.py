"""Recorded motions on the command line: channels, spectra, figures."""
