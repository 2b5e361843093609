"""One thin file per executable."""
