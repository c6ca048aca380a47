"""Pose of the indenter at one point of its path, and when and where a point of the gel touches it."""

from dataclasses import dataclass

import numpy as np

from gelforge.geometry.solids import Indenter


@dataclass(frozen=True)
class Pose:
    """Pose of the indenter's frame: rotation (3, 3), translation (3,) mm; points and vectors are (..., 3)."""

    rotation: np.ndarray
    translation: np.ndarray

    def to_indenter(self, points: np.ndarray) -> np.ndarray:
        """Points of the gel frame, in the indenter's frame."""
        return (points - self.translation) @ self.rotation

    def to_gel(self, points: np.ndarray) -> np.ndarray:
        """Points of the indenter's frame, in the gel frame."""
        return points @ self.rotation.T + self.translation

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors of the indenter's frame, in the gel frame."""
        return vectors @ self.rotation.T


def touch_fraction(gap_before: np.ndarray, gap_after: np.ndarray) -> np.ndarray:
    """Fraction of a step at which points reach the surface if their gap falls linearly; 1 where it stays open."""
    crosses, open_ = gap_after < 0.0, np.maximum(gap_before, 0.0)
    return np.where(crosses, open_ / np.where(crosses, open_ - gap_after, 1.0), 1.0)


def touch_places(
    before: Pose, after: Pose, x0: np.ndarray, x1: np.ndarray, gap: np.ndarray, gap_ahead: np.ndarray
) -> np.ndarray:
    """Where points first touched within one load step, in the indenter's frame (..., 3); second-order accurate.

    x0, x1: positions (..., 3) mm of the points at its start and end. gap: (...) mm at its start. gap_ahead: gap at
    its end if the points had moved as in the step before. A point touches part of the way through, not at the end.
    """
    begin, end = before.to_indenter(x0), after.to_indenter(x1)
    return begin + touch_fraction(gap, gap_ahead)[..., None] * (end - begin)


def on_surface(indenter: Indenter, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, 3) mm of the indenter's frame projected onto its surface, and its outward normal (m, 3) there."""
    for _ in range(2):  # the second pass gives the normal at the projected point
        distance, normal = indenter.distance(places)
        places = places - distance[:, None] * normal
    return places, normal
