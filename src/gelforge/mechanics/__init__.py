"""Finite element contact mechanics: scenes in, nodal forces and their evidence out."""
