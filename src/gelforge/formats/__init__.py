"""One module per file format that others wrote or read."""
