"""The markers of a gel: where they are in the no-contact image, and where optical flow finds them in another picture.

Light does not move markers. What they do is mechanics alone: they spread around a press and go along with a drag, on a unit
of any contrast. All together they show whether the gel is mounted as it was (networks.uncertainty.ood).

Registration shifts a picture back whose gel was shifted in its holder since the no-contact image. The shift is the median motion
of the markers at the picture's rim, where contact does least. It is taken back as far as it exceeds what contact does there, which
grows from nothing without a jump. Turn and zoom are not fitted: contact spreads markers, which a similarity takes for zoom (on
real balls and FEATS' presses it reads forces worse than none does).
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.records.markers import LEAST_FOR_PITCH, Markers

# Of the lattice that is looked at: a GelSight Mini shows 7 x 9 markers, or fewer where it is cropped.
ROWS, COLS = 9, 11
FAR = {"winSize": (21, 21), "maxLevel": 3}  # how markers are followed: in a pyramid, which reaches about 40 px
# How a marker is looked for where it should be: in the pictures themselves, in at most five steps or till one is small.
NEAR = {"winSize": (15, 15), "maxLevel": 0, "criteria": (3, 5, 0.03)}
HOME = 0.5  # px by which a marker that is followed there and back may miss its start
ALIKE, CLOSELY = 6.0, 0.05  # levels and px within which a marker that is looked for so is surely at home
UNLIKE = 12.0  # levels by which a marker's surroundings may differ on average
RIM = 0.8  # pitches from the outermost markers inwards that still are the rim
OF_CONTACT = 2.5  # px that a contact may move the rim's markers together
LEAST_FOUND = 0.5  # of the rim's markers, that must be found


@dataclass(frozen=True)
class Tracks:
    """Markers (n,) of a no-contact image in another picture: `motion` (n, 2) px, NaN where one is lost; `unlike` (n,) bool.

    A marker is lost that, followed back, does not come home. Unlike is one whose surroundings do not look as they did.
    """

    motion: np.ndarray
    unlike: np.ndarray

    @functools.cached_property
    def found(self) -> np.ndarray:
        """Which markers are not lost, (n,) bool."""
        return np.asarray(np.isfinite(self.motion[:, 0]))


class MarkerTracker:
    """Markers of a no-contact image (h, w, 3) uint8, followed to other images.

    printed: as they were found. points: (n, 2) px, OpenCV's: a pixel's centre is a whole number. diameter: px, of a typical marker.
    rim: (n,) bool, which are outermost ones. at: (n, 2) row and column on the lattice, whose middle place has the marker nearest to
    the picture's middle; -1 for one that stands on no lattice, or outside of ROWS x COLS. on_grid: (n,) bool, which do stand there.
    known: whether these are enough to read anything from them.
    """

    def __init__(self, nocontact: np.ndarray, markers: Markers):
        import cv2

        self.grey = cv2.cvtColor(nocontact, cv2.COLOR_RGB2GRAY)
        self.printed, self.diameter = markers, markers.diameter
        points, reach = markers.points, RIM * markers.pitch
        low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.zeros(2))
        self.rim = ((points < low + reach) | (points > high - reach)).any(axis=1)
        self.points = points - 0.5
        self.at = np.full((len(points), 2), -1)
        index, used = markers.lattice if len(points) >= LEAST_FOR_PITCH else (np.zeros((0, 2), int), np.zeros(0, int))
        if len(used):
            middle = np.hypot(*(self.points[used] - np.array(self.grey.shape[::-1]) / 2).T).argmin()
            index = index - index[middle] + (ROWS // 2, COLS // 2)
            inside = ((index >= 0) & (index < (ROWS, COLS))).all(axis=1)
            self.at[used[inside]] = index[inside]
        self.on_grid = self.at[:, 0] >= 0
        self.known = int(self.on_grid.sum()) >= LEAST_FOR_PITCH

    @functools.cached_property
    def empty(self) -> np.ndarray:
        """Places of the lattice where the no-contact image shows no marker, (m, 2) px, between its outermost rows and columns."""
        index, used = self.printed.lattice if self.known else (np.zeros((0, 2), int), np.zeros(0, int))
        if not len(used):
            return np.zeros((0, 2))
        low, high = index.min(axis=0), index.max(axis=0)
        grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), -1).reshape(
            -1, 2
        )
        bare = grid[~(grid[:, None] == index[None]).all(axis=2).any(axis=1)]
        # outer markers stand wider apart, so places are cubic in row and column
        fit, *_ = np.linalg.lstsq(_cubic(index, low, high), self.points[used], rcond=None)
        return np.asarray(_cubic(bare, low, high) @ fit)

    def track(self, image: np.ndarray) -> Tracks:
        """The markers in an image (h, w, 3) uint8 in light and size like the no-contact image."""
        import cv2

        if not len(self.points):
            return Tracks(np.zeros((0, 2)), np.zeros(0, bool))
        grey, start = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), self.points.astype(np.float32)
        there, seen, unlike = _follow(self.grey, grey, start, FAR)
        kept = seen & self._home(grey, start, there, unlike)
        motion = np.where(kept[:, None], (there - start).astype(float), np.nan)
        return Tracks(motion, ~kept | (unlike > UNLIKE))

    def _home(self, grey: np.ndarray, start: np.ndarray, there: np.ndarray, unlike: np.ndarray) -> np.ndarray:
        """Which markers (n,) bool come home to where they start, (n, 2) px, if they are followed back from an image's grey.

        Most look as they did and find home by what is close around them, at a sixth of the time; the others are followed
        as they were on their way there.
        """
        home = unlike < ALIKE
        if home.any():
            back, _, _ = _follow(grey, self.grey, there[home], NEAR)
            home[home] = np.hypot(*(back - start[home]).T) < CLOSELY
        if not home.all():
            back, _, _ = _follow(grey, self.grey, there[~home], FAR)
            home[~home] = np.hypot(*(back - start[~home]).T) < HOME
        return home

    def on_lattice(self, tracks: Tracks) -> np.ndarray:
        """What the markers did, on their lattice: (3, ROWS, COLS) float32.

        Motion along u and v in px, and 1 where a marker was found, 0 where there is none.
        """
        found = np.zeros((3, ROWS, COLS), np.float32)
        kept = tracks.found & self.on_grid
        rows, cols = self.at[kept].T
        found[:2, rows, cols], found[2, rows, cols] = tracks.motion[kept].T, 1.0
        return found


def _cubic(index: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Terms (n, 6) of row and column (n, 2): 1, both, their product and their cubes, from -1 to 1 between two ends (2,)."""
    row, col = (2.0 * (index - low) / np.maximum(high - low, 1) - 1.0).T
    return np.stack([np.ones_like(row), row, col, row * col, row**3, col**3], axis=1)


