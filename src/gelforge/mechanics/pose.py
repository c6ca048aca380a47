"""Where the indenter stands at one moment of its path, and when a point of the gel meets it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Pose:
    """Where the indenter's frame stands: rotation (3, 3), translation (3,)."""

    rotation: np.ndarray
    translation: np.ndarray

    def to_indenter(self, points: np.ndarray) -> np.ndarray:
        return (points - self.translation) @ self.rotation

    def to_gel(self, points: np.ndarray) -> np.ndarray:
        return points @ self.rotation.T + self.translation

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors of the indenter's frame in the gel's."""
        return vectors @ self.rotation.T


def touch_fraction(gap_before: np.ndarray, gap_after: np.ndarray) -> np.ndarray:
    """At which fraction of a step points cross the surface, whose gap falls evenly; 1 where it stays open."""
    crosses, open_ = gap_after < 0.0, np.maximum(gap_before, 0.0)
    return np.where(crosses, open_ / np.where(crosses, open_ - gap_after, 1.0), 1.0)
