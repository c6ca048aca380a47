"""Where an image shows a contact, and where the pose of its press puts one: two small maps that should look alike.

Both maps are (30, 40) float32 over the whole image. The measured one is the change of colour against the no-contact image, under the
same light and without the markers; the expected one is the slope of the undeformed gel where the indenter cuts into it. Only their
pattern is compared, by normalised cross-correlation, so neither has a unit.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelforge.geometry import touch
from gelforge.geometry.gel import load_gel
from gelforge.geometry.solids import Indenter
from gelforge.labelling.sensor import Sensor
from gelforge.reading.markers import dark_spots
from gelforge.reading.pair import Pair
from gelforge.reading.picture import likeness
from gelforge.records.press import Press

ROWS, COLS = 30, 40
HALF = (160, 120)  # width and height in px at which the change of colour is measured
MARKER = 13  # px at that size: larger than a marker is wide
INK = 0.15  # of the largest level, by which a marker is darker than its surroundings
SMOOTH = 2.5  # px at that size: standard deviation of the average between markers
DARK = 20.0  # levels: a darker no-contact image does not show by which fraction a colour changes
STEEPEST = 0.5  # slope of the gel around an edge that is pressed into it
SHOWN = 3.0  # levels of change that an imprint has at least
# Expected slope from which every unit shows an imprint. In 48 presses of two units of the rig, the 99 % quantile of
# the change over that of the expected slope is 12 to 25 and 43 to 69, which is 0.6 to 1.3 times each unit's median.
MADE = 0.2


def imprint(pair: Pair) -> np.ndarray:
    """Change of colour (30, 40) of an image against its no-contact image, after photometric normalisation."""
    import cv2

    assert pair.nocontact is not None
    half, rest = _half(pair.lit.image), _half(pair.nocontact.picture.image)
    change = cv2.transform(cv2.absdiff(half, rest), np.full((1, 3), 1 / 3, np.float32)).astype(np.float32)
    gel = _between_markers(half) * _between_markers(rest)
    mean = cv2.GaussianBlur(change * gel, (0, 0), SMOOTH) / (cv2.GaussianBlur(gel, (0, 0), SMOOTH) + 1e-3)
    return cv2.resize(mean, (COLS, ROWS), interpolation=cv2.INTER_AREA)


def shading(pair: Pair) -> np.ndarray:
    """Signed change of each colour (30, 40, 3) against the no-contact image, as a fraction of its level there."""
    import cv2

    assert pair.nocontact is not None
    half, rest = _half(pair.lit.image), _half(pair.nocontact.picture.image)
    gel = _between_markers(half) * _between_markers(rest)
    shown = cv2.GaussianBlur(gel, (0, 0), SMOOTH)[..., None] + 1e-3
    change, level = (
        cv2.GaussianBlur(gel[..., None] * what.astype(np.float32), (0, 0), SMOOTH) / shown
        for what in (half.astype(np.float32) - rest, rest)
    )
    return cv2.resize(change / np.maximum(level, DARK), (COLS, ROWS), interpolation=cv2.INTER_AREA)


def _half(image: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.resize(image, HALF, interpolation=cv2.INTER_AREA)


def _between_markers(half: np.ndarray) -> np.ndarray:
    """1 where an image (120, 160, 3) uint8 shows gel, 0 where it shows a marker, float32 (120, 160)."""
    import cv2

    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (MARKER, MARKER))
    return 1.0 - dark_spots(half, around, np.ones((3, 3), np.uint8), INK).astype(np.float32)


class Window:
    """The part of a sensor's gel that its image shows, at the places of the maps."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self._px = np.array([sensor.image[0] / COLS, sensor.image[1] / ROWS])
        u, v = (np.arange(COLS) + 0.5) * self._px[0], (np.arange(ROWS) + 0.5) * self._px[1]
        places = np.stack(np.meshgrid(u, v), axis=-1)  # (30, 40, 2) px
        step = sensor.unproject(places[ROWS // 2, COLS // 2 : COLS // 2 + 2])
        self.mm = float(np.hypot(*(step[1] - step[0])))  # from one place to the next
        self._xy = sensor.unproject(places.reshape(-1, 2)).T

    @cached_property
    def _gel(self) -> tuple[np.ndarray, np.ndarray]:
        gel = load_gel(self.sensor.gel)
        return np.column_stack([*self._xy, gel.top(*self._xy)]), gel.inside(*self._xy)

    def place(self, press: Press) -> np.ndarray:
        """Column and row (2,) of the maps at which the tip is at the end of a press."""
        return np.asarray(self.sensor.project(np.array([press.x0 + press.dx, press.y0 + press.dy])) / self._px - 0.5)

    def expected(self, indenter: Indenter, press: Press) -> np.ndarray:
        """Slope (30, 40) of the gel's undeformed surface where the indenter cuts into it at the end of a press."""
        return _smoothed(np.hypot(*np.gradient(self._depth(indenter, press))) / self.mm)

    def slopes(self, indenter: Indenter, press: Press) -> np.ndarray:
        """Slopes down the image's columns and rows of the surface as in `expected`, and where it is cut, (3, 30, 40)."""
        depth = self._depth(indenter, press)
        down, along = np.gradient(depth) / np.float32(self.mm)
        return np.stack([_smoothed(one) for one in (along, down, (depth < 0.0).astype(np.float32))])

    def _depth(self, indenter: Indenter, press: Press) -> np.ndarray:
        """How deep the surface is cut, (30, 40) mm, at most 0."""
        points, inside = self._gel
        depth = np.minimum(touch.gap(indenter, press, points, press.end), 0.0)
        return _draped(np.where(inside, depth, 0.0).reshape(ROWS, COLS).astype(np.float32), STEEPEST * self.mm)


def _smoothed(values: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.GaussianBlur(values, (0, 0), SMOOTH * COLS / HALF[0])


def _draped(depth: np.ndarray, steepest: float) -> np.ndarray:
    """The highest surface (30, 40) nowhere above `depth` (at most 0) and falling by at most `steepest` per place."""
    import cv2

    straight = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    for _ in range(int(-depth.min() / steepest) + 1):
        depth = np.minimum(depth, cv2.erode(depth, straight) + steepest)
        depth = np.minimum(depth, cv2.erode(depth, np.ones((3, 3), np.uint8)) + np.float32(np.sqrt(2.0)) * steepest)
    return depth


def displaced(measured: np.ndarray, expected: np.ndarray) -> tuple[float, np.ndarray]:
    """Largest likeness of two maps (30, 40) when the expected one is moved, and by how much, (2,) columns and rows.

    The map is flat beyond the image. Fractions of a place come from a parabola through the largest values.
    """
    one, other = measured - measured.mean(), expected - expected.mean()
    size = float(np.sqrt((one**2).sum() * (other**2).sum()))
    if size <= 0.0:
        return 0.0, np.zeros(2)
    shape = 2 * ROWS, 2 * COLS
    product = np.fft.irfft2(np.fft.rfft2(one, shape) * np.conj(np.fft.rfft2(other, shape)), shape) / size
    row, col = np.unravel_index(product.argmax(), shape)
    along = _vertex(*product[row, [col - 1, col, (col + 1) % shape[1]]])
    across = _vertex(*product[[row - 1, row, (row + 1) % shape[0]], col])
    place = np.array([col + along, row + across])
    return float(product.max()), np.where(place > np.array([COLS, ROWS]), place - (shape[1], shape[0]), place)


def _vertex(before: float, middle: float, after: float) -> float:
    """Where a parabola through three neighbouring values is largest, from the middle one, in steps."""
    bend = before - 2.0 * middle + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0


@dataclass(frozen=True)
class Seen:
    """What is kept of a press whose image is judged beside others: maps (30, 40) of its imprint.

    fault: what is wrong with the image by itself (`reading.faults`). centre: (2,) column and row of the maps at which
    the tip ends. mm: size of a place. rim: (2,) median motion of the rim's markers, in pitches, and fraction of them
    that is lost or looks different.
    """

    row: int
    sample_id: str
    sensor: str
    indenter: str
    fault: str
    measured: np.ndarray
    expected: np.ndarray
    centre: np.ndarray
    mm: float
    rim: np.ndarray

    @cached_property
    def strength(self) -> float:
        """Change of colour over expected slope, levels; NaN for a press too shallow for an imprint on every unit."""
        slope = float(np.percentile(self.expected, 99))
        return float(np.percentile(self.measured, 99)) / slope if slope >= MADE and not self.fault else math.nan

    @property
    def telling(self) -> bool:
        """Whether the image has no fault and shows an imprint, and one is expected."""
        return bool(not self.fault and np.ptp(self.measured) > SHOWN and np.ptp(self.expected) > 0.0)

    @cached_property
    def likeness(self) -> float:
        """Likeness of the measured and the expected map, from -1 to 1."""
        return likeness(self.measured, self.expected)

    @cached_property
    def middle(self) -> np.ndarray:
        """Column and row (2,) of the expected map's centre: on a dome it is nearer to the apex than the tip is."""
        rows, cols = np.indices(self.expected.shape)
        return np.array([np.average(cols, weights=self.expected), np.average(rows, weights=self.expected)])

    @cached_property
    def displaced(self) -> tuple[float, np.ndarray]:
        """Likeness with the expected map moved to fit best, and this move, (2,) columns and rows."""
        return displaced(self.measured, self.expected)
