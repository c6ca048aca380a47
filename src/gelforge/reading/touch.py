"""Whether something touches the gel in a no-contact image, seen by that image alone.

An object leaves shading over several millimetres, its texture between the markers, and bends the lattice of markers or moves it off its
plane. No sign suffices by itself.
"""

from dataclasses import dataclass

import numpy as np

from gelforge.reading.light import ALL
from gelforge.reading.markers import Markers, dark_spots

# Signs of touch from which something touches. Of 40 clean no-contact images of drawn units 2.5 % are beyond one of them, of 44 real ones at
# rest none; of presses of strong and usual contrast nearly all, of the weakest contrast half.
TOUCHED = {"shade": 22.0, "texture": 9.0, "grain": 14.0, "bend": 4.5, "plane": 6.0}
SPOT, SPOT_MARGIN, INK = (
    25,
    7,
    0.15,
)  # px at that width, larger than a dark spot and left out around one; how much darker it is
TOUCH_WIDTH, TOUCH_RIM, LEAST_PLANE = (
    320.0,
    8,
    12,
)  # px of width at which touch is looked for, of its border that is left out; fewest markers


@dataclass(frozen=True)
class TouchSigns:
    """What an object leaves in an image of the gel that it presses.

    shade: levels of the three colours together by which the light between markers is uneven within a few markers' distance, 99.5 %.
    texture: the same over 0.8 to 3 px; grain: over 3 to 10 px, 99 %. bend: px, by which a marker stands beside the middle of two neighbours. plane: px beside the
    places of an even print, the largest of all markers. All at 320 px of width.
    """

    shade: float
    texture: float
    grain: float
    bend: float
    plane: float


def touch_signs(nocontact: np.ndarray, markers: Markers, shown: tuple[slice, slice] = ALL) -> TouchSigns:
    """Signs of touch in a no-contact image (h, w, 3) uint8 with its markers; shown: rows and columns of it that show something."""
    import cv2

    seen = nocontact[shown]
    gel = np.ones(nocontact.shape[:2], np.uint8)
    for u, v in markers.points.astype(int).tolist():
        cv2.circle(gel, (u, v), int(0.9 * markers.diameter) + 3, 0, -1)
    scale = nocontact.shape[1] / TOUCH_WIDTH
    size = round(seen.shape[1] / scale), round(seen.shape[0] / scale)
    levels = cv2.resize(seen, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    weight = cv2.resize(gel[shown], size, interpolation=cv2.INTER_NEAREST).astype(np.float32)
    ellipse = cv2.MORPH_ELLIPSE
    around, near = (cv2.getStructuringElement(ellipse, (side, side)) for side in (SPOT, SPOT_MARGIN))
    weight[dark_spots(levels.astype(np.uint8), around, near, INK)] = 0.0  # dust, and markers that were not found
    inner = np.s_[TOUCH_RIM:-TOUCH_RIM, TOUCH_RIM:-TOUCH_RIM]
    between = weight[inner] > 0
    if not between.any():
        return TouchSigns(0.0, 0.0, 0.0, 0.0, 0.0)

    def smooth(width: float) -> np.ndarray:
        around = cv2.GaussianBlur(weight, (0, 0), width)[..., None] + 1e-3
        return cv2.GaussianBlur(levels * weight[..., None], (0, 0), width) / around

    fine, middle, coarse, wide = (smooth(width) for width in (0.8, 3.0, 10.0, 16.0))
    texture, grain, shade = (
        float(np.percentile(np.abs(one - other).sum(axis=2)[inner][between], percentile))
        for one, other, percentile in ((fine, middle, 99.0), (middle, coarse, 99.0), (middle, wide, 99.5))
    )
    index, used = markers.lattice
    if len(used) < LEAST_PLANE:
        return TouchSigns(shade, texture, grain, 0.0, 0.0)
    points = markers.points[used] / scale
    low = index.min(axis=0)
    extent = np.ptp(index, axis=0) + 1
    lattice = np.zeros((3, *extent.tolist()))
    rows, cols = (index - low).T
    lattice[:2, rows, cols], lattice[2, rows, cols] = points.T, 1.0
    bent = bends(lattice)
    design = np.column_stack([np.ones(len(index)), index])
    beside = points - design @ np.linalg.lstsq(design, points, rcond=None)[0]
    return TouchSigns(shade, texture, grain, float(bent.max(initial=0.0)), float(np.hypot(*beside.T).max()))


def touch_of(nocontact: np.ndarray, markers: Markers, shown: tuple[slice, slice] = ALL) -> float:
    """How much a no-contact image looks as if something touched the gel; beyond 1 something does."""
    signs = touch_signs(nocontact, markers, shown)
    return max(getattr(signs, name) / limit for name, limit in TOUCHED.items())


def touch_fault(nocontact: np.ndarray, markers: Markers, shown: tuple[slice, slice], most: float = 1.0) -> str:
    """The sign that something touches a sensor in its no-contact image, beyond `most` of `touch_of`; empty where nothing does."""
    if touch_of(nocontact, markers, shown) <= most:
        return ""
    return (
        "something seems to touch the gel in the no-contact image, or dirt lies on it: between its markers the light is uneven, or they stand"
        " unevenly"
    )


def bends(moved: np.ndarray) -> np.ndarray:
    """How far places (3, rows, cols), the third 1 where there is one, depart from the middle of two neighbours', (n,) px."""
    found = []
    for rows in (moved, moved.transpose(0, 2, 1)):
        known = (rows[2, :, :-2] > 0) & (rows[2, :, 1:-1] > 0) & (rows[2, :, 2:] > 0)
        beside = rows[:2, :, 1:-1] - (rows[:2, :, :-2] + rows[:2, :, 2:]) / 2
        found.append(np.hypot(*beside[:, known]))
    return np.concatenate(found)
