"""Finite element contact mechanics: computes nodal forces, with diagnostics, from scenes."""
