"""What a test will do, before it: predictive intervals, limits, which controller, which amplitude."""
