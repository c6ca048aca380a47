"""Datasets in the formats that others read, one module a format: `write(path, samples)` and what reads it back."""
