"""Where the indenter stands at one point of its path, and when and where a point of the gel meets it."""

from dataclasses import dataclass

import numpy as np

from gelforge.geometry.solids import Indenter


@dataclass(frozen=True)
class Pose:
    """Where the indenter's frame stands: rotation (3, 3), translation (3,) mm; points and vectors are (..., 3)."""

    rotation: np.ndarray
    translation: np.ndarray

    def to_indenter(self, points: np.ndarray) -> np.ndarray:
        """Points of the gel frame in the indenter's."""
        return (points - self.translation) @ self.rotation

    def to_gel(self, points: np.ndarray) -> np.ndarray:
        """Points of the indenter's frame in the gel's."""
        return points @ self.rotation.T + self.translation

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors of the indenter's frame in the gel's."""
        return vectors @ self.rotation.T


def touch_fraction(gap_before: np.ndarray, gap_after: np.ndarray) -> np.ndarray:
    """At which fraction of a step points cross the surface, whose gap falls evenly; 1 where it stays open."""
    crosses, open_ = gap_after < 0.0, np.maximum(gap_before, 0.0)
    return np.where(crosses, open_ / np.where(crosses, open_ - gap_after, 1.0), 1.0)


def touch_places(
    before: Pose, after: Pose, x0: np.ndarray, x1: np.ndarray, gap: np.ndarray, gap_ahead: np.ndarray
) -> np.ndarray:
    """Where points first touched on the way of one load step, in the indenter's frame (..., 3): of second order.

    x0, x1: places (..., 3) mm of the points at its start and end. gap: (...) mm at its start. gap_ahead: at its end, had the
    points moved as in the step before. A point is met where it was at a fraction of its way, not where the step left it.
    """
    begin, end = before.to_indenter(x0), after.to_indenter(x1)
    return begin + touch_fraction(gap, gap_ahead)[..., None] * (end - begin)


def on_surface(indenter: Indenter, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (m, 3) mm of the indenter's frame moved onto its surface, and its outward normal (m, 3) there."""
    for _ in range(2):  # once to get there, and once for the normal where they are then
        distance, normal = indenter.distance(places)
        places = places - distance[:, None] * normal
    return places, normal
