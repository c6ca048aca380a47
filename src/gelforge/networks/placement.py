"""Pictures laid onto an untouched one of another day, where the gel sat or was seen otherwise.

A gel that was taken out and put back, or a driver that crops otherwise, moves every dot alike: by a shift, a turn and
a zoom. Contact moves dots too, but most where it touches and least at the rim, where the gel is held. So the rim's dots
tell a placement, and only where they agree on all four sides. How a gel sits is the same in all pictures of one
sitting, what contact does is not: the middle of what each dot does over many pictures tells more than any one of them.
A single picture is moved only where nearly all of the rim did the same: contact drags its dots by more than a pixel, too,
but each by something else, and what is taken back of that is sideways force.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.records.markers import find_blobs, print_pitch

WINDOW, LEVELS = (21, 21), 3  # of the pyramid in which dots are followed: it reaches about 40 px
GLANCE = (15, 15)  # px around a dot that are looked for in a hurry
UNLIKE = 12.0  # levels by which these may differ on average
HOME = 0.5  # px by which a dot that is followed there and back may miss its start
RIM = 0.8  # pitches from the outermost dots inwards that still are the rim
AGREES = 1.2  # px by which a rim dot may stand off the common motion
LEAST_A_SIDE = 2  # dots that must agree on each of the four sides
LEAST_SEEN = 0.5  # of the pictures of a sitting in which a dot must be found
LEAST_SHARE = 0.5  # of the rim's dots that must agree
# What contact alone makes of the rim: over the 48 presses of the demo, whose gel never moved in its holder, at most
# 0.85 px of shift and 2.3 % of zoom. Less than these cannot be told from contact and is left as it is.
LEAST_SHIFT = 1.0  # px
LEAST_TURN = 0.5  # degrees
LEAST_ZOOM = 0.025
# A single picture: of 500 presses of the rig whose gels sat still, a quarter of them by things larger than the view, 6 %
# moved half of the rim alike, 1.2 % did so within these; of the same pictures shifted by 2 px 58 % are put right.
SURE_SHARE, SURE_RESIDUAL = 0.6, 0.6  # of the rim's dots; px
TRIES = 200  # pairs of rim dots that a common motion is sought from


@dataclass(frozen=True)
class Placement:
    """Where the untouched picture's points lie in another one: point -> matrix @ (u, v, 1), matrix (2, 3).

    shift: (2,) px of the picture's middle along u and v; turn: degrees, positive from u towards v; zoom: factor.
    residual: px that agreeing dots are off by, root mean square. agreeing: their number. known: False where the rim does not
    tell; then nothing is moved.
    """

    matrix: np.ndarray
    shift: np.ndarray
    turn: float
    zoom: float
    residual: float
    agreeing: int
    known: bool

    @property
    def told(self) -> str:
        """What was put right, as a person reads it; empty where nothing was."""
        if np.array_equal(self.matrix, UNMOVED):
            return ""
        return (
            f"({self.shift[0]:+.1f}, {self.shift[1]:+.1f}) px aside, {self.turn:+.1f} degrees turned, {self.zoom:.3f}"
            f" times as large, told by {self.agreeing} dots to {self.residual:.1f} px"
        )

    def undo(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3) uint8 as it would be seen from where the untouched one was taken."""
        import cv2

        if not self.known or np.array_equal(self.matrix, UNMOVED):
            return image
        how = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(image, self.matrix, image.shape[1::-1], flags=how, borderMode=cv2.BORDER_REPLICATE)


UNMOVED = np.eye(2, 3)


def unmoved(residual: float, agreeing: int, known: bool) -> Placement:
    """A placement that moves nothing."""
    return Placement(UNMOVED, np.zeros(2), 0.0, 1.0, residual, agreeing, known)


class RestingDots:
    """Rim dots of an untouched picture (h, w, 3) uint8."""

    def __init__(self, untouched: np.ndarray):
        import cv2

        dots, _ = find_blobs(untouched)
        self.grey = cv2.cvtColor(untouched, cv2.COLOR_RGB2GRAY)
        low, high = (dots.min(axis=0), dots.max(axis=0)) if len(dots) else (np.zeros(2), np.zeros(2))
        reach = RIM * print_pitch(dots)
        self.sides = np.column_stack([dots < low + reach, dots > high - reach])
        rim = self.sides.any(axis=1)
        self.dots, self.sides = dots[rim], self.sides[rim]

    def place(self, images: Sequence[np.ndarray]) -> Placement:
        """Placement of pictures (h, w, 3) uint8 of one sitting, in light and size like the untouched one."""
        if not images or self.sides.sum(axis=0).min(initial=LEAST_A_SIDE) < LEAST_A_SIDE:
            return unmoved(0.0, 0, False)
        ends = np.array([follow_dots(self.grey, self.dots, image) for image in images])
        kept = np.isfinite(ends[..., 0]).mean(axis=0) >= LEAST_SEEN
        end = np.full(self.dots.shape, np.nan)
        end[kept] = np.nanmedian(ends[:, kept], axis=0)
        middle = np.array(self.grey.shape[::-1]) / 2
        return common_motion(self.dots - 0.5, end, kept, self.sides, middle)

    def place_alone(self, image: np.ndarray) -> Placement:
        """Placement of a single picture (h, w, 3) uint8, in light and size like the untouched one, where it is beyond doubt."""
        found = self.place([image])
        sure = found.agreeing >= SURE_SHARE * len(self.dots) and found.residual < SURE_RESIDUAL
        return found if sure else unmoved(found.residual, found.agreeing, False)

    def glance(self, image: np.ndarray) -> tuple[float, float]:
        """How far half of the rim's dots have moved at least in a picture, px, and what share of them it does not show.

        Quick and rough: a dot counts as lost where its surroundings do not look as they did.
        """
        import cv2

        if not len(self.dots):
            return 0.0, 0.0
        nothing: Any = None
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        start = (self.dots - 0.5).astype(np.float32).reshape(-1, 1, 2)
        found, seen, unlike = cv2.calcOpticalFlowPyrLK(self.grey, grey, start, nothing, winSize=GLANCE, maxLevel=1)
        moved = np.hypot(*(found - start).reshape(-1, 2).T)
        lost = (seen.ravel() == 0) | (unlike.ravel() > UNLIKE)
        return float(np.median(moved)), float(lost.mean())


