"""One external file format per module, returning domain values."""
