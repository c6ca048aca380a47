"""A running sensor: what it reads, on a local web page, in files, and in recordings that can be replayed."""
