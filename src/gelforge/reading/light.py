"""Photometric normalisation: a picture brought under the light of the no-contact image of its sensor.

Light drifts between the two: lamps warm up, a camera sets its exposure anew, a press shades the whole gel. A network that
reads differences takes that for force. What does not touch shows the drift: most of the picture changes by one gain and one
offset a colour, and where something touches it changes otherwise.
"""

import math
from dataclasses import dataclass

import numpy as np

SMALL = (40, 30)  # width and height in px at which light is compared: markers and noise average out
ROUNDS = 20  # at most of iteratively reweighted least squares; four are usual
BRIGHTEST = 255.0  # level that a picture may have
LEVELS = np.arange(BRIGHTEST + 1.0)[:, None]
SETTLED = 0.02  # levels by which a round still changes what light makes of them, where another one is needless
LEAST_SCALE = 1.5  # levels that a place may differ by through noise alone
# Scales beyond which a place has no weight (Tukey's biweight: Beaton and Tukey 1974, Technometrics 16, 147-185).
REACH = 3.0
TIED = 4.0  # levels squared of contrast below which a gain is hardly distinguished from an offset, and taken for 1
LEAST_FRACTION = 0.25  # of the picture that must agree, or the change of the light is unknown
DARK, BRIGHT = 4, 250  # levels between which a camera's answer is believed
# How light falls on the gel is fitted by a slope across the image and a curve towards its corners, in so many rounds; a place that is left by
# more than FALL_REACH scales has no weight, and beyond the largest scale a press shades the gel so unevenly that it says nothing.
FALL_ROUNDS, FALL_REACH, FALL_SCALES = 4, 4.0, (0.01, 0.06)
SPARSE = 3  # one of so many places is looked at, which are enough for four numbers
MOST_GAIN = 2.0  # a factor beyond which pictures are not of one sensor under one light
ALL = slice(None), slice(None)  # rows and columns of a picture


ACROSS, DOWN = (
    one.ravel() for one in np.meshgrid(np.linspace(-1.0, 1.0, SMALL[0]), np.linspace(-1.0, 1.0, SMALL[1]))
)
FALL = np.stack([np.ones(len(ACROSS)), ACROSS, DOWN, ACROSS**2 + DOWN**2 - 2.0 / 3.0])[:, ::SPARSE]  # (4, n)


