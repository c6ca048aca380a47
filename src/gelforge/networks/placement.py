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

import numpy as np

from gelforge.networks.dots import Followed, PrintedDots

LEAST_A_SIDE = 2  # dots that must agree on each of the four sides
LEAST_SEEN = 0.5  # of the pictures of a sitting in which a dot must be found
# What contact alone makes of the rim: over the 48 presses of the demo, whose gel never moved in its holder, at most
# 0.85 px of shift and 2.3 % of zoom. Less than these cannot be told from contact and is left as it is.
LEAST_SHIFT = 1.0  # px
LEAST_TURN = 0.5  # degrees
LEAST_ZOOM = 0.025


@dataclass(frozen=True)
class Consent:
    """How alike rim dots must move to be believed: `share` of them to `agrees` px, and by `beyond` times what contact makes."""

    agrees: float
    share: float
    beyond: float


# A picture of another gel of the same kind, or of another day, agrees less well: its print and its lens are others. It is
# believed where nearly all dots move much farther than contact moves them.
CONSENTS = (Consent(1.2, 0.5, 1.0), Consent(2.0, 0.88, 4.0))
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


def place(dots: PrintedDots, sitting: Sequence[Followed]) -> Placement:
    """Placement of pictures of one sitting on the untouched one, by what its dots did in each of them."""
    rim = dots.rim
    if not sitting or dots.sides.sum(axis=0).min(initial=LEAST_A_SIDE) < LEAST_A_SIDE:
        return unmoved(0.0, 0, False)
    motion = np.array([followed.motion[rim] for followed in sitting])
    kept = np.isfinite(motion[..., 0]).mean(axis=0) >= LEAST_SEEN
    end = np.full((int(rim.sum()), 2), np.nan)
    end[kept] = dots.points[rim][kept] + np.nanmedian(motion[:, kept], axis=0)
    middle = np.array(dots.grey.shape[::-1]) / 2
    return common_motion(dots.points[rim], end, kept, dots.sides[rim], middle)


def place_alone(dots: PrintedDots, followed: Followed) -> Placement:
    """Placement of a single picture, where it is beyond doubt."""
    found = place(dots, [followed])
    count, far = dots.rim.sum(), CONSENTS[-1]
    alike = found.agreeing >= SURE_SHARE * count and found.residual < SURE_RESIDUAL
    most = found.agreeing >= far.share * count and np.hypot(*found.shift) > far.beyond * LEAST_SHIFT
    sure = alike or most
    return found if sure else unmoved(found.residual, found.agreeing, False)


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
    best = unmoved(0.0, 0, False)
    if len(z) < min(consent.share for consent in CONSENTS) * len(kept):
        return best
    for consent in CONSENTS:
        a, b, agree = most_agree(z, w, consent.agrees)
        if agree.sum() < LEAST_A_SIDE:
            continue
        residual = float(np.sqrt((np.abs(a * z + b - w)[agree] ** 2).mean()))
        enough = agree.sum() >= consent.share * len(kept)
        if enough and sides[which[agree]].sum(axis=0).min() >= LEAST_A_SIDE:
            return beyond_contact(a, b, residual, int(agree.sum()), middle, consent.beyond)
        best = max(best, unmoved(residual, int(agree.sum()), False), key=lambda one: one.agreeing)
    return best


def most_agree(z: np.ndarray, w: np.ndarray, agrees: float) -> tuple[complex, complex, np.ndarray]:
    """a and b of z -> a z + b that takes most of z (n,) to within `agrees` of w (n,), all complex, and which these are."""
    first, second = np.random.default_rng(0).integers(0, len(z), (2, TRIES))
    far = np.abs(z[first] - z[second]) > np.ptp(z.real) / 2
    first, second = first[far], second[far]
    a = (w[first] - w[second]) / (z[first] - z[second])
    b = w[first] - a * z[first]
    off = np.abs(a[:, None] * z + b[:, None] - w)
    most = (off < agrees).sum(axis=1).argmax()
    agree = off[most] < agrees
    found = complex(a[most]), complex(b[most])
    for _ in range(3):
        if agree.sum() < LEAST_A_SIDE:
            break
        found = fit_similarity(z[agree], w[agree])
        agree = np.abs(found[0] * z + found[1] - w) < agrees
    return *found, agree


def beyond_contact(
    a: complex, b: complex, residual: float, agreeing: int, middle: np.ndarray, beyond: float
) -> Placement:
    """The placement of z -> a z + b about the picture's middle, without the parts that are not `beyond` times contact's."""
    shift = np.array([b.real, b.imag]) if abs(b) > beyond * LEAST_SHIFT else np.zeros(2)
    turn = float(np.degrees(np.angle(a)))
    turn = turn if abs(turn) > beyond * LEAST_TURN else 0.0
    zoom = abs(a) if abs(abs(a) - 1.0) > beyond * LEAST_ZOOM else 1.0
    cos, sin = zoom * np.cos(np.radians(turn)), zoom * np.sin(np.radians(turn))
    linear = np.array([[cos, -sin], [sin, cos]])
    matrix = np.column_stack([linear, middle - linear @ middle + shift])
    return Placement(matrix, shift, turn, float(zoom), residual, agreeing, True)


def fit_similarity(z: np.ndarray, w: np.ndarray) -> tuple[complex, complex]:
    """Least squares of w = a z + b, complex (n,)."""
    from_z, from_w = z - z.mean(), w - w.mean()
    a = np.vdot(from_z, from_w) / np.vdot(from_z, from_z)
    return complex(a), complex(w.mean() - a * z.mean())
