"""Which faces of the gel a press can reach, and how far points are from the indenter."""

import numpy as np

from gelforge.geometry import touch
from gelforge.mechanics.pose import Pose
from gelforge.mechanics.scene import Scene

WITHIN = 1.0  # mm from the indenter's path within which a face may come into contact


def reachable(scene: Scene, points: np.ndarray) -> np.ndarray:
    """Which faces (f,), by points (f, k, 3) mm of each, come within WITHIN mm of the indenter on its path, undeformed."""
    centre = points.mean(axis=1)
    size = np.linalg.norm(points - centre[:, None], axis=2).max(axis=1)
    return touch.touched(scene.indenter, scene.press, centre, WITHIN + size)


def gaps(scene: Scene, x: np.ndarray, pose: Pose) -> np.ndarray:
    """Signed distances (m,) mm of places x (m, 3) to the indenter at a pose."""
    return scene.indenter.distance(pose.to_indenter(x))[0]
