"""A pair of pictures as networks read it: under one light, and at the scale of those that they learnt from.

Light drifts between the two pictures of a pair: lamps warm up, a camera sets its exposure anew, a press shades the whole
gel. A network that reads differences takes that for force. What does not touch tells the drift: most of the picture
changes by one gain and one offset a colour, and where something touches it changes otherwise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput

SMALL = (40, 30)  # width and height in px at which light is compared: dots and noise average out
ROUNDS = 20  # at most of iteratively reweighted least squares; four are usual
ENDS = np.array([[0.0], [255.0]])  # levels between which all others lie
SETTLED = 0.02  # levels by which a round still changes what light makes of them, where another one is needless
LEAST_SCALE = 1.5  # levels that a place may differ by through noise alone
REACH = (
    3.0  # scales beyond which a place has no say (Tukey's biweight: Beaton and Tukey 1974, Technometrics 16, 147-185)
)
TIED = 4.0  # levels squared of contrast below which a gain is hardly told from an offset, and taken for 1
LEAST_SHARE = 0.25  # of the picture that must agree, or nothing tells what the light does
DARK, BRIGHT = 4, 250  # levels between which a camera's answer is believed
MOST_GAIN = 2.0  # a factor beyond which pictures are not of one sensor under one light
ZOOMS = (0.5, 1.6)  # between which a picture still shows what a network looks for
SLACK = 0.02  # of the dots' distance: how well a picture tells it


@dataclass(frozen=True)
class Light:
    """How a picture differs in light from the untouched one: picture = gain * untouched + offset.

    gain (3,), offset (3,) levels, by colour. residual: levels that agreeing places still differ by, root mean square.
    share: part of the picture that agrees. known: False where too little does; gain is then 1 and offset 0.
    """

    gain: np.ndarray
    offset: np.ndarray
    residual: float
    share: float
    known: bool

    def undo(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3) uint8 as it would be under the light of the untouched one."""
        import cv2

        if not self.known:
            return image
        levels = np.arange(256, dtype=float)[:, None]
        table = np.clip(np.rint((levels - self.offset) / self.gain), 0, 255).astype(np.uint8)
        return cv2.LUT(np.ascontiguousarray(image), table[None])


@dataclass(frozen=True)
class View:
    """How pictures of a sensor are scaled about their middle; what such a picture then does not show is `fill`, (3,)."""

    zoom: float
    fill: tuple[float, float, float]

    def of(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3) uint8 as a sensor would show it that sees the gel at the network's scale."""
        import cv2

        if self.zoom == 1.0:
            return image
        size = image.shape[1::-1]
        matrix = np.array([[self.zoom, 0.0, 0.0], [0.0, self.zoom, 0.0]])
        matrix[:, 2] = (1.0 - self.zoom) * (np.array(size) - 1) / 2
        return cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_CONSTANT, borderValue=self.fill)

    def shown(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns of such a picture (h, w, ...) that show something."""
        rows, cols = (slice(margin, size - margin) for size, margin in (
            (size, max(0, math.ceil((1.0 - self.zoom) * size / 2))) for size in shape[:2]))  # fmt: skip
        return rows, cols

    def match(self, image: np.ndarray, untouched: np.ndarray) -> tuple[np.ndarray, "Light"]:
        """An image under the light of the untouched picture, both (h, w, 3) uint8 of this view, and what its light was."""
        inner = self.shown(image.shape)
        light = match_light(image[inner], untouched[inner])
        lit = untouched.copy()  # what neither shows is the same in both
        lit[inner] = light.undo(image[inner])
        return lit, light


WHOLE = View(1.0, (0.0, 0.0, 0.0))


def at_scale(pitch: float, learnt: Sequence[float]) -> bool:
    """Whether dots `pitch` px apart stand as those that a network learnt from, of which `learnt` is as in `view_of`.

    A picture without dots (pitch 0) tells no scale and passes.
    """
    return pitch == 0.0 or (1 - SLACK) * learnt[0] <= pitch <= (1 + SLACK) * learnt[1]


def view_of(untouched: np.ndarray, pitch: float, learnt: tuple[float, float]) -> View:
    """The view of a sensor by its untouched picture (h, w, 3) uint8, whose dots stand `pitch` px apart.

    learnt: least and largest distance of dots in the pictures that the network learnt from. Gels are printed alike, so a
    camera whose dots stand closer or farther apart sees more or less of the gel. A picture without dots (pitch 0) is
    left as it is; one that no scale brings near enough raises BadInput.
    """
    red, green, blue = np.rint(untouched.mean(axis=(0, 1))).tolist()
    fill = red, green, blue
    if at_scale(pitch, learnt):
        return View(1.0, fill)
    zoom = sum(learnt) / 2 / pitch
    if not ZOOMS[0] <= zoom <= ZOOMS[1]:
        raise BadInput(
            f"the dots of the untouched picture stand {pitch:.1f} px apart, the network learnt from {learnt[0]:.0f} to"
            f" {learnt[1]:.0f}: crop or scale all pictures of this sensor so that its dots stand about as far apart"
        )
    return View(zoom, fill)


def hidden(shown: np.ndarray) -> np.ndarray:
    """What stands where a pair (h, w, 6) uint8 shows nothing: the untouched picture's mean colour in both, (6,) uint8."""
    # rows first: along them numpy adds whole lines of memory
    mean = shown.sum(axis=0, dtype=np.uint64).sum(axis=0) / (shown.shape[0] * shown.shape[1])
    return np.tile(np.rint(mean[3:]).astype(np.uint8), 2)


def match_light(image: np.ndarray, untouched: np.ndarray) -> Light:
    """Light of an image against a picture of the untouched sensor, both (h, w, 3) uint8 of one size."""
    import cv2

    seen, rest = (cv2.resize(a, SMALL, interpolation=cv2.INTER_AREA).reshape(-1, 3).astype(float)
                  for a in (image, untouched))  # fmt: skip
    believed = ((seen > DARK) & (seen < BRIGHT) & (rest > DARK) & (rest < BRIGHT)).all(axis=1)
    none = Light(np.ones(3), np.zeros(3), 0.0, 0.0, False)
    if believed.mean() < LEAST_SHARE:
        return none
    seen, rest = seen[believed], rest[believed]
    products = np.hstack([rest, seen, rest * rest, rest * seen])  # what weighted sums are taken of, (n, 12)
    middle = len(seen) // 2
    gain, offset = np.partition(seen / rest, middle, axis=0)[middle], np.zeros(3)
    ends = ENDS * gain
    for _ in range(ROUNDS):
        off = seen - gain * rest - offset
        squared = np.einsum("ij,ij->i", off, off)
        scale = max(LEAST_SCALE, 1.4826 * math.sqrt(np.partition(squared, middle)[middle]))
        weight = np.maximum(1.0 - squared / (REACH * scale) ** 2, 0.0) ** 2
        total = float(weight.sum())
        if total <= 0.0:
            return none
        mean_rest, mean_seen, squares, crossed = (weight @ products / total).reshape(4, 3)
        gain = (crossed - mean_rest * mean_seen + TIED) / (squares - mean_rest**2 + TIED)
        offset = mean_seen - gain * mean_rest
        before, ends = ends, ENDS * gain + offset
        if np.abs(ends - before).max() < SETTLED:
            break
    share = float(believed.mean() * (weight > 0.5).mean())
    residual = float(np.sqrt(weight @ squared / total))
    if share < LEAST_SHARE or not np.all((gain > 1.0 / MOST_GAIN) & (gain < MOST_GAIN)):
        return none
    return Light(gain, offset, residual, share, True)
