"""What kind of contact a press makes, from geometry alone: by this class errors are benchmarked and a solver is chosen."""

import numpy as np

from gelforge.flow.params.tables import CLASSES
from gelforge.geometry import touch
from gelforge.mechanics.scene import Scene

SPACING = 0.2  # mm between the points of the gel's top among which the overlap is found
ACROSS = 80  # points across the overlap, by which its area is counted
# The overlap of body and undeformed gel grows with depth: not at all under a punch, in proportion under a ball or a
# wedge, with the square under a tip.
CURVED, POINTED = 1.5, 2.6  # area at the end of the press over that half-way down, from which contact is called so
DEEP_MM = 0.75  # overlap from which it is called deep


def contact_class(scene: Scene) -> str | None:
    """One of CLASSES, a shape (flat, curved, pointed) and a depth; None where nothing touches on the way down."""
    start = touch.first_touch(scene.gel, scene.indenter, scene.press)
    if start is None or start >= 1.0:
        return None
    points, growth = _under_overlap(scene), 1.0
    if len(points):  # else an edge between the points that were looked at: as narrow at any depth
        start = _first_met(scene, points)
        half, whole = (_inside(scene, points, t) for t in ((start + 1.0) / 2.0, 1.0))
        growth = whole / max(half, 1)
    shape = (growth > CURVED) + (growth > POINTED)
    overlap = (1.0 - start) * -scene.press.dz
    return CLASSES[2 * shape + (overlap > DEEP_MM)]


def _under_overlap(scene: Scene) -> np.ndarray:
    """Points (m, 3) of the gel's top, ACROSS them each way, where body and undeformed gel overlap at the end of the press."""
    points, _ = touch.under_path(scene.gel, scene.indenter, scene.press, SPACING, times=(1.0,))
    met = points[touch.touched(scene.indenter, scene.press, points, times=(1.0,))]
    if not len(met):
        return met
    low, high = met[:, :2].min(axis=0) - SPACING, met[:, :2].max(axis=0) + SPACING
    return touch.top_points(scene.gel, low, high, float((high - low).max()) / ACROSS)[0]


def _inside(scene: Scene, points: np.ndarray, t: float) -> int:
    """How many of the points (m, 3) lie in the body at path parameter t."""
    return int(touch.touched(scene.indenter, scene.press, points, times=(t,)).sum())


def _first_met(scene: Scene, points: np.ndarray) -> float:
    """Path parameter, to a thousandth, at which the body first meets one of the points (m, 3), which it does before 1."""
    apart, met = -1.0, 1.0
    while met - apart > 1e-3:
        middle = (apart + met) / 2.0
        apart, met = (apart, middle) if _inside(scene, points, middle) else (middle, met)
    return met
