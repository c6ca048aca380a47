"""The circle that a ball leaves in a picture, found without a mark by hand."""

from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.balls.balltable import BLUR_MM, RIM
from gelforge.networks.preprocess.illumination import match_light
from gelforge.records.markers import marker_mask

LEAST_LEVELS = 10.0  # of difference, blurred, below which nothing touches
RAYS, STEP_MM, FARTHEST_MM = 72, 0.03, 6.0  # rays from the circle's centre
ROUNDS = 6  # of rays from the centre found last
REACH = 3.0  # robust standard deviations beyond which a ray has no weight (Tukey's biweight)
LEAST_RAYS = 0.6  # of all rays must show the rim
CUT = "its imprint is cut by the picture's edge, press nearer to the middle"
ROUND = 0.12  # of its radius, by which the rim of a ball may deviate from a circle; a square's does by 0.15 and more


@dataclass(frozen=True)
class Circle:
    """Centre (u, v) and radius, px, counted from the image's corner."""

    u: float
    v: float
    radius: float

    def inside(self, shape: tuple[int, ...]) -> bool:
        """Whether all of it lies in an image of shape (h, w, …)."""
        height, width = shape[:2]
        return self.radius < self.u < width - self.radius and self.radius < self.v < height - self.radius


def find_rim(image: np.ndarray, nocontact: np.ndarray, px_per_mm: float) -> Circle:
    """The rim around a ball's imprint, images (h, w, 3) uint8 RGB of one size; BadInput where there is none.

    The rim is where the difference in brightness has fallen to RIM of its largest on that side (`balltable`).
    """
    difference = _difference(image, nocontact, px_per_mm)
    u, v = _middle(difference)
    radii = np.arange(1, int(FARTHEST_MM / STEP_MM)) * STEP_MM * px_per_mm
    angles = np.arange(RAYS) * 2.0 * np.pi / RAYS
    circle, deviation, seen = Circle(u, v, 0.0), np.inf, np.ones(RAYS, bool)
    for _ in range(ROUNDS):
        rim = _rim_on_rays(difference, circle, radii, angles)
        seen = np.isfinite(rim)
        if seen.mean() < LEAST_RAYS:
            raise BadInput(CUT)
        points = [circle.u + rim * np.cos(angles), circle.v + rim * np.sin(angles)]
        circle, deviation = fit_circle(np.stack(points, axis=1)[seen])
    if deviation > ROUND * circle.radius:
        whole = "its imprint is no circle, press one smooth ball straight down"
        raise BadInput(whole if seen.all() else CUT)
    return circle


def contact_place(image: np.ndarray, nocontact: np.ndarray, px_per_mm: float) -> tuple[float, float]:
    """Where (u, v) in px something touches, images as of `find_rim`; BadInput where nothing does."""
    return _middle(_difference(image, nocontact, px_per_mm))


def fit_circle(points: np.ndarray) -> tuple[Circle, float]:
    """Circle through points (n, 2) px by reweighted least squares (Kasa 1976), and the robust deviation of points from it, px."""
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
    return Circle(float(u), float(v), radius), deviation


def _difference(image: np.ndarray, nocontact: np.ndarray, px_per_mm: float) -> np.ndarray:
    """Difference (h, w) in levels between two images under one light, blurred, markers left out."""
    import cv2

    lit = match_light(image, nocontact).undo(image)
    difference = np.linalg.norm(np.subtract(lit, nocontact, dtype=np.float32), axis=2)
    weight = (~(marker_mask(nocontact, px_per_mm) | marker_mask(lit, px_per_mm))).astype(np.float32)
    sigma = BLUR_MM * px_per_mm
    blurred = cv2.GaussianBlur(difference * weight, (0, 0), sigma) / (cv2.GaussianBlur(weight, (0, 0), sigma) + 1e-3)
    return np.asarray(np.maximum(blurred - np.median(blurred), 0.0))


def _middle(difference: np.ndarray) -> tuple[float, float]:
    """Centre of the largest place that differs by half of the largest difference."""
    import cv2

    if difference.max() < LEAST_LEVELS:
        raise BadInput("nothing touches in it, press firmer")
    places = (difference > 0.5 * difference.max()).astype(np.uint8)
    _, _, measures, centres = cv2.connectedComponentsWithStats(places)
    u, v = centres[1 + measures[1:, cv2.CC_STAT_AREA].argmax()] + 0.5
    return float(u), float(v)


def _rim_on_rays(difference: np.ndarray, circle: Circle, radii: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Distance (n,) px from the centre at which each ray passes the rim; NaN for rays that leave the picture before."""
    import cv2

    u = circle.u - 0.5 + radii[:, None] * np.cos(angles)
    v = circle.v - 0.5 + radii[:, None] * np.sin(angles)
    seen = cv2.remap(
        difference,
        u.astype(np.float32),
        v.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=-1.0,
    )
    outside = (u < 0) | (v < 0) | (u > difference.shape[1] - 1) | (v > difference.shape[0] - 1)
    rim = np.full(len(angles), np.nan)
    for ray, levels in enumerate(seen.T):
        top = int(levels.argmax())
        past = top + int(np.argmax(levels[top:] < RIM * levels[top]))
        if past > top and not outside[past, ray]:
            part = (levels[past - 1] - RIM * levels[top]) / (levels[past - 1] - levels[past])
            rim[ray] = radii[past - 1] + part * (radii[past] - radii[past - 1])
    return rim
