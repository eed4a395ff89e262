"""Text files of recorded motion in columns: encoding, header, titles, times, numbers."""
