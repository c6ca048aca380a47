"""Measurements in an image of a gel with markers, real or rendered."""

from dataclasses import dataclass

import cv2
import numpy as np

from gelforge.reading.markers import MarkerGrid, markers_in
from gelforge.virtualrig.appearance import HEIGHT, WIDTH, marker_free
from gelforge.virtualrig.render import unproject
from tests.support.surface_values import interpolate_surface


@dataclass(frozen=True)
class NoContact:
    """Measurements of a no-contact image: its markers, mean colours (3,), background (240, 320, 3) and noise (3,).

    background: smoothed over 4 px, valid on `free` (240, 320) only. noise: standard deviation of the difference from
    the image smoothed over 3 px, grey levels.
    """

    grid: MarkerGrid
    colour: np.ndarray
    background: np.ndarray
    free: np.ndarray
    noise: np.ndarray


def no_contact(image: np.ndarray, rows: int, cols: int) -> NoContact:
    """Measure a no-contact image, RGB (240, 320, 3) uint8."""
    grid = markers_in(image).grid(rows, cols)
    free = marker_free(grid.points, 1.2 * grid.diameter)
    picture = image.astype(np.float32)
    inner = cv2.erode(free.astype(np.uint8), np.ones((5, 5))) > 0
    noise = (picture - cv2.GaussianBlur(picture, (0, 0), 3.0))[inner].std(axis=0)
    return NoContact(grid, picture.mean(axis=(0, 1)), cv2.GaussianBlur(picture, (0, 0), 4.0), free, noise)


def background_correlation(a: NoContact, b: NoContact) -> np.ndarray:
    """Correlation per channel (3,) of two smoothed backgrounds over the pixels free of markers in both."""
    free = a.free & b.free
    return np.array([np.corrcoef(a.background[free][:, c], b.background[free][:, c])[0, 1] for c in range(3)])


def steepest(height: np.ndarray, centre, half_width: int = 20) -> np.ndarray:
    """Where the surface is steepest left, right, above and below `centre` (u, v), (4,) px from the image's corner.

    The slope is the median over strips of 2 `half_width` px through the centre; a parabola gives its peak to 0.1 px.
    """
    smooth = cv2.GaussianBlur(height, (0, 0), 1.0)
    u, v = (int(c) for c in centre)
    along_u = np.median(cv2.Sobel(smooth, cv2.CV_32F, 1, 0)[v - half_width : v + half_width], axis=0)
    along_v = np.median(cv2.Sobel(smooth, cv2.CV_32F, 0, 1)[:, u - half_width : u + half_width], axis=1)
    sides = _peak(-along_u[:u]), u + _peak(along_u[u:]), _peak(-along_v[:v]), v + _peak(along_v[v:])
    return np.array(sides) + 0.5


def _peak(profile: np.ndarray) -> float:
    k = int(np.argmax(profile))
    if not 0 < k < len(profile) - 1:
        return float(k)
    below, at, above = (float(profile[k + step]) for step in (-1, 0, 1))
    bend = below - 2 * at + above
    return k + (0.5 * (below - above) / bend if bend < 0 else 0.0)


def tracked_markers(
    before: np.ndarray, after: np.ndarray, expected: np.ndarray, start: np.ndarray, reach: float = 8.0
):
    """Displacement of markers between two images by their darkness-weighted centres, and which could be followed.

    start, expected: (n, 2) px, marker positions in `before` and roughly in `after`. Returns (n, 2) px and (n,) bool.
    """
    first, second = markers_in(before).points, markers_in(after).points
    i, near_first = _nearest(first, start)
    j, near_second = _nearest(second, expected)
    return second[j] - first[i], (near_first < reach) & (near_second < reach)


def _nearest(points: np.ndarray, to: np.ndarray):
    distance = np.linalg.norm(points[None] - to[:, None], axis=2)
    index = distance.argmin(axis=1)
    return index, distance[np.arange(len(to)), index]


def gel_points(camera, pixels: np.ndarray) -> np.ndarray:
    """Points (n, 2) mm of the unloaded gel that a camera (virtualrig.render.Renderer) sees at pixels (n, 2)."""
    return np.stack(unproject(camera.projection, pixels[:, 0], pixels[:, 1]), axis=1)


def markers_by_mechanics(camera, result) -> np.ndarray:
    """Expected image position of each printed marker's centre, from nodal displacements alone, (n, 2) px.

    It is the mean over the marker's area, because a marker's centre in an image is that of its area.
    """
    radius, angle = np.array([0.2, 0.5, 0.7, 0.87, 0.96]), np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = (
        camera.appearance.diameter / 2 * radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    ).reshape(-1, 2)
    pixels = (camera.appearance.markers[:, None] + ring[None]).reshape(-1, 2)
    xy = gel_points(camera, pixels)
    moved = interpolate_surface(result.mesh, result.displacement, xy)
    return camera.seen(xy, moved).reshape(len(camera.appearance.markers), -1, 2).mean(axis=1)


def inside_image(pixels: np.ndarray, margin: float) -> np.ndarray:
    """Which pixels (n, 2) lie at least `margin` px inside the image, (n,) bool."""
    return (pixels > margin).all(axis=1) & (pixels < [WIDTH - margin, HEIGHT - margin]).all(axis=1)
