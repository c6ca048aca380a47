"""The circle that a ball leaves in an image, found to a fraction of a pixel without a mark by hand.

Its rim is where the difference in brightness beside the no-contact image, markers painted over, has fallen to RIM of its largest
along a ray from the middle; a circle is fitted to all rays.
"""

import cv2
import numpy as np

from gelforge.reading.pair import Pair
from gelforge.reading.wear import painted_over, places_in

LEAST_LEVELS = 10.0  # of difference, blurred, below which nothing touches
BLUR_PX, RIM = 2.5, 0.6
RAYS, STEP_PX, FARTHEST_PX = 72, 0.5, 90.0  # rays from the circle's centre
ROUNDS = 6  # of rays from the centre found last
REACH = 3.0  # robust standard deviations beyond which a ray has no weight (Tukey's biweight)
LEAST_RAYS = 0.6  # of all rays must show the rim
ROUND = 0.12  # of its radius, by which the rim of a ball may deviate from a circle


def found_radius(seen: Pair) -> float:
    """Radius in px of the rim around the imprint in a prepared image; NaN where no circle lies completely in it."""
    difference = _difference(seen)
    if difference.max() < LEAST_LEVELS:
        return np.nan
    _, _, measures, centres = cv2.connectedComponentsWithStats((difference > 0.5 * difference.max()).astype(np.uint8))
    u, v = centres[1 + measures[1:, cv2.CC_STAT_AREA].argmax()]
    radius, deviation = np.nan, np.inf
    angles = np.arange(RAYS) * 2.0 * np.pi / RAYS
    for _ in range(ROUNDS):
        rim = _rim_on_rays(difference, u, v, angles)
        known = np.isfinite(rim)
        if known.mean() < LEAST_RAYS:
            return np.nan
        points = np.stack([u + rim * np.cos(angles), v + rim * np.sin(angles)], axis=1)[known]
        u, v, radius, deviation = _circle(points)
    height, width = difference.shape
    whole = radius <= u < width - radius and radius <= v < height - radius
    return radius if whole and deviation <= ROUND * radius else np.nan


def _difference(seen: Pair) -> np.ndarray:
    """Difference (h, w) in levels from the no-contact image, blurred, markers painted over in both."""
    nocontact = seen.nocontact
    diameter, before = nocontact.markers.diameter, nocontact.markers.points
    bare = [
        cv2.GaussianBlur(painted_over(image, points, diameter).astype(np.float32), (0, 0), BLUR_PX)
        for image, points in (
            (nocontact.picture.image, before),
            (seen.lit.image, places_in(seen.tracks, nocontact.markers)),
        )
    ]
    difference = np.linalg.norm(bare[1] - bare[0], axis=2)
    return np.maximum(difference - np.median(difference), 0.0)


def _circle(points: np.ndarray) -> tuple[float, float, float, float]:
    """Centre u, v and radius of the circle through points (n, 2) px (Kasa 1976, reweighted), and their robust deviation, px."""
    weight = np.ones(len(points))
    for _ in range(10):
        sides = np.column_stack([points, np.ones(len(points))]) * weight[:, None]
        u, v, rest = np.linalg.lstsq(sides, (points**2).sum(axis=1) * weight, rcond=None)[0] * (0.5, 0.5, 1.0)
        radius = float(np.sqrt(max(rest + u * u + v * v, 0.0)))
        off = np.hypot(points[:, 0] - u, points[:, 1] - v) - radius
        deviation = 1.4826 * float(np.median(np.abs(off)))
        weight = np.maximum(1.0 - (off / (REACH * max(deviation, 1e-3 * radius + 1e-9))) ** 2, 0.0)
        if np.count_nonzero(weight) < 3:
            break
    return float(u), float(v), radius, deviation


def _rim_on_rays(difference: np.ndarray, u: float, v: float, angles: np.ndarray) -> np.ndarray:
    """Distance (n,) px from a centre at which each ray passes the rim; NaN for rays that leave the image before."""
    radii = np.arange(STEP_PX, FARTHEST_PX, STEP_PX)
    x = (u + radii[:, None] * np.cos(angles)).astype(np.float32)
    y = (v + radii[:, None] * np.sin(angles)).astype(np.float32)
    levels = cv2.remap(difference, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0)
    rim = np.full(len(angles), np.nan)
    for ray, seen in enumerate(levels.T):
        top = int(seen.argmax())
        past = top + int(np.argmax(seen[top:] < RIM * seen[top]))
        if past > top and seen[past] >= 0:
            part = (seen[past - 1] - RIM * seen[top]) / (seen[past - 1] - seen[past])
            rim[ray] = radii[past - 1] + part * STEP_PX
    return rim
