"""Base meshes where stages read them, made once in a process."""

from gelforge.flow.layout import Layout
from gelforge.geometry.gel import USUAL_GEL, load_gel
from gelforge.mechanics.mesh.basemesh import base_of


def place_mesh(of: Layout, gel: str = USUAL_GEL) -> None:
    """Write a gel's base mesh where stage 20 does."""
    base_of(load_gel(gel)).write(of.mesh(gel))
