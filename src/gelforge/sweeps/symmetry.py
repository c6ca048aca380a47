"""Scenes that are their own mirror image: what a mesh adds to their forces is not, and cancels in the mean of both."""

import numpy as np

from gelforge.mechanics.scene import Scene

IMAGES = ((-1, 1), (1, -1), (-1, -1))  # signs of x and y
POINTS, REACH_MM = 4000, 12.0
LEAST_MM = 1e-6


def images_of(scene: Scene) -> list[tuple[int, int]]:
    """Those of IMAGES that take the scene's gel, body and path to themselves."""
    rng = np.random.default_rng(7)
    points = rng.uniform(-REACH_MM, REACH_MM, (POINTS, 3)) * [1.0, 1.0, 0.3]
    rotation, start = scene.press.pose(0.0, 0.0)
    _, end = scene.press.pose(1.0, 1.0)
    path = np.stack([start, end])[:, :2]

    def shape(at: np.ndarray) -> np.ndarray:
        body, _ = scene.indenter.distance((at - start) @ rotation)
        return np.concatenate([body, scene.gel.top(at[:, 0], at[:, 1])])

    own = shape(points)
    return [
        signs
        for signs in IMAGES
        if np.allclose(path * signs, path, atol=LEAST_MM)
        and np.abs(shape(points * [*signs, 1.0]) - own).max() < LEAST_MM
    ]


def image_of(cells: np.ndarray, signs: tuple[int, int]) -> np.ndarray:
    """The mirror image of cells (3, rows, columns) N along gel x, y, z; rows run along x and columns along y."""
    return cells[:, :: signs[0], :: signs[1]] * np.array([*signs, 1.0])[:, None, None]
