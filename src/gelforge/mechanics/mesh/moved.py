"""A tetrahedral mesh whose fine part is moved under the press: its elements stay, its nodes go along and around it.

Meshing takes longer than a solve, and a fine part that holds every place of a press has several times the elements of one
that holds the press alone. So one mesh with its fine part in the middle serves presses beside it.
"""

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import EDGES, jacobians, scaled_jacobians, volumes

RASTER_MM = 0.5  # that the fine part is moved by: presses share meshes, and what is kept for each
ROUNDING_MM = 1e-9  # by which two lengths that are one may differ
NARROWEST = 0.3  # of its width may be left of what lies between the fine part and the rim
# Of its volume that every element keeps at least. It is that within its bowed edges: under the rim's fall the straight
# edges between corners may cross where the element itself is sound.
SOUND = 0.05
# Least scaled Jacobian of any element: bowed edges can invert one whose corners still span a volume.
LEAST_JACOBIAN = 0.1
# Where the fine part lies farthest out, in shares of its reach: towards each corner of the gel, and each side.
ENDS = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]


def reach(mesh: GelMesh, gel: Gel, half: tuple[float, float]) -> tuple[float, float]:
    """How far (x, y) the fine part of half extents `half` can go either way and leave every element sound, mm."""
    before = volumes(jacobians(mesh.nodes, mesh.elements))
    limits = farthest(gel, half)
    for back in range(max(limits)):
        x, y = (max(0, limit - back) for limit in limits)
        ends = (moved(mesh, gel, half, (a * x, b * y)) for a, b in ENDS)
        if all(sound(end, before) for end in ends):
            return float(x), float(y)
    return 0.0, 0.0


def farthest(gel: Gel, half: tuple[float, float]) -> tuple[int, int]:
    """Whole mm (x, y) beyond which no mesh's fine part of half extents `half` goes: what is left beside it gets too narrow."""
    sides = zip((gel.width, gel.length), half, strict=True)
    x, y = (max(0, int((1.0 - NARROWEST) * (size / 2 - part))) for size, part in sides)
    return x, y


def sound(mesh: GelMesh, before: np.ndarray) -> bool:
    """Whether each element keeps enough of its volume, `before` (e,) mm^3, and is far from inverted."""
    dets = jacobians(mesh.nodes, mesh.elements)
    return bool((volumes(dets) > SOUND * before).all() and (scaled_jacobians(dets) > LEAST_JACOBIAN).all())


def way_to(low: float, high: float, half: float, reach: float) -> float | None:
    """How far the fine part (-half, half) goes to hold (low, high), all mm; None where it would be farther than `reach`.

    0 where it holds it as it lies; else the nearest multiple of RASTER_MM. What sticks out by rounding alone counts as held.
    """
    beyond = high - half if high > half else min(low + half, 0.0)
    # no minus before zero: the way is part of a mesh's name
    way = float(np.copysign(np.ceil((abs(beyond) - ROUNDING_MM) / RASTER_MM) * RASTER_MM, beyond)) + 0.0
    holds = -half + way <= low + ROUNDING_MM and high - ROUNDING_MM <= half + way
    return way if holds and abs(way) <= reach else None


def moved(mesh: GelMesh, gel: Gel, half: tuple[float, float], way: tuple[float, float]) -> GelMesh:
    """The mesh with its fine part, half extents `half` (x, y) mm, moved by `way` (x, y) mm; heights go with the gel's top."""
    flat = np.column_stack([
        _along(mesh.nodes[:, axis], size / 2, half[axis], way[axis]) for axis, size in enumerate((gel.width, gel.length))
    ])  # fmt: skip
    ends, middle = mesh.elements[:, :4][:, EDGES], mesh.elements[:, 4:]
    bowed = mesh.nodes[middle, :2] - mesh.nodes[ends, :2].mean(axis=2)
    flat[middle] = flat[ends].mean(axis=2) + bowed
    before, after = (np.asarray(gel.top(*places.T)) + gel.height for places in (mesh.nodes[:, :2], flat))
    z = (mesh.nodes[:, 2] + gel.height) * after / before - gel.height
    return GelMesh(mesh.kind, np.column_stack([flat, z]), mesh.elements, mesh.faces, mesh.base)


def _along(places: np.ndarray, rim: float, half: float, way: float) -> np.ndarray:
    """Places along one side of the gel: the fine part as it is, what lies beside it narrower or wider, the rim where it was."""
    return np.interp(places, [-rim, -half, half, rim], [-rim, -half + way, half + way, rim])
