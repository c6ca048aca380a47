"""Extrapolation of the force of a press from two sizes of hexahedra, and a bound on the remaining error.

Richardson's extrapolation (1911, Phil. Trans. R. Soc. A 210, 307-357). Its order depends on the edge of contact:
where the pressure is nearly singular, the force converges linearly with the size of the hexahedra, under round bodies
quadratically. `python -m tests.benchmarks.edge_order` fits the coefficients to presses of known force.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gelforge.mechanics.contact.penalty import FREE, ContactState
from gelforge.mechanics.mesh.hexmesh import SMALLEST

BESIDE = 1.6  # distance, in spacings of contact points, within which touching and free points are at the edge
MOST = 0.15  # largest correction as a fraction of the force: larger ones mean that the hexahedra are too coarse
# Error bounds of an uncorrected force, as fractions of it: the largest errors measured.
UNCORRECTED, UNCORRECTED_CELLS = 0.06, 0.2
# Error of the end of a path with friction that is taken over from coarse hexahedra, as a fraction of the force: 0.3 % in
# the median of the 40 presses of `make benchmark-friction`.
ARRIVAL = 0.005


@dataclass(frozen=True)
class Convergence:
    """Coefficients of one quality; fractions of the difference between coarse and fine force unless stated otherwise.

    smooth: for every press. small: added if hexahedra are SMALLEST wide or less. edge: added in proportion to
    `Edge.sharp`.
    height: fraction of the force, times the square of a hexahedron's width over the gel's height.
    spread, floor: remaining error, as fractions of the difference and of the force. doubt: added to spread in proportion to
    `Edge.sharp`: straight sharp edges along and across the mesh lines differ.
    cells: fraction of the force at the edge of contact that acts in a wrong cell.
    """

    smooth: float
    small: float = 0.0
    edge: float = 0.0
    height: float = 0.0
    spread: float = 0.2
    doubt: float = 0.0
    floor: float = 0.004
    cells: float = 0.45

    def correction(self, edge: "Edge", difference: float) -> float:
        """Relative excess of the force on fine hexahedra over the true one, within -MOST to MOST.

        difference: force on coarse over that on fine hexahedra, less 1.
        """
        share = self.smooth + self.small * (edge.size <= SMALLEST) + self.edge * edge.sharp
        found = share * difference + self.height * (edge.size / edge.height) ** 2
        return float(np.clip(found, -MOST, MOST))

    def error(self, edge: "Edge", difference: float, frictional: bool) -> float:
        """Bound on the remaining relative error of the corrected force; frictional: of a press that may slip."""
        return (self.spread + self.doubt * edge.sharp) * abs(difference) + self.floor + ARRIVAL * frictional


@dataclass(frozen=True)
class Edge:
    """The edge of contact on fine hexahedra.

    sharp: see `hexmesh.sharpness`. near: fraction of the force at the edge. size: of the hexahedra, mm. height: of the
    gel, mm.
    """

    sharp: float
    near: float
    size: float
    height: float


def edge_of(contact: ContactState, sharp: float, size: float, height: float) -> Edge | None:
    """The edge of a solved contact; None if all points touch, none does, none is at an edge, or the total pulls."""
    on = contact.status != FREE
    if not on.any() or on.all():
        return None
    push = -contact.traction[on, 2] * contact.weights[on]
    places, whole = contact.reference[:, :2], float(push.sum())
    beside = BESIDE * float(np.sqrt(np.median(contact.weights[on])))
    at_edge = cKDTree(places[~on]).query(places[on])[0] < beside
    if whole <= 0.0 or not at_edge.any():
        return None
    return Edge(sharp, float(push[at_edge].sum()) / whole, size, height)
