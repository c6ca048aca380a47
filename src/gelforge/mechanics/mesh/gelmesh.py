"""A volume mesh of the gel, with the faces and nodes that contact and labels need."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelforge.mechanics.mesh.stepped import Cells, Hanging


@dataclass(frozen=True)
class GelMesh:
    """Gel mesh in the gel frame, undeformed, mm.

    kind: "hex8" or "tet10" (node order of CalculiX' C3D8 and C3D10).
    nodes: (n, 3) float64. elements: (e, 8 or 10) int32, zero-based.
    faces: (f, 4 or 6) int32, the surface that can be touched (all but base and side walls), corner
    nodes first and counter-clockwise seen from outside, then midside nodes (01, 12, 20).
    base: (b,) int32, nodes bonded to the sensor.
    """

    kind: str
    nodes: np.ndarray
    elements: np.ndarray
    faces: np.ndarray
    base: np.ndarray

    @cached_property
    def cells(self) -> Cells:
        """The elements that are solved."""
        return Cells.plain(self.elements)

    @cached_property
    def hanging(self) -> Hanging:
        """The nodes whose motion is interpolated from others."""
        return Hanging.none()

    @cached_property
    def unknown(self) -> np.ndarray:
        """Sorted indices (m,) of the nodes that have unknowns."""
        moves = np.ones(len(self.nodes), bool)
        moves[self.base] = moves[self.hanging.nodes] = False
        return np.flatnonzero(moves)

    @property
    def surface_nodes(self) -> np.ndarray:
        """Sorted indices of the nodes on `faces`, int."""
        return np.unique(self.faces)
