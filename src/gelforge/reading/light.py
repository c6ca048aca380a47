"""Photometric normalisation: brings an image under the light of its sensor's no-contact image.

Light drifts between the two: lamps warm up, a camera changes its exposure, a press shades the whole gel. A network
that compares them takes this for force. The drift shows outside the contact: most of the image changes by one gain
and one offset per colour, whereas the contact changes otherwise.
"""

import math
from dataclasses import dataclass

import numpy as np

SMALL = (40, 30)  # width and height in px at which light is compared: markers and noise average out
ROUNDS = 20  # largest number of rounds of iteratively reweighted least squares; four are usual
BRIGHTEST = 255.0  # largest level of an image
LEVELS = np.arange(BRIGHTEST + 1.0)[:, None]
SETTLED = 0.02  # largest change in a round, in levels, at which the iteration stops
LEAST_SCALE = 1.5  # levels by which a place may differ through noise alone
# Scales beyond which a place has no weight (Tukey's biweight: Beaton and Tukey 1974, Technometrics 16, 147-185).
REACH = 3.0
TIED = 4.0  # levels squared: a smaller variance hardly distinguishes gain from offset, so the gain is pulled to 1
LEAST_FRACTION = 0.25  # of the image that must agree, or the change of light is unknown
DARK, BRIGHT = 4, 250  # levels between which the camera's response is trusted
# The distribution of light over the gel is fitted by a slope across the image and a curvature towards its corners.
# Places with a residual above FALL_REACH scales have no weight; beyond the largest scale a press shades the gel too
# unevenly for a fit.
FALL_ROUNDS, FALL_REACH, FALL_SCALES = 4, 4.0, (0.01, 0.06)
SPARSE = 3  # every third place is used, enough for four coefficients
COLOUR_FALL = 0.04 / 0.055  # weight of one colour's change of distribution beside that of all
MOST_GAIN = 2.0  # a gain beyond which images are not of one sensor under one light
ALL = slice(None), slice(None)  # rows and columns of a picture


ACROSS, DOWN = (
    one.ravel() for one in np.meshgrid(np.linspace(-1.0, 1.0, SMALL[0]), np.linspace(-1.0, 1.0, SMALL[1]))
)
FALL = np.stack([np.ones(len(ACROSS)), ACROSS, DOWN, ACROSS**2 + DOWN**2 - 2.0 / 3.0])[:, ::SPARSE]  # (4, n)


@dataclass(frozen=True)
class Light:
    """How a picture differs in light from the no-contact image: picture = gain * no-contact + offset.

    gain (3,), offset (3,) levels, by colour. residual: root mean square difference that remains at agreeing places,
    levels. fraction: of the image that agrees. known: False where too little agrees; gain is then 1 and offset 0.
    """

    gain: np.ndarray
    offset: np.ndarray
    residual: float
    fraction: float
    known: bool

    def undo(self, image: np.ndarray) -> np.ndarray:
        """The image (h, w, 3) uint8 under the light of the no-contact image; unchanged where `known` is False."""
        import cv2

        if not self.known:
            return image
        table = (LEVELS - self.offset) / self.gain
        table = np.minimum(np.maximum(np.rint(table, out=table), 0.0, out=table), BRIGHTEST, out=table).astype(
            np.uint8
        )
        return cv2.LUT(np.ascontiguousarray(image), table[None])


NO_LIGHT = Light(np.ones(3), np.zeros(3), 0.0, 0.0, False)  # where it cannot be compared
SAME_LIGHT = Light(np.ones(3), np.zeros(3), 0.0, 1.0, True)


def match_light(image: np.ndarray, nocontact: np.ndarray) -> Light:
    """Light of an image against a no-contact image, both (h, w, 3) uint8 of one size."""
    return Reference(nocontact).light_of(image)


