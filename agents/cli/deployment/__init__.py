"""Commands that take controllers out of Python."""
