"""A running sensor: what is read of it, on a local web page, in Foxglove, as MCAP and as CSV."""
