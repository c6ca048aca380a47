"""How far the printed dots of a gel have moved, on their lattice, as a reader of dots is given it.

Light does not move dots. What they do is mechanics alone: they spread around a press and go along with a drag, on a unit
of any contrast. So they tell total force where brightness misleads, and tell when it does.
"""

import contextlib

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.placement import follow_dots
from gelforge.records.markers import LEAST_PRINT, find_blobs, lattice_of

ROWS, COLS = 9, 11  # of the lattice that is looked at: a GelSight Mini shows 7 x 9 dots, or fewer where it is cropped


class PrintedDots:
    """Dots of an untouched picture (h, w, 3) uint8: `at` (n, 2) row and column, `points` (n, 2) px; none where it has no print.

    The dot nearest to the picture's middle has the lattice's middle place.
    """

    def __init__(self, untouched: np.ndarray):
        import cv2

        self.grey = cv2.cvtColor(untouched, cv2.COLOR_RGB2GRAY)
        points, _ = find_blobs(untouched)
        index, used = np.zeros((0, 2), int), np.zeros(0, int)
        if len(points) >= LEAST_PRINT:
            with contextlib.suppress(BadInput):  # no print of dots, then
                index, used = lattice_of(points)
        points = points[used].reshape(-1, 2)
        if len(points):
            middle = np.hypot(*(points - np.array(self.grey.shape[::-1]) / 2).T).argmin()
            index = index - index[middle] + (ROWS // 2, COLS // 2)
        inside = ((index >= 0) & (index < (ROWS, COLS))).all(axis=1)
        self.at, self.points = index[inside], points[inside]

    @property
    def known(self) -> bool:
        """Whether there are dots enough to read anything from them."""
        return len(self.points) >= LEAST_PRINT

    def motion(self, image: np.ndarray) -> np.ndarray:
        """What the dots did in an image (h, w, 3) uint8 in light, size and place like the untouched one: (3, ROWS, COLS) float32.

        Motion along u and v in px, and 1 where a dot was found, 0 where there is none.
        """
        found = np.zeros((3, ROWS, COLS), np.float32)
        if self.known:
            moved = follow_dots(self.grey, self.points, image) - (self.points - 0.5)
            kept = np.isfinite(moved[:, 0])
            rows, cols = self.at[kept].T
            found[:2, rows, cols], found[2, rows, cols] = moved[kept].T, 1.0
        return found

    def within(self, rows: slice, cols: slice) -> np.ndarray:
        """Places (ROWS, COLS) bool of the lattice whose dots rest in a window of the picture, px."""
        u, v = self.points.T
        inside = (u >= cols.start) & (u < cols.stop) & (v >= rows.start) & (v < rows.stop)
        found = np.zeros((ROWS, COLS), bool)
        found[tuple(self.at[inside].T)] = True
        return found
