"""Which part of the gel needs small elements under a press, from undeformed geometry alone."""

import numpy as np

from gelforge.geometry import touch
from gelforge.mechanics.mesh.hexmesh import FineBox
from gelforge.mechanics.scene import Scene

NARROW = 0.8  # of the hexahedra across a whole contact must lie across its parts
SMALLEST = 0.15  # mm, of hexahedra made smaller for a small contact
AROUND, RASTER = 0.5, 0.5  # mm of small hexahedra around what is touched, and what their box is rounded outwards to


def fine_box(scene: Scene, size: float, across: int = 0) -> FineBox:
    """Part of the gel that the press can touch, rounded outwards to RASTER so that presses share meshes.

    The undeformed surface inside the indenter anywhere on the path, and AROUND mm around it. Hexahedra
    are of `size`, or smaller where the shorter side of what is touched is under `across` hexahedra, or its parts are narrow.
    """
    points, shape = touch.under_path(scene.gel, scene.indenter, scene.press, 0.2)
    inside = touch.touched(scene.indenter, scene.press, points)
    if not inside.any():
        least = touch.gap(scene.indenter, scene.press, points, 1.0)
        inside = least <= least.min() + 1e-9
    met = points[inside, :2]
    if across:
        shorter = float(np.ptp(met, axis=0).min())
        narrow = min(
            shorter / across,
            touch.width_of(inside.reshape(shape), touch.spacing_of(points, shape)) / (NARROW * across),
        )
        size = min(size, max(SMALLEST, np.round(narrow, 2)))
    gel = scene.gel
    half = np.array([gel.width / 2, gel.length / 2])
    low = np.maximum(np.floor((met.min(axis=0) - AROUND) / RASTER) * RASTER, -half)
    high = np.minimum(np.ceil((met.max(axis=0) + AROUND) / RASTER) * RASTER, half)
    return FineBox(float(low[0]), float(high[0]), float(low[1]), float(high[1]), size)
