"""Shapes: the gel, the indenters, and where a press puts them."""
