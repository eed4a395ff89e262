"""Figures of single subjects."""
