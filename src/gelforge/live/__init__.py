"""Readings of a running sensor: on a local web page, in Foxglove, as MCAP and as CSV."""
