"""A picture and what faults are judged by: each measure is computed once, for image and no-contact image alike.

Measures are those of the picture in the frame of a network (`reading.frame`), whose width is that of its input.
"""

import math
from functools import cached_property

import numpy as np

from gelforge.reading.light import ALL
from gelforge.reading.markers import grey_of
from gelforge.reading.wear import darkness_of

PATTERN = (40, 30)  # px, width and height at which colours are compared
WHITE = 254  # level of a saturated colour


class Picture:
    """A picture (h, w, 3) uint8 RGB and its measures. shown: rows and columns of it that show something."""

    def __init__(self, image: np.ndarray, shown: tuple[slice, slice] = ALL) -> None:
        self.image, self.shown = image, shown

    @cached_property
    def seen(self) -> np.ndarray:
        """The part that the camera shows, (h', w', 3), without the margin of a narrow view."""
        return np.ascontiguousarray(self.image[self.shown])

    @cached_property
    def level(self) -> float:
        """Mean level."""
        import cv2

        return sum(cv2.mean(self.seen)[:3]) / 3

    @cached_property
    def contrast(self) -> float:
        """Range of all levels."""
        import cv2

        low, high, _, _ = cv2.minMaxLoc(self.seen.reshape(len(self.seen), -1))
        return high - low

    @cached_property
    def colour(self) -> float:
        """Mean range between the colours of a place, levels. Photometric normalisation adds colour: measure it before."""
        return float(np.ptp(self._small, axis=2).mean())

    @cached_property
    def sharpness(self) -> float:
        """Logarithm of 1 plus the variance of the Laplacian, levels."""
        import cv2

        rough = cv2.Laplacian(self.grey[self.shown], cv2.CV_16S)
        # OpenCV's own standard deviation takes ten times as long as exact sums
        mean = cv2.sumElems(rough)[0] / rough.size
        return math.log(1.0 + max(0.0, cv2.norm(rough, cv2.NORM_L2SQR) / rough.size - mean**2))

    @cached_property
    def white(self) -> float:
        """Fraction of pixels with at least one saturated colour."""
        import cv2

        red, green, blue = cv2.split(self.seen)
        brightest = cv2.max(cv2.max(red, green), blue)
        _, white = cv2.threshold(brightest, WHITE - 1, 255, cv2.THRESH_BINARY)
        return cv2.countNonZero(white) / brightest.size

    @cached_property
    def pattern(self) -> np.ndarray:
        """Colours (30, 40, 3) float32, each without its mean."""
        small = self._small.astype(np.float32)
        return np.asarray(small - small.mean(axis=(0, 1)))

    @cached_property
    def grey(self) -> np.ndarray:
        """Mean of the colours, (h, w) uint8."""
        import cv2

        return grey_of(cv2.split(self.image))

    @cached_property
    def darkness(self) -> np.ndarray:
        """Its `darkness_of`, (h / 2, w / 2) uint8."""
        return darkness_of(self.grey)

    @cached_property
    def _small(self) -> np.ndarray:
        import cv2

        return np.asarray(cv2.resize(self.seen, PATTERN, interpolation=cv2.INTER_AREA)).astype(np.int16)


def likeness(one: np.ndarray, other: np.ndarray) -> float:
    """Normalised cross-correlation of two maps of one shape, from -1 to 1; 0 where one of them is flat."""
    one, other = one - one.mean(), other - other.mean()
    size = float(np.sqrt((one**2).sum() * (other**2).sum()))
    return float((one * other).sum()) / size if size > 0.0 else 0.0