def follow_dots(rest: np.ndarray, dots: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Where dots (n, 2) px of a grey picture at rest are in an image (h, w, 3) uint8, (n, 2) px as OpenCV counts them.

    NaN for one that, followed back, does not come home.
    """
    import cv2

    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    nothing: Any = None  # no guess; OpenCV's types know no None here
    start = (dots - 0.5).astype(np.float32).reshape(-1, 1, 2)
    found, seen, _ = cv2.calcOpticalFlowPyrLK(rest, grey, start, nothing, winSize=WINDOW, maxLevel=LEVELS)
    back, _, _ = cv2.calcOpticalFlowPyrLK(grey, rest, found, nothing, winSize=WINDOW, maxLevel=LEVELS)
    kept = (seen.ravel() > 0) & (np.hypot(*(back - start).reshape(-1, 2).T) < HOME)
    return np.where(kept[:, None], found.reshape(-1, 2).astype(float), np.nan)


def common_motion(start, end, kept, sides, middle) -> Placement:
    """The shift, turn and zoom that most dots share, if they do so on all sides.

    start, end: (n, 2) px; kept: (n,) which were found; sides: (n, 4) which of the four sides each belongs to; middle:
    (2,) of the picture. Similarities are complex numbers, z -> a z + b: two dots give one, the one that most agree with is
    fitted again to these (random sample consensus: Fischler and Bolles 1981, Commun. ACM 24, 381-395; pairs here are
    drawn from a fixed seed).
    """
    which = np.flatnonzero(kept)
    z, w = (np.asarray(points)[which] @ np.array([1.0, 1j]) for points in (start, end))
    z = z - complex(*middle)
    w = w - complex(*middle)
    if len(z) < LEAST_SHARE * len(kept):
        return unmoved(0.0, 0, False)
    first, second = np.random.default_rng(0).integers(0, len(z), (2, TRIES))
    far = np.abs(z[first] - z[second]) > np.ptp(z.real) / 2
    first, second = first[far], second[far]
    a = (w[first] - w[second]) / (z[first] - z[second])
    b = w[first] - a * z[first]
    off = np.abs(a[:, None] * z + b[:, None] - w)
    agree = off[(off < AGREES).sum(axis=1).argmax()] < AGREES
    for _ in range(3):
        a, b = fit_similarity(z[agree], w[agree])
        agree = np.abs(a * z + b - w) < AGREES
        if agree.sum() < 2:
            return unmoved(0.0, 0, False)
    residual = float(np.sqrt((np.abs(a * z + b - w)[agree] ** 2).mean()))
    enough = agree.sum() >= LEAST_SHARE * len(kept) and sides[which[agree]].sum(axis=0).min() >= LEAST_A_SIDE
    if not enough:
        return unmoved(residual, int(agree.sum()), False)
    return beyond_contact(a, b, residual, int(agree.sum()), middle)


def beyond_contact(a: complex, b: complex, residual: float, agreeing: int, middle: np.ndarray) -> Placement:
    """The placement of z -> a z + b about the picture's middle, without the parts that contact could have made."""
    shift = np.array([b.real, b.imag]) if abs(b) > LEAST_SHIFT else np.zeros(2)
    turn = float(np.degrees(np.angle(a)))
    turn = turn if abs(turn) > LEAST_TURN else 0.0
    zoom = abs(a) if abs(abs(a) - 1.0) > LEAST_ZOOM else 1.0
    cos, sin = zoom * np.cos(np.radians(turn)), zoom * np.sin(np.radians(turn))
    linear = np.array([[cos, -sin], [sin, cos]])
    matrix = np.column_stack([linear, middle - linear @ middle + shift])
    return Placement(matrix, shift, turn, float(zoom), residual, agreeing, True)


def fit_similarity(z: np.ndarray, w: np.ndarray) -> tuple[complex, complex]:
    """Least squares of w = a z + b, complex (n,)."""
    from_z, from_w = z - z.mean(), w - w.mean()
    a = np.vdot(from_z, from_w) / np.vdot(from_z, from_z)
    return complex(a), complex(w.mean() - a * z.mean())
