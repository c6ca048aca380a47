"""A sensor's own table from colours to surface slopes (balls.slopefit learns it from presses of a ball), and height from slopes.

By how much the light of a pixel changes says how the gel slopes there, in a way that differs over the gel and from sensor to
sensor (photometric stereo: Johnson and Adelson 2009, CVPR). Slopes are a polynomial of the relative change of three colours
whose coefficients are polynomials of place. Markers hide the light: slopes under them are those of what surrounds them.
"""

from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement

import numpy as np

from gelforge.records.markers import marker_mask

COLOUR_ORDER, PLACE_ORDER = 3, 2  # of the two polynomials
# Products of colours up to that order without the constant, and of two coordinates with it.
COLOUR_TERMS, PLACE_TERMS = 19, 6
DARK = 20.0  # grey levels added to the light that a change is divided by
SMOOTH_PX = 1.5  # of the halved image, over which slopes under markers are taken from their surroundings


@dataclass(frozen=True)
class SlopeTable:
    """Coefficients (COLOUR_TERMS, PLACE_TERMS, 2) for slopes along u and v; px_per_mm: of the images that it is for."""

    coefficients: np.ndarray
    px_per_mm: float

    def slopes(self, image: np.ndarray, nocontact: np.ndarray) -> np.ndarray:
        """Slopes (2, h / 2, w / 2) float32 of the surface along u and v against the no-contact one, mm per mm.

        image, nocontact: (h, w, 3) uint8 RGB under one illumination.
        """
        import cv2

        change, clear = light_change(image, nocontact, self.px_per_mm)
        of_place = place_terms(clear.shape) @ self.coefficients.transpose(1, 0, 2).reshape(PLACE_TERMS, -1)
        of_place = of_place.reshape(*clear.shape, COLOUR_TERMS, 2)
        found = np.einsum("hwc,hwcs->hws", colour_terms(change), of_place).astype(np.float32)
        weight = clear.astype(np.float32)
        around = np.maximum(cv2.GaussianBlur(weight, (0, 0), SMOOTH_PX), 0.02)
        mean = cv2.GaussianBlur(found * weight[..., None], (0, 0), SMOOTH_PX) / around[..., None]
        return np.where(clear[..., None], found, mean).transpose(2, 0, 1)


def light_change(image: np.ndarray, nocontact: np.ndarray, px_per_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Relative change of light (h / 2, w / 2, 3) float32, and which pixels (h / 2, w / 2) no marker hides."""
    import cv2

    half = (image.shape[1] // 2, image.shape[0] // 2)
    seen, before = (
        cv2.resize(cv2.medianBlur(one, 3).astype(np.float32), half, interpolation=cv2.INTER_AREA)
        for one in (image, nocontact)
    )
    hidden = marker_mask(image, px_per_mm) | marker_mask(nocontact, px_per_mm)
    covered = cv2.resize(hidden.astype(np.float32), half, interpolation=cv2.INTER_AREA)
    return (seen - before) / (before + DARK), covered < 0.01


def colour_terms(change: np.ndarray) -> np.ndarray:
    """Products of up to COLOUR_ORDER colours, (..., COLOUR_TERMS); no constant, for without a change there is no slope."""
    return _products(change, COLOUR_ORDER)[..., 1:]


@cache
def place_terms(shape: tuple[int, int]) -> np.ndarray:
    """Products of up to PLACE_ORDER coordinates of each pixel, (h, w, PLACE_TERMS); coordinates run from -1 to 1."""
    v, u = np.meshgrid(*(np.linspace(-1, 1, side, dtype=np.float32) for side in shape), indexing="ij")
    return _products(np.stack([u, v], 2), PLACE_ORDER)


def _products(values: np.ndarray, order: int) -> np.ndarray:
    """All products of up to `order` of the last axis' values, the constant first."""
    count = values.shape[-1]
    sets = [one for size in range(1, order + 1) for one in combinations_with_replacement(range(count), size)]
    found: dict[tuple[int, ...], np.ndarray] = {(): np.ones_like(values[..., 0])}
    for one in sets:
        found[one] = found[one[:-1]] * values[..., one[-1]]
    return np.stack(list(found.values()), -1)


def height_of(slopes: np.ndarray, mm_per_px: float) -> np.ndarray:
    """Height (h, w) mm of the surface above the unloaded one, negative where it is pressed in.

    slopes: (2, h, w) along u and v, h and w even, mm per mm. mm_per_px: size of one of their pixels. The surface whose slopes
    are nearest to these in the mean square, by cosine transforms (Frankot and Chellappa 1988, IEEE PAMI 10; Simchony,
    Chellappa and Shao 1990, IEEE PAMI 12, for free edges). Slopes leave its level open: the median of the outermost pixels is 0.
    """
    import cv2

    along, across = (np.asarray(one, np.float32) for one in slopes)
    rows, cols = along.shape
    # differences between neighbours, of which each is the mean of both slopes; none over the edge
    right, down = (along[:, 1:] + along[:, :-1]) / 2, (across[1:] + across[:-1]) / 2
    bend = np.diff(np.pad(right, ((0, 0), (1, 1))), axis=1) + np.diff(np.pad(down, ((1, 1), (0, 0))), axis=0)
    of_rows, of_cols = (2 * np.cos(np.pi * np.arange(side) / side) - 2 for side in (rows, cols))
    stiffness = of_rows[:, None] + of_cols[None, :]
    stiffness[0, 0] = 1.0  # the mean, which is left open
    height = cv2.idct((cv2.dct(bend) / stiffness).astype(np.float32)) * mm_per_px
    edge = np.concatenate([height[0], height[-1], height[:, 0], height[:, -1]])
    return height - np.median(edge)
