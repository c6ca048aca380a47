"""Which part of the path and of the gel's bricks a press concerns, from undeformed geometry alone."""

import numpy as np

from gelforge.geometry import touch
from gelforge.mechanics.hex.hexmesh import FineBox, HexMesh
from gelforge.mechanics.pose import Pose
from gelforge.mechanics.scene import Scene

NARROW = 0.8  # of the bricks across a whole contact must lie across its parts
SMALLEST = 0.15  # mm, of bricks made smaller for a small contact
AROUND, RASTER = 0.5, 0.5  # mm of small bricks around what is touched, and what their box is rounded outwards to
WITHIN = 1.0  # mm from the indenter's path within which a face may come into contact


def path_pose(scene: Scene, t: float) -> Pose:
    """Pose at path parameter t: 0 to 1 press, 1 to 2 shear; below 0 the press goes on upwards."""
    return Pose(*touch.pose_at(scene.press, t))


def first_touch(scene: Scene) -> float | None:
    """Path parameter where the indenter first meets the undeformed gel, or None where it never does."""
    return touch.first_touch(scene.gel, scene.indenter, scene.press)


def fine_box(scene: Scene, size: float, across: int = 0) -> FineBox:
    """Part of the gel that the press can touch, rounded outwards to RASTER so that presses share meshes.

    The undeformed surface inside the indenter anywhere on the path, and AROUND mm around it. Bricks
    are of `size`, or smaller where the shorter side of what is touched is under `across` bricks, or its parts are narrow.
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


def reachable_faces(scene: Scene, mesh: HexMesh) -> np.ndarray:
    """Faces whose undeformed corners come within WITHIN mm of the indenter somewhere on the path."""
    corners = mesh.nodes[mesh.faces]
    centre = corners.mean(axis=1)
    size = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    return np.flatnonzero(touch.touched(scene.indenter, scene.press, centre, WITHIN + size))


def gaps(scene: Scene, x: np.ndarray, pose: Pose) -> np.ndarray:
    """Signed distances (m,) mm of places x (m, 3) to the indenter at a pose."""
    return scene.indenter.distance(pose.to_indenter(x))[0]
