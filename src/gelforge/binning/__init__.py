"""Nodal forces to label grids, as one sparse matrix."""
