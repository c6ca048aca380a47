"""Extrapolation of the force of a press from two sizes of hexahedra, and a bound on the remaining error.

Richardson's extrapolation (1911, Phil. Trans. R. Soc. A 210, 307-357). Its order depends on the edge of contact:
where the pressure is nearly singular, the force converges linearly with the size of the hexahedra, under round bodies
quadratically. `python -m tests.benchmarks.edge_order` fits the coefficients to presses of known force.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gelforge.geometry.solids import Indenter
from gelforge.mechanics.contact.penalty import FREE, ContactState
from gelforge.mechanics.mesh.hexmesh import SMALLEST
from gelforge.mechanics.pose import Pose

BESIDE = 1.6  # distance, in spacings of contact points, within which touching and free points are at the edge
# Pressure at the edge over the mean pressure: 0.4 to ROUND under round bodies, ROUND + SINGULAR where most singular.
ROUND, SINGULAR = 1.2, 1.6
BENT = 2.0  # largest bend of a body's surface over the size of a hexahedron; more counts as this, an edge
MOST = 0.15  # largest correction as a fraction of the force: larger ones mean that the hexahedra are too coarse
# Error bounds of an uncorrected force, as fractions of it: the largest errors measured.
UNCORRECTED, UNCORRECTED_CELLS = 0.06, 0.2
# Error of the end of a path with friction that is taken over from coarse hexahedra, as a fraction of the force: 0.3 % in
# the median of the 40 presses of `make benchmark-friction`.
ARRIVAL = 0.005
POINTS = 100  # most points of the edge at which the bend of the body is evaluated
DIRECTIONS = 4  # in which the bend is evaluated
# Search for a body's surface along a vertical: start and end, mm; most steps; distance that counts as reached, mm.
LOWEST, HIGHEST, STEPS, REACHED = -0.05, 6.0, 40, 1e-3


@dataclass(frozen=True)
class Convergence:
    """Coefficients of one quality; fractions of the difference between coarse and fine force unless stated otherwise.

    smooth: for every press. small: added if hexahedra are SMALLEST wide or less. edge, corner: added in proportion to
    `Edge.singular`, and to `Edge.singular` times `Edge.bend`.
    width: fraction of the force, times `Edge.singular` and the logarithm of coarse over fine contact area.
    height: fraction of the force, times the square of a hexahedron's width over the gel's height.
    spread, floor: remaining error, as fractions of the difference and of the force.
    cells: fraction of the force at the edge of contact that acts in a wrong cell.
    """

    smooth: float
    small: float = 0.0
    edge: float = 0.0
    corner: float = 0.0
    width: float = 0.0
    height: float = 0.0
    spread: float = 0.2
    floor: float = 0.004
    cells: float = 0.45

    def correction(self, edge: "Edge", coarse: "Coarse", force: float) -> float:
        """Relative excess of the force (N) on fine hexahedra over the true one, within -MOST to MOST."""
        difference = coarse.force / force - 1.0
        share = (
            self.smooth + self.small * (edge.size <= SMALLEST) + edge.singular * (self.edge + self.corner * edge.bend)
        )
        area = np.log(coarse.area / edge.area) if coarse.area > 0.0 else 0.0
        found = share * difference + self.width * edge.singular * area + self.height * (edge.size / edge.height) ** 2
        return float(np.clip(found, -MOST, MOST))

    def error(self, coarse: "Coarse", force: float, frictional: bool) -> float:
        """Bound on the remaining relative error of the corrected force; frictional: of a press that may slip."""
        return self.spread * abs(coarse.force / force - 1.0) + self.floor + ARRIVAL * frictional


@dataclass(frozen=True)
class Coarse:
    """A press on coarse hexahedra: magnitude of the force, N, and area of contact, mm^2."""

    force: float
    area: float


@dataclass(frozen=True)
class Edge:
    """The edge of contact on fine hexahedra.

    singular: 0 as under round bodies, 1 where the pressure at the edge is most concentrated. near: fraction of the
    force at the edge. bend: of the body's surface at the edge, over the size of a hexahedron (see `_bend`). area: of
    contact, mm^2. size: of the hexahedra, mm. height: of the gel, mm.
    """

    singular: float
    near: float
    bend: float
    area: float
    size: float
    height: float


def edge_of(contact: ContactState, indenter: Indenter, pose: Pose, size: float, height: float) -> Edge | None:
    """The edge of a solved contact; None if all points touch, none does, none is at an edge, or the total pulls."""
    on = contact.status != FREE
    if not on.any() or on.all():
        return None
    push = -contact.traction[:, 2] * contact.weights
    places = contact.reference[:, :2]
    beside = BESIDE * float(np.sqrt(np.median(contact.weights[on])))
    apart, nearest = cKDTree(places[on]).query(places[~on])
    outside = apart < beside
    at_edge = cKDTree(places[~on]).query(places[on])[0] < beside
    area, whole = contact.weights[on], float(push[on].sum())
    if whole <= 0.0 or not outside.any() or not at_edge.any():
        return None
    near = float(push[on][at_edge].sum()) / whole
    pressure = near / (float(area[at_edge].sum()) / float(area.sum()))
    middle = (contact.position[~on][outside] + contact.position[on][nearest[outside]]) / 2
    middle = middle[:: len(middle) // POINTS + 1]
    bend = float(_bend(indenter, pose.to_indenter(middle)[:, :2], size).mean())
    singular = float(np.clip((pressure - ROUND) / SINGULAR, 0.0, 1.0))
    return Edge(singular, near, bend, float(area.sum()), size, height)


def _bend(indenter: Indenter, xy: np.ndarray, size: float) -> np.ndarray:
    """Bend (n,) of a body's lower surface at xy (n, 2) of its frame: second difference over `size` mm by `size`."""
    here = _lowest(indenter, xy)
    found = []
    for angle in np.arange(DIRECTIONS) * np.pi / DIRECTIONS:
        way = size * np.array([np.cos(angle), np.sin(angle)])
        sides = [np.minimum(_lowest(indenter, xy + at) - here, BENT * size) for at in (way, -way)]
        found.append(np.sum(sides, axis=0) / size)
    return np.clip(np.max(found, axis=0), 0.0, BENT)


def _lowest(indenter: Indenter, xy: np.ndarray) -> np.ndarray:
    """Height (n,) mm of the body's lower surface at xy (n, 2) of its frame, HIGHEST at most; by sphere tracing."""
    z = np.full(len(xy), LOWEST)
    rising = np.arange(len(xy))
    for _ in range(STEPS):
        distance, _ = indenter.distance(np.column_stack([xy[rising], z[rising]]))
        z[rising] += np.maximum(distance, 0.0)
        rising = rising[(distance > REACHED) & (z[rising] < HIGHEST)]
        if not len(rising):
            break
    return np.minimum(z, HIGHEST)
