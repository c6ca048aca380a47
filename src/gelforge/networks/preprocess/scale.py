"""Pictures of a sensor brought to the scale, px per mm, that a network learnt: markers are printed alike on every gel."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput

ZOOMS = (0.5, 1.6)  # between which a picture still shows what a network looks for
SLACK = 0.02  # of the markers' distance: how well a picture shows it
SAME_SHAPE = 0.02  # fraction by which the sides of a picture may be in another ratio than the model's


def fit_size(image: np.ndarray, size: Sequence[int]) -> tuple[np.ndarray, str]:
    """An image (h, w, 3) uint8 at a model's (height, width), and what is wrong with its shape, empty for nothing."""
    import cv2

    (height, width), (rows, cols) = image.shape[:2], size
    if (height, width) == (rows, cols):
        return image, ""
    small = height * width < rows * cols
    resized = cv2.resize(image, (cols, rows), interpolation=cv2.INTER_CUBIC if small else cv2.INTER_AREA)
    if abs(width * rows - height * cols) <= SAME_SHAPE * height * cols:
        return resized, ""
    return (
        resized,
        f"the picture is {width} x {height}, of another shape than the {cols} x {rows} trained on: crop it",
    )


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


WHOLE = View(1.0, (0.0, 0.0, 0.0))


def at_scale(pitch: float, learnt: Sequence[float]) -> bool:
    """Whether markers `pitch` px apart stand as those that a network learnt from, of which `learnt` is as in `view_of`.

    A picture without markers (pitch 0) has no known scale and passes.
    """
    return pitch == 0.0 or (1 - SLACK) * learnt[0] <= pitch <= (1 + SLACK) * learnt[1]


def view_of(nocontact: np.ndarray, pitch: float, learnt: tuple[float, float]) -> View:
    """The view of a sensor by its no-contact image (h, w, 3) uint8, whose markers stand `pitch` px apart.

    learnt: least and largest distance of markers in the pictures that the network learnt from. Gels are printed alike, so a
    camera whose markers stand closer or farther apart sees more or less of the gel. A picture without markers (pitch 0) is
    left as it is; one that no scale brings near enough raises BadInput.
    """
    red, green, blue = np.rint(nocontact.mean(axis=(0, 1))).tolist()
    fill = red, green, blue
    if at_scale(pitch, learnt):
        return View(1.0, fill)
    zoom = sum(learnt) / 2 / pitch
    if not ZOOMS[0] <= zoom <= ZOOMS[1]:
        raise BadInput(
            f"the markers of the no-contact image stand {pitch:.1f} px apart, the network learnt from {learnt[0]:.0f} to"
            f" {learnt[1]:.0f}: crop or scale all pictures of this sensor so that its markers stand about as far apart"
        )
    return View(zoom, fill)


def hidden(shown: np.ndarray) -> np.ndarray:
    """What stands where a pair (h, w, 6) uint8 shows nothing: the no-contact image's mean colour in both, (6,) uint8."""
    # rows first: along them numpy adds whole lines of memory
    mean = shown.sum(axis=0, dtype=np.uint64).sum(axis=0) / (shown.shape[0] * shown.shape[1])
    return np.tile(np.rint(mean[3:]).astype(np.uint8), 2)
