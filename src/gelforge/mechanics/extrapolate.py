"""What two sizes of hexahedra together say of a press: the force that is exact, and how far off it may be.

Richardson's extrapolation (1911, Phil. Trans. R. Soc. A 210, 307-357), whose order follows the edge of contact: where the
pressure is nearly singular there, force converges with the size of the hexahedra, under round bodies with its square. The
numbers of a quality are fitted to presses of known force by `python -m tests.benchmarks.edge_order`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gelforge.geometry.solids import Indenter
from gelforge.mechanics.contact.penalty import FREE, ContactState
from gelforge.mechanics.mesh.hexmesh import SMALLEST
from gelforge.mechanics.pose import Pose

BESIDE = 1.6  # spacings of the contact's points, within which one that touches is at the edge
# Pressure at the edge over the mean one: 0.4 to 1.2 under round bodies, and this much more where it is most singular.
ROUND, SINGULAR = 1.2, 1.6
BENT = 2.0  # that a body's surface bends at most over the size of a hexahedron: by more it is an edge
MOST = 0.15  # of the force by which it may be corrected: where more is asked for, the hexahedra are too coarse to say anything
UNCORRECTED, UNCORRECTED_CELLS = (
    0.06,
    0.2,
)  # of the force that an uncorrected one may be off: the largest errors that were measured
POINTS = 100  # of the edge at which the body's curvature is looked at
DIRECTIONS = 4  # in which it may be bent there
# Of the search for a body's surface along a vertical: where it begins and ends, its steps, and how near counts, mm.
LOWEST, HIGHEST, STEPS, REACHED = -0.05, 6.0, 40, 1e-3


@dataclass(frozen=True)
class Convergence:
    """Numbers of one quality, as shares of the difference between coarse and fine force if not said otherwise.

    smooth: at any edge of contact. small: added where hexahedra were made as small as they may be for a small contact.
    edge: added in proportion to how singular the pressure is at the edge. corner: the same, times how sharply the body
    bends there. width: of the force, by the logarithm of coarse over fine contact area where the pressure is singular.
    height: of the force, by the square of a hexahedron's width over the gel's height.
    spread, floor: of the difference, and of the force, that is left. cells: of the force at the edge of contact that lies in
    another cell than it should.
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
        """Share of the force (N) on fine hexahedra by which it is too large."""
        difference = coarse.force / force - 1.0
        share = (
            self.smooth + self.small * (edge.size <= SMALLEST) + edge.singular * (self.edge + self.corner * edge.bend)
        )
        area = np.log(coarse.area / edge.area) if coarse.area > 0.0 else 0.0
        found = share * difference + self.width * edge.singular * area + self.height * (edge.size / edge.height) ** 2
        return float(np.clip(found, -MOST, MOST))

    def error(self, coarse: "Coarse", force: float) -> float:
        """Share of the force by which the corrected one may still be off."""
        return self.spread * abs(coarse.force / force - 1.0) + self.floor


@dataclass(frozen=True)
class Coarse:
    """A press on coarse hexahedra: size of the force, N, and area of contact, mm^2."""

    force: float
    area: float


@dataclass(frozen=True)
class Edge:
    """The edge of contact on fine hexahedra.

    singular: 0 where the pressure vanishes there, 1 where it is most concentrated. near: share of the force that acts there.
    bend: how much the body's surface bends over the size of a hexahedron there. area: of contact, mm^2. size: of the
    hexahedra, and height: of the gel, mm.
    """

    singular: float
    near: float
    bend: float
    area: float
    size: float
    height: float


def edge_of(contact: ContactState, indenter: Indenter, pose: Pose, size: float, height: float) -> Edge | None:
    """The edge of a solved contact; None where all points touch, none does, or what they bear does not press."""
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
    """How much a body's lower surface bends at places (n, 2) of its frame: its second difference over `size` mm, in its units."""
    here = _lowest(indenter, xy)
    found = []
    for angle in np.arange(DIRECTIONS) * np.pi / DIRECTIONS:
        way = size * np.array([np.cos(angle), np.sin(angle)])
        sides = [np.minimum(_lowest(indenter, xy + at) - here, BENT * size) for at in (way, -way)]
        found.append(np.sum(sides, axis=0) / size)
    return np.clip(np.max(found, axis=0), 0.0, BENT)


def _lowest(indenter: Indenter, xy: np.ndarray) -> np.ndarray:
    """Height (n,) mm at which the body begins above places (n, 2) of its frame, at most HIGHEST; by sphere tracing."""
    z = np.full(len(xy), LOWEST)
    rising = np.arange(len(xy))
    for _ in range(STEPS):
        distance, _ = indenter.distance(np.column_stack([xy[rising], z[rising]]))
        z[rising] += np.maximum(distance, 0.0)
        rising = rising[(distance > REACHED) & (z[rising] < HIGHEST)]
        if not len(rising):
            break
    return np.minimum(z, HIGHEST)