@dataclass(frozen=True)
class Light:
    """How a picture differs in light from the no-contact image: picture = gain * no-contact + offset.

    gain (3,), offset (3,) levels, by colour. residual: levels that agreeing places still differ by, root mean square.
    fraction: fraction of the picture that agrees. known: False where too little does; gain is then 1 and offset 0.
    """

    gain: np.ndarray
    offset: np.ndarray
    residual: float
    fraction: float
    known: bool

    def undo(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3) uint8 as it would be under the light of the no-contact image; as it is where that is not known."""
        import cv2

        if not self.known:
            return image
        table = (LEVELS - self.offset) / self.gain
        table = np.minimum(np.maximum(np.rint(table, out=table), 0.0, out=table), BRIGHTEST, out=table).astype(
            np.uint8
        )
        return cv2.LUT(np.ascontiguousarray(image), table[None])


NO_LIGHT = Light(np.ones(3), np.zeros(3), 0.0, 0.0, False)  # of a picture that does not show it


def match_light(image: np.ndarray, nocontact: np.ndarray) -> Light:
    """Light of an image against a no-contact image, both (h, w, 3) uint8 of one size."""
    return Reference(nocontact).light_of(image)


class Reference:
    """A no-contact image (h, w, 3) uint8 whose light others are compared with: what is computed of it is computed once.

    shown: rows and columns of the picture that show something.
    """

    def __init__(self, picture: np.ndarray, shown: tuple[slice, slice] = ALL) -> None:
        self.picture, self.shown = picture, shown
        self._small = _small(picture[shown])
        self._believed = _believed(self._small)

    def normalised(self, image: np.ndarray) -> tuple[np.ndarray, Light]:
        """An image (h, w, 3) uint8 in the same frame under the light of the no-contact image, and what its light was."""
        light = self.light_of(image[self.shown])
        return self.under(light, image), light

    def under(self, light: Light, image: np.ndarray) -> np.ndarray:
        """An image (h, w, 3) uint8 without that change of light."""
        seen = image[self.shown]
        if seen.shape == image.shape:
            return light.undo(image)
        normalised = self.picture.copy()  # what neither shows is the same in both
        normalised[self.shown] = light.undo(seen)
        return normalised

    def fall_of(self, image: np.ndarray, light: Light) -> tuple[float, float]:
        """By which fraction of its level light falls otherwise on an image (h, w, 3) uint8 than on the no-contact image.

        From the middle to the edge of what is shown: of all colours together, and of the colour that changes most. (0, 0) where
        the light is not known, or a press shades most of the gel.
        """
        if not light.known:
            return 0.0, 0.0
        seen, rest = _small(image[self.shown])[:, ::SPARSE], self._small[:, ::SPARSE]
        expected = light.gain[:, None] * rest + light.offset[:, None]
        good = _believed(rest) & _believed(seen)
        fitted = [_fall(one, good) for one in np.log((seen + 1.0) / np.maximum(expected + 1.0, 1.0))]
        if max(scale for _, scale in fitted) > FALL_SCALES[1]:
            return 0.0, 0.0
        falls = np.array([fall for fall, _ in fitted])
        along, across, corners = falls.mean(axis=0)
        return max(float(np.hypot(along, across)), abs(float(corners))), float(np.hypot(*falls[:, :2].T).max())

    def light_of(self, image: np.ndarray) -> Light:
        """Light of an image, (h, w, 3) uint8 of what is shown."""
        small = _small(image)
        believed = self._believed & _believed(small)
        if believed.mean() < LEAST_FRACTION:
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


def _agreed(seen: np.ndarray, rest: np.ndarray, fraction: float) -> Light:
    """Light that makes of levels at rest (3, n) those seen (3, n), as most places agree; fraction: of all that these are.

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
        # means by colour of the levels at rest, those seen, their square at rest, and their product
        means = list(zip(*(np.einsum("ijk,k->ij", products, weight) / total).tolist(), strict=True))
        before = list(zip(gain, offset, strict=True))
        gain = [(crossed - a * b + TIED) / (squares - a * a + TIED) for a, b, squares, crossed in means]
        offset = [b - one * a for (a, b, _, _), one in zip(means, gain, strict=True)]
        # the change of black and of white, between which all other levels lie
        changes = [(a - c, b - d) for (a, b), c, d in zip(before, gain, offset, strict=True)]
        if max(max(abs(black), abs(BRIGHTEST * part + black)) for part, black in changes) < SETTLED:
            break
    fraction *= float((weight > 0.5).mean())
    residual = math.sqrt(float(weight @ squared) / total)
    if fraction < LEAST_FRACTION or not all(1.0 / MOST_GAIN < one < MOST_GAIN for one in gain):
        return NO_LIGHT
    return Light(np.array(gain), np.array(offset), residual, fraction, True)


def _fall(ratio: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, float]:
    """Slopes along u and v and curve (3,) of logarithms of levels (n,), without the places where something touches, and the scale left."""
    weight, scale = good.astype(float), 0.0
    for _ in range(FALL_ROUNDS):
        weighted = FALL * weight
        found = np.linalg.lstsq(weighted @ FALL.T, weighted @ ratio, rcond=None)[0]
        left = np.abs(ratio - found @ FALL)
        scale = max(FALL_SCALES[0], 1.4826 * float(np.median(left[good])))
        weight = np.where(good, np.maximum(0.0, 1.0 - (left / (FALL_REACH * scale)) ** 2) ** 2, 0.0)
    return found[1:], scale
