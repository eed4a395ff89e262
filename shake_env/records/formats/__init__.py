"""Readers of the formats of strong-motion networks and of binary files, one module each."""
