"""Analytic policy gradient: learning through the differentiable plant."""
