"""By how much flat bodies lean against the gel, seen in their imprints: one side of the rim is pressed deeper.

A press is compared with the imprints that it would make at a grid of tilts, each moved to where it fits best, so that
an error of the projection does not look like a tilt. The light of a sensor shows slopes to one side more than to
another; how much is taken from its round bodies, which do not feel tilt.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gelforge.evidence.imprints import Seen, displaced

GRID_DEG = np.arange(-4.0, 4.1, 1.0)
FEWEST = 3  # flat presses from which a tilt is said
LEAST_DEG = 1.0  # least tilt that is said
SURE = 2.0  # and least tilt over its error

Expected = Callable[[Seen, tuple[float, float]], np.ndarray]  # expected map at a tilt about gel x and y, degrees


@dataclass(frozen=True)
class Leaning:
    """Tilt about gel x and y, (2,) degrees, its standard errors (2,), and from how many presses."""

    tilt: np.ndarray
    error: np.ndarray
    presses: int

    @property
    def said(self) -> bool:
        """Whether the images show a tilt."""
        size = float(np.hypot(*self.tilt))
        error = float(np.hypot(*(self.error * self.tilt)) / size) if size else 0.0
        return size >= LEAST_DEG and size >= SURE * error


def scores(seen: Seen, expected: Expected) -> np.ndarray:
    """Largest likeness of a press with its expected imprint at each tilt of the grid, (tilts x, tilts y)."""
    return np.array([[displaced(seen.measured, expected(seen, (x, y)))[0] for y in GRID_DEG] for x in GRID_DEG])


def leaning(found: Sequence[np.ndarray]) -> Leaning:
    """Tilt at which the `scores` of all presses together are largest; its error from leaving out one by one."""
    whole = np.array(found)
    best = _largest(whole.mean(axis=0))
    if len(whole) < 2:
        return Leaning(best, np.full(2, np.inf), len(whole))
    others = np.array([_largest(np.delete(whole, k, axis=0).mean(axis=0)) for k in range(len(whole))])
    error = np.sqrt((len(whole) - 1) / len(whole) * ((others - others.mean(axis=0)) ** 2).sum(axis=0))
    return Leaning(best, error, len(whole))


def _largest(score: np.ndarray) -> np.ndarray:
    """Where a map over the grid is largest, (2,) degrees, between its points by parabolas."""
    at = np.array(np.unravel_index(score.argmax(), score.shape))
    step = GRID_DEG[1] - GRID_DEG[0]
    place = GRID_DEG[at].astype(float)
    for axis in (0, 1):
        k = int(np.clip(at[axis], 1, len(GRID_DEG) - 2))
        before, middle, after = np.take(score, [k - 1, k, k + 1], axis=axis).take(at[1 - axis], axis=1 - axis)
        bend = before - 2.0 * middle + after
        if bend < 0.0:
            place[axis] = GRID_DEG[k] + step * float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0))
    return place