class Reference:
    """A no-contact image (h, w, 3) uint8 whose light others are compared with; its own levels are computed once.

    shown: rows and columns of the image that show something.
    """

    def __init__(self, picture: np.ndarray, shown: tuple[slice, slice] = ALL) -> None:
        self.picture, self.shown = picture, shown
        self._small = _small(picture[shown])
        self._believed = _believed(self._small)

    def normalised(self, image: np.ndarray) -> tuple[np.ndarray, Light]:
        """An image (h, w, 3) uint8 in the same frame under the light of the no-contact image, and what its light was."""
        light = self.light_of(image[self.shown])
        return self._within(light.undo(image[self.shown])), light

    def _within(self, seen: np.ndarray) -> np.ndarray:
        """What is shown (h', w', 3) uint8 with the no-contact image's margin, which is the same in both."""
        if seen.shape == self.picture.shape:
            return seen
        whole = self.picture.copy()
        whole[self.shown] = seen
        return whole

    def falls_of(self, image: np.ndarray, light: Light) -> np.ndarray:
        """Change of the light's distribution on an image (h, w, 3) uint8 against the no-contact image, (3, 3) by colour.

        Slopes along u and v and curvature of the logarithm of the level over the shown part, as of `_falls`. 0 where the
        light is not known, or a press shades most of the gel.
        """
        if not light.known:
            return np.zeros((3, 3))
        seen, rest = _small(image[self.shown])[:, ::SPARSE], self._small[:, ::SPARSE]
        expected = light.gain[:, None] * rest + light.offset[:, None]
        good = _believed(rest) & _believed(seen)
        ratios = np.log((seen + 1.0) / np.maximum(expected + 1.0, 1.0))
        falls, scales = _falls(ratios, good)
        return falls if scales.max() <= FALL_SCALES[1] else np.zeros((3, 3))

    def evened(self, image: np.ndarray, falls: np.ndarray) -> np.ndarray:
        """An image (h, w, 3) uint8 without a change of the light's distribution, `falls_of`."""
        seen = image[self.shown]
        v, u = np.meshgrid(*(np.linspace(-1.0, 1.0, size) for size in seen.shape[:2]), indexing="ij")
        change = np.stack([u, v, u**2 + v**2 - 2.0 / 3.0], axis=-1) @ falls.T
        return self._within(np.clip(np.rint(seen * np.exp(-change)), 0, 255).astype(np.uint8))

    def light_of(self, image: np.ndarray) -> Light:
        """Light of an image, (h, w, 3) uint8 of what is shown."""
        small = _small(image)
        believed = self._believed & _believed(small)
        if believed.mean() < LEAST_FRACTION:
            return NO_LIGHT
        rest = self._small
        if not believed.all():  # indexing costs more than everything else done once to these few thousand levels
            small, rest = small[:, believed], rest[:, believed]
        return _agreed(small.astype(float), rest.astype(float), float(believed.mean()))


def _small(picture: np.ndarray) -> np.ndarray:
    """Levels (3, n) uint8 of a picture (h, w, 3) uint8 at the size at which light is compared, by colour.

    Colours first, so that sums over places run along contiguous memory.
    """
    import cv2

    return np.ascontiguousarray(cv2.resize(picture, SMALL, interpolation=cv2.INTER_AREA).reshape(-1, 3).T)


def _believed(small: np.ndarray) -> np.ndarray:
    """Which places (n,) have levels (3, n) at which the camera's response is trusted."""
    return np.asarray((small.min(axis=0) > DARK) & (small.max(axis=0) < BRIGHT))


def _agreed(seen: np.ndarray, rest: np.ndarray, fraction: float) -> Light:
    """Robust fit of the light that maps levels at rest (3, n) to levels seen (3, n); fraction: of places in use.

    Few NumPy calls, and plain numbers by colour, because the calls take most of the time, not the thousand places.
    """
    products = np.empty((4, *rest.shape))  # terms of the weighted sums
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
        # the change of black and of white, which bounds that of all levels
        changes = [(a - c, b - d) for (a, b), c, d in zip(before, gain, offset, strict=True)]
        if max(max(abs(black), abs(BRIGHTEST * part + black)) for part, black in changes) < SETTLED:
            break
    fraction *= float((weight > 0.5).mean())
    residual = math.sqrt(float(weight @ squared) / total)
    if fraction < LEAST_FRACTION or not all(1.0 / MOST_GAIN < one < MOST_GAIN for one in gain):
        return NO_LIGHT
    return Light(np.array(gain), np.array(offset), residual, fraction, True)


def _falls(ratios: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes along u and v and curvature (3, 3) by colour of log level ratios (3, n) outside a contact, and scales (3,).

    good: (n,) bool, places in use. Scales are those of the residuals.
    """
    weights, scales = np.repeat(good[None].astype(float), 3, axis=0), np.zeros(3)
    found, middle = np.zeros((3, 4)), np.count_nonzero(good) // 2
    for _ in range(FALL_ROUNDS):
        weighted = FALL * weights[:, None]
        try:
            found = np.linalg.solve(weighted @ FALL.T, weighted @ ratios[..., None])[..., 0]
        except np.linalg.LinAlgError:  # too few places are left for four coefficients
            return np.zeros((3, 3)), np.zeros(3)
        left = np.abs(ratios - found @ FALL)
        scales = np.maximum(FALL_SCALES[0], 1.4826 * np.partition(left[:, good], middle, axis=1)[:, middle])
        weights = np.where(good, np.maximum(0.0, 1.0 - (left / (FALL_REACH * scales[:, None])) ** 2) ** 2, 0.0)
    return found[:, 1:], scales


def fall_size(falls: np.ndarray) -> float:
    """Size of a change of the light's distribution (3, 3), as a fraction of the level from the middle to the edge.

    Of all colours together, or the slope of one, of which the fraction COLOUR_FALL counts.
    """
    along, across, corners = falls.mean(axis=0)
    one = float(np.hypot(*falls[:, :2].T).max())
    return max(float(np.hypot(along, across)), abs(float(corners)), one * COLOUR_FALL)
