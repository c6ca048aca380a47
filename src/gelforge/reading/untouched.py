"""Whether something touches the gel in a no-contact image, seen by that image alone.

A gel that nothing touches is lit smoothly: a polynomial of the place describes the logarithm of its light. What an object presses
departs from it, on units of any contrast, and in colour more than in level, because its slopes turn from one lamp to another.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gelforge.reading.light import ALL
from gelforge.reading.markers import MarkerTracker, dark_spots

# Signs of touch, both of which must be beyond. Of 108 clean no-contact images of drawn units 3 % are, of 4 real ones at rest none, of the
# starts of 40 real films one, which shows a stain; of 245 presses of 0.5 N and more, drawn on 22 units and real, none is not.
UNEVEN, COLOURED = 0.075, 3.2
# px: the width to which an image is reduced, and the least that it has itself; of a border that is left out, and of a place.
WIDTH, LEAST_WIDTH, RIM, CELL = 320.0, 160, 12, 4
SPOT, SPOT_MARGIN, INK = 25, 7, 0.15  # px, larger than a dark spot and left out around one; how much darker it is
SMOOTH, ORDER, ROUNDS = 2.0, 6, 8  # px; of the polynomial; of the fit
# Of a place, the fraction that is gel; levels added to all, which a logarithm needs; the least scatter of a fit; levels of hue.
SHOWN, DARK, LEAST_SCATTER, LEAST_HUE = 0.2, 8.0, 0.006, 0.2


@dataclass(frozen=True)
class TouchSigns:
    """How far the light between markers departs from a smooth one.

    uneven: the 97 % quantile, as a fraction of the light, of the three colours together. coloured: the 97 % quantile of the departure in colour
    alone over its median.
    """

    uneven: float
    coloured: float


@lru_cache(maxsize=4)
def terms(rows: int, cols: int) -> np.ndarray:
    """Products of powers of row and column up to ORDER, (rows * cols, n), from -1 to 1."""
    v, u = np.meshgrid(np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, cols), indexing="ij")
    powers = [(i, j) for i in range(ORDER + 1) for j in range(ORDER + 1 - i)]
    return np.stack([u**i * v**j for i, j in powers], axis=-1).reshape(rows * cols, -1)


def touch_signs(nocontact: np.ndarray, markers: MarkerTracker, shown: tuple[slice, slice] = ALL) -> TouchSigns:
    """Signs of touch in a no-contact image (h, w, 3) uint8 with its markers; shown: rows and columns of it that show something.

    The fit is robust, by Tukey's biweight, so that it follows the light around an object and not the object. Places where the
    lattice of markers lacks one are left out as markers are: what is left of a worn marker is no object.
    """
    import cv2

    seen = nocontact[shown]
    if seen.shape[1] < LEAST_WIDTH:  # too coarse to show more than noise between its markers
        return TouchSigns(0.0, 0.0)
    gel = np.ones(nocontact.shape[:2], np.uint8)
    for u, v in np.rint(np.concatenate([markers.points, markers.empty])).astype(int).tolist():
        cv2.circle(gel, (u, v), int(0.9 * markers.diameter) + 3, 0, -1)
    scale = nocontact.shape[1] / WIDTH
    size = round(seen.shape[1] / scale), round(seen.shape[0] / scale)
    levels = cv2.resize(seen, size, interpolation=cv2.INTER_AREA)
    weight = cv2.resize(gel[shown], size, interpolation=cv2.INTER_NEAREST).astype(np.float32)
    around, near = (cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)) for side in (SPOT, SPOT_MARGIN))
    weight[dark_spots(levels, around, near, INK)] = 0.0  # dust, and markers that were not found
    share = cv2.GaussianBlur(weight, (0, 0), SMOOTH)
    light = cv2.GaussianBlur(levels * weight[..., None], (0, 0), SMOOTH) / (share[..., None] + 1e-3)
    places = size[0] // CELL, size[1] // CELL
    light = cv2.resize(light, places, interpolation=cv2.INTER_AREA).reshape(-1, 3)
    known = cv2.resize(share, places, interpolation=cv2.INTER_AREA) > SHOWN
    inner = np.zeros_like(known)
    inner[RIM // CELL : -(RIM // CELL), RIM // CELL : -(RIM // CELL)] = True
    used = (known & inner).ravel()
    smooth = terms(places[1], places[0])[used]
    if len(smooth) < 4 * smooth.shape[1]:
        return TouchSigns(0.0, 0.0)
    light = light[used]
    logarithm, trust = np.log(light + DARK), np.ones(len(smooth))
    for _ in range(ROUNDS):
        weighted = smooth * trust[:, None]
        fit = np.linalg.lstsq(weighted.T @ smooth, weighted.T @ logarithm, rcond=None)[0]
        left = logarithm - smooth @ fit
        apart = np.abs(left).sum(axis=1)
        scatter = max(LEAST_SCATTER, 1.4826 * float(np.median(apart)))
        trust = np.maximum(0.0, 1.0 - (apart / (4.0 * scatter)) ** 2) ** 2
    left = left * light
    hue = np.abs(left - left.mean(axis=1, keepdims=True)).sum(axis=1)
    most, middle = np.percentile(hue, [97.0, 50.0])
    return TouchSigns(float(np.percentile(apart, 97.0)), float(most / max(middle, LEAST_HUE)))


def touch_of(nocontact: np.ndarray, markers: MarkerTracker, shown: tuple[slice, slice] = ALL) -> float:
    """How much a no-contact image looks as if something touched the gel; beyond 1 something does."""
    signs = touch_signs(nocontact, markers, shown)
    return min(signs.uneven / UNEVEN, signs.coloured / COLOURED)


def touch_fault(nocontact: np.ndarray, markers: MarkerTracker, shown: tuple[slice, slice], most: float) -> str:
    """The sign that something touches a sensor in its no-contact image, beyond `most` of `touch_of`; empty where nothing does."""
    if touch_of(nocontact, markers, shown) <= most:
        return ""
    return "something seems to touch the gel in the no-contact image, or dirt lies on it: between its markers the light is uneven"
