"""Recordings through the controller again: the same bits, or what would have been with other settings."""
