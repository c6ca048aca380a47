"""Detects a contact in a no-contact image, from that image alone.

A gel that nothing touches is lit smoothly: the logarithm of its light is a polynomial of position. An imprint departs
from it on units of any contrast, and in colour more than in level, because its slopes face different lamps.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gelforge.reading.light import ALL
from gelforge.reading.markers import MarkerTracker, dark_spots

# Limits of TouchSigns: a contact exceeds both. So do 3 % of 108 clean no-contact images of rendered units, none of 4
# real ones at rest, one of the starts of 40 real films (a stain), and all of 245 presses of 0.5 N and more, rendered
# for 22 units and real.
UNEVEN, COLOURED = 0.075, 3.2
# px: width to which an image is reduced, its own least width, border that is left out, size of a cell.
WIDTH, LEAST_WIDTH, RIM, CELL = 320.0, 160, 12, 4
SPOT, SPOT_MARGIN, INK = 25, 7, 0.15  # px above a dark spot's size; px of margin around it; how much darker it is
SMOOTH, ORDER, ROUNDS = 2.0, 6, 8  # px of smoothing; order of the polynomial; rounds of the fit
# Least fraction of gel in a cell; levels added before the logarithm; least scatter of the fit; least median of the
# departure in colour, levels.
SHOWN, DARK, LEAST_SCATTER, LEAST_HUE = 0.2, 8.0, 0.006, 0.2


@dataclass(frozen=True)
class TouchSigns:
    """Departure of the light between markers from the smooth fit.

    uneven: its 97 % quantile, as a fraction of the light, summed over the three colours. coloured: the 97 % quantile
    of the departure in colour alone, over its median.
    """

    uneven: float
    coloured: float


@lru_cache(maxsize=4)
def terms(rows: int, cols: int) -> np.ndarray:
    """Polynomial terms of row and column up to ORDER, (rows * cols, n), both scaled to -1 to 1."""
    v, u = np.meshgrid(np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, cols), indexing="ij")
    powers = [(i, j) for i in range(ORDER + 1) for j in range(ORDER + 1 - i)]
    return np.stack([u**i * v**j for i, j in powers], axis=-1).reshape(rows * cols, -1)


def touch_signs(nocontact: np.ndarray, markers: MarkerTracker, shown: tuple[slice, slice] = ALL) -> TouchSigns:
    """Signs of touch in a no-contact image (h, w, 3) uint8 with its markers; shown: rows and columns of it that show something.

    The fit is robust (Tukey's biweight), so that it follows the light around an object and not the object. Lattice
    places without a marker are masked as markers are: the rest of a worn marker is no object.
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
    """How much a no-contact image looks as if something touched the gel; above 1 something does."""
    signs = touch_signs(nocontact, markers, shown)
    return min(signs.uneven / UNEVEN, signs.coloured / COLOURED)
