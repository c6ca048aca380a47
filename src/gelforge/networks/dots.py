"""The printed dots of a gel: where they rest in the untouched picture, and where they are in another one.

Light does not move dots. What they do is mechanics alone: they spread around a press and go along with a drag, on a unit
of any contrast. All together they tell whether the gel sits as it did (networks.placement).
"""

import contextlib
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.markers import LEAST_PRINT, find_blobs, lattice_of, print_pitch

ROWS, COLS = 9, 11  # of the lattice that is looked at: a GelSight Mini shows 7 x 9 dots, or fewer where it is cropped
WINDOW, LEVELS = (21, 21), 3  # of the pyramid in which dots are followed: it reaches about 40 px
HOME = 0.5  # px by which a dot that is followed there and back may miss its start
UNLIKE = 12.0  # levels by which a dot's surroundings may differ on average
RIM = 0.8  # pitches from the outermost dots inwards that still are the rim


@dataclass(frozen=True)
class Followed:
    """Dots (n,) of an untouched picture in another one: `motion` (n, 2) px, NaN where one is lost; `unlike` (n,) bool.

    A dot is lost that, followed back, does not come home. Unlike is one whose surroundings do not look as they did.
    """

    motion: np.ndarray
    unlike: np.ndarray

    @functools.cached_property
    def found(self) -> np.ndarray:
        """Which dots are not lost, (n,) bool."""
        return np.asarray(np.isfinite(self.motion[:, 0]))


@dataclass(frozen=True)
class Standing:
    """Dots that stand on a lattice: where the one nearest to the picture's middle is, (2,) px, and how all stand about it.

    points: (n,) u + i v in px from that dot. step: complex, from a dot to the next one along u, in the mean of all.
    """

    middle: np.ndarray
    points: np.ndarray
    step: complex


class PrintedDots:
    """Dots of an untouched picture (h, w, 3) uint8, as many as it shows.

    points: (n, 2) px, OpenCV's: a pixel's centre is a whole number. rim: (n,) bool, which are outermost ones. at: (n, 2) row
    and column on the lattice, whose middle place has the dot nearest to the picture's middle; -1 for one that stands on no
    lattice, or outside of ROWS x COLS.
    """

    def __init__(self, untouched: np.ndarray):
        import cv2

        self.grey = cv2.cvtColor(untouched, cv2.COLOR_RGB2GRAY)
        points, _ = find_blobs(untouched)
        low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.zeros(2))
        reach = RIM * print_pitch(points)
        self.rim = ((points < low + reach) | (points > high - reach)).any(axis=1)
        self.points = points - 0.5
        self.at = self._places()

    def _places(self) -> np.ndarray:
        at = np.full((len(self.points), 2), -1)
        if len(at) < LEAST_PRINT:
            return at
        with contextlib.suppress(BadInput):  # no print of dots, then
            index, used = lattice_of(self.points)
            middle = np.hypot(*(self.points[used] - np.array(self.grey.shape[::-1]) / 2).T).argmin()
            index = index - index[middle] + (ROWS // 2, COLS // 2)
            inside = ((index >= 0) & (index < (ROWS, COLS))).all(axis=1)
            at[used[inside]] = index[inside]
        return at

    @functools.cached_property
    def placed(self) -> np.ndarray:
        """Which dots stand on the lattice, (n,) bool."""
        return np.asarray(self.at[:, 0] >= 0)

    @functools.cached_property
    def known(self) -> bool:
        """Whether there are dots enough on a lattice to read anything from them."""
        return int(self.placed.sum()) >= LEAST_PRINT

    @functools.cached_property
    def standing(self) -> Standing:
        """The dots on the lattice, of which there is one in its middle where they are known."""
        rests, index = self.points[self.placed], self.at[self.placed] - (ROWS // 2, COLS // 2)
        middle = rests[np.flatnonzero(~index.any(axis=1))[0]]
        places, points = (pair @ np.array([1.0, 1j]) for pair in (index[:, ::-1], rests - middle))
        return Standing(middle, points, complex(np.vdot(places, points) / np.vdot(places, places)))

    def follow(self, image: np.ndarray) -> Followed:
        """The dots in an image (h, w, 3) uint8 in light and size like the untouched one."""
        import cv2

        if not len(self.points):
            return Followed(np.zeros((0, 2)), np.zeros(0, bool))
        nothing: Any = None  # no guess; OpenCV's types know no None here
        grey, start = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), self.points.astype(np.float32).reshape(-1, 1, 2)
        there, seen, unlike = cv2.calcOpticalFlowPyrLK(
            self.grey, grey, start, nothing, winSize=WINDOW, maxLevel=LEVELS
        )
        back, _, _ = cv2.calcOpticalFlowPyrLK(grey, self.grey, there, nothing, winSize=WINDOW, maxLevel=LEVELS)
        kept = (seen.ravel() > 0) & (np.hypot(*(back - start).reshape(-1, 2).T) < HOME)
        motion = np.where(kept[:, None], (there - start).reshape(-1, 2).astype(float), np.nan)
        return Followed(motion, ~kept | (unlike.ravel() > UNLIKE))

    def on_lattice(self, followed: Followed) -> np.ndarray:
        """What the dots did, on their lattice: (3, ROWS, COLS) float32.

        Motion along u and v in px, and 1 where a dot was found, 0 where there is none.
        """
        found = np.zeros((3, ROWS, COLS), np.float32)
        kept = followed.found & self.placed
        rows, cols = self.at[kept].T
        found[:2, rows, cols], found[2, rows, cols] = followed.motion[kept].T, 1.0
        return found

    def within(self, rows: slice, cols: slice) -> np.ndarray:
        """Places (ROWS, COLS) bool of the lattice whose dots rest in a window of the picture, px."""
        u, v = self.points.T
        inside = (u >= cols.start) & (u < cols.stop) & (v >= rows.start) & (v < rows.stop) & (self.at[:, 0] >= 0)
        found = np.zeros((ROWS, COLS), bool)
        found[tuple(self.at[inside].T)] = True
        return found