def _follow(
    before: np.ndarray, after: np.ndarray, points: np.ndarray, how: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 2) float32 of one grey picture in another: where, whether at all (n,) bool, how unlike (n,) levels."""
    import cv2

    nothing: Any = None  # no guess; OpenCV's types know no None here
    there, seen, unlike = cv2.calcOpticalFlowPyrLK(before, after, points[:, None], nothing, **how)
    return there[:, 0], seen[:, 0] > 0, unlike[:, 0]


def rim_shift(markers: MarkerTracker, tracks: Tracks) -> np.ndarray:
    """Shift (2,) px along u and v that is to be taken back; 0 where the rim shows none."""
    found = markers.rim & tracks.found
    if not markers.known or found.sum() < max(1, LEAST_FOUND * markers.rim.sum()):
        return np.zeros(2)
    shift = np.median(tracks.motion[found], axis=0)
    squared = float(shift @ shift)
    return np.asarray(shift * max(0.0, 1.0 - OF_CONTACT**2 / squared) if squared > 0.0 else np.zeros(2))


def shifted_back(image: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The image (h, w, 3) uint8 as it would be seen without a shift (2,) px."""
    import cv2

    matrix = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    how = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, matrix, image.shape[1::-1], flags=how, borderMode=cv2.BORDER_REPLICATE)
