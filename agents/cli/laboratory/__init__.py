"""Commands of the laboratory's loop."""
