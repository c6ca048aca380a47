"""What kind of contact a press makes, as far as geometry tells: by this, errors are charted and a solver is chosen."""

import numpy as np

from gelforge.geometry import touch
from gelforge.mechanics.scene import Scene

SPACING = 0.2  # mm between the points of the gel's top among which the overlap is found
ACROSS = 80  # points across the overlap, by which its area is counted
# The overlap of body and untouched gel grows with depth: not at all under a punch, in proportion under a ball or a
# wedge, with the square under a tip.
CURVED, POINTED = 1.5, 2.6  # area at the end of the press over that half-way down, from which contact is called so
DEEP_MM = 0.75  # overlap from which it is called deep


def contact_class(scene: Scene) -> str | None:
    """One of CLASSES, a shape (flat, curved, pointed) and a depth; None where nothing touches on the way down."""
    start = touch.first_touch(scene.gel, scene.indenter, scene.press)
    if start is None or start >= 1.0:
        return None
    growth = overlap_growth(scene, start)
    shape = "pointed" if growth > POINTED else "curved" if growth > CURVED else "flat"
    overlap = (1.0 - start) * -scene.press.dz
    return f"{shape}_{'deep' if overlap > DEEP_MM else 'shallow'}"


def overlap_growth(scene: Scene, start: float) -> float:
    """Area of the overlap at the end of the press over that half-way from first touch, at path parameter `start`."""
    points, _ = touch.under_path(scene.gel, scene.indenter, scene.press, SPACING, times=(1.0,))
    met = points[touch.touched(scene.indenter, scene.press, points, times=(1.0,))]
    if not len(met):
        return 1.0  # an edge between the points: as narrow at any depth
    low, high = met[:, :2].min(axis=0) - SPACING, met[:, :2].max(axis=0) + SPACING
    points, _ = touch.top_points(scene.gel, low, high, float((high - low).max()) / ACROSS)
    half, whole = (
        touch.touched(scene.indenter, scene.press, points, times=(t,)).sum() for t in ((start + 1.0) / 2.0, 1.0)
    )
    return float(whole / np.maximum(half, 1))
