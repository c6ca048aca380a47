"""A pair of pictures as networks read it: under one light, and at the scale of those that they learnt from.

Light drifts between the two pictures of a pair: lamps warm up, a camera sets its exposure anew, a press shades the whole
gel. A network that reads differences takes that for force. What does not touch tells the drift: most of the picture
changes by one gain and one offset a colour, and where something touches it changes otherwise.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput

SMALL = (40, 30)  # width and height in px at which light is compared: dots and noise average out
ROUNDS = 20  # at most of iteratively reweighted least squares; four are usual
BRIGHTEST = 255.0  # level that a picture may have
LEVELS = np.arange(BRIGHTEST + 1.0)[:, None]
SETTLED = 0.02  # levels by which a round still changes what light makes of them, where another one is needless
LEAST_SCALE = 1.5  # levels that a place may differ by through noise alone
# Scales beyond which a place has no say (Tukey's biweight: Beaton and Tukey 1974, Technometrics 16, 147-185).
REACH = 3.0
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
        """The image (h, w, 3) uint8 as it would be under the light of the untouched one; as it is where that is not known."""
        import cv2

        if not self.known:
            return image
        table = (LEVELS - self.offset) / self.gain
        table = np.minimum(np.maximum(np.rint(table, out=table), 0.0, out=table), BRIGHTEST, out=table).astype(
            np.uint8
        )
        return cv2.LUT(np.ascontiguousarray(image), table[None])


NO_LIGHT = Light(np.ones(3), np.zeros(3), 0.0, 0.0, False)  # of a picture that tells nothing of it


@dataclass(frozen=True)
class View:
    """How pictures of a sensor are scaled about their middle, so that it sees the gel at the network's scale.

    zoom: factor on lengths; below 1 the picture has a margin that shows nothing. fill: levels (3,) of that margin.
    """

    zoom: float
    fill: tuple[float, float, float]

    @property
    def whole(self) -> bool:
        """Whether pictures are at the network's scale as they are, and so show the gel's rim."""
        return self.zoom == 1.0

    def of(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3) uint8 at the network's scale, of the same size."""
        import cv2

        if self.whole:
            return image
        size = image.shape[1::-1]
        matrix = np.array([[self.zoom, 0.0, 0.0], [0.0, self.zoom, 0.0]])
        matrix[:, 2] = (1.0 - self.zoom) * (np.array(size) - 1) / 2
        return cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_CONSTANT, borderValue=self.fill)

    def shown(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns of such a picture (h, w, ...) that show something."""
        return self._within(shape, math.ceil)

    def cells_shown(self, grid: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns of a map of such a picture, (rows, cols) cells, that show something, to the nearest cell."""
        return self._within(grid, round)

    def _within(self, shape: tuple[int, ...], whole: Callable[[float], int]) -> tuple[slice, slice]:
        across, along = (max(0, whole((1.0 - self.zoom) * size / 2)) for size in shape[:2])
        return slice(across, shape[0] - across), slice(along, shape[1] - along)

    def match(self, image: np.ndarray, untouched: "Resting") -> tuple[np.ndarray, "Light"]:
        """An image (h, w, 3) uint8 as `of` gives it under the light of the untouched picture, and what its light was.

        untouched: of a picture in this view.
        """
        if self.zoom >= 1.0:
            light = untouched.light_of(image)
            return light.undo(image), light
        inner = self.shown(image.shape)
        light = untouched.light_of(image[inner])
        lit = untouched.picture.copy()  # what neither shows is the same in both
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
    return Resting(untouched).light_of(image)


class Resting:
    """An untouched picture (h, w, 3) uint8 whose light others are held against: what is made of it is made once.

    view: in which the picture is given (`View.of`); it says what part shows something.
    """

    def __init__(self, picture: np.ndarray, view: View = WHOLE) -> None:
        self.picture = picture
        self._small = _small(picture[view.shown(picture.shape)])
        self._believed = _believed(self._small)

    def light_of(self, image: np.ndarray) -> Light:
        """Light of an image, (h, w, 3) uint8 of what the view shows."""
        small = _small(image)
        believed = self._believed & _believed(small)
        if believed.mean() < LEAST_SHARE:
            return NO_LIGHT
        rest = self._small
        if not believed.all():  # picking costs more than all else that is done to these few thousand levels once
            small, rest = small[:, believed], rest[:, believed]
        return _agreed(small.astype(float), rest.astype(float), float(believed.mean()))


def _small(picture: np.ndarray) -> np.ndarray:
    """Levels (3, n) uint8 of a picture (h, w, 3) uint8 at the size at which light is compared, by colour.

    Colours first, so that sums over the places are sums along lines of memory.
    """
    import cv2

    return np.ascontiguousarray(cv2.resize(picture, SMALL, interpolation=cv2.INTER_AREA).reshape(-1, 3).T)


def _believed(small: np.ndarray) -> np.ndarray:
    """Which places (n,) have levels (3, n) at which a camera's answer is believed."""
    return np.asarray((small.min(axis=0) > DARK) & (small.max(axis=0) < BRIGHT))


def _agreed(seen: np.ndarray, rest: np.ndarray, share: float) -> Light:
    """Light that makes of levels at rest (3, n) those seen (3, n), as most places agree; share: of all that these are.

    In few calls, and numbers by colour as plain ones: most of the time goes into calls, not into a thousand places.
    """
    products = np.empty((4, *rest.shape))  # what weighted sums are taken of
    products[0], products[1] = rest, seen
    np.multiply(rest, products[:2], out=products[2:])
    middle = seen.shape[1] // 2
    gain, offset = np.partition(seen / rest, middle, axis=1)[:, middle].tolist(), [0.0, 0.0, 0.0]
    for _ in range(ROUNDS):
        off = seen - np.array(gain)[:, None] * rest
        off -= np.array(offset)[:, None]
        squared = np.einsum("ij,ij->j", off, off)
        scale = max(LEAST_SCALE, 1.4826 * math.sqrt(np.partition(squared, middle)[middle]))
        weight = squared * (-1.0 / (REACH * scale) ** 2)
        weight += 1.0
        np.maximum(weight, 0.0, out=weight)
        weight *= weight
        total = float(weight.sum())
        if total <= 0.0:
            return NO_LIGHT
        before = gain, offset
        gain, offset = _fitted((np.einsum("ijk,k->ij", products, weight) / total).tolist())
        if _largest_change(*before, gain, offset) < SETTLED:
            break
    share *= float((weight > 0.5).mean())
    residual = math.sqrt(float(weight @ squared) / total)
    if share < LEAST_SHARE or not all(1.0 / MOST_GAIN < one < MOST_GAIN for one in gain):
        return NO_LIGHT
    return Light(np.array(gain), np.array(offset), residual, share, True)


def _fitted(means: list[list[float]]) -> tuple[list[float], list[float]]:
    """Gain and offset by colour from means by colour of the levels at rest, those seen, their square at rest, and product."""
    gain = [
        (crossed - rest * seen + TIED) / (squares - rest * rest + TIED)
        for rest, seen, squares, crossed in zip(*means, strict=True)
    ]
    return gain, [seen - one * rest for rest, seen, one in zip(*means[:2], gain, strict=True)]


def _largest_change(
    gain: list[float], offset: list[float], other_gain: list[float], other_offset: list[float]
) -> float:
    """Levels that one light makes otherwise than another at most, of black and of white, between which all others lie."""
    return max(
        max(abs(c - d), abs(BRIGHTEST * (a - b) + c - d))
        for a, b, c, d in zip(gain, other_gain, offset, other_offset, strict=True)
    )
