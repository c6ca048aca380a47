"""A homography from point correspondences, and whether it can be had from them at all."""

from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput
from gelforge.labelling.sensor import transform

DEGENERATE = 1e-6  # of the largest singular value of the design matrix: below, a second homography fits as well
ON_A_LINE = 1e-3  # of the points' largest extent: three points, or all, closer to one line than this count as on it
STEPS = 20


@dataclass(frozen=True)
class Fit:
    """homography (3, 3) with last element 1, residual (n,) px of each point."""

    homography: np.ndarray
    residual: np.ndarray

    @property
    def rms(self) -> float:
        return float(np.sqrt((self.residual**2).mean()))


def fit_homography(gel: np.ndarray, pixels: np.ndarray, where: str = "correspondences") -> Fit:
    """Least-squares homography from gel points (n, 2) mm to pixels (n, 2), n >= 4.

    Normalised direct linear transform, then Gauss-Newton on the distance in the image (Hartley and
    Zisserman, Multiple View Geometry, algorithms 4.2 and 4.3). Sets that do not determine it raise BadInput
    with the reason.
    """
    gel, pixels = np.asarray(gel, float), np.asarray(pixels, float)
    check_points(gel, pixels, where)
    to_gel, to_pixel = _normaliser(gel), _normaliser(pixels)
    design = _design(transform(to_gel, gel), transform(to_pixel, pixels))
    singular, right = np.linalg.svd(design)[1:]
    if singular[7] < DEGENERATE * singular[0]:
        raise BadInput(f"{where}: the points leave more than one projection possible; spread them over the image")
    homography = np.linalg.inv(to_pixel) @ right[8].reshape(3, 3) @ to_gel
    if abs(homography[2, 2]) < 1e-12 * np.abs(homography).max():
        raise BadInput(f"{where}: the projection sends the gel's centre to infinity; check the pixel coordinates")
    homography = _refine(homography / homography[2, 2], gel, pixels)
    return Fit(homography, np.hypot(*(transform(homography, gel) - pixels).T))


def check_points(gel, pixels, where) -> None:
    """Raise BadInput for fewer than four points, repeated ones, all on a line, or three of four on one."""
    if len(gel) != len(pixels) or gel.ndim != 2 or gel.shape[1:] != (2,) or pixels.shape != gel.shape:
        raise BadInput(
            f"{where}: {len(gel)} gel points and {len(pixels)} pixels; give one pixel (u, v) per point (x, y)"
        )
    if len(gel) < 4:
        raise BadInput(f"{where}: {len(gel)} points; a projection needs at least four")
    if not (np.isfinite(gel).all() and np.isfinite(pixels).all()):
        raise BadInput(f"{where}: a coordinate is not a finite number; correct it")
    for points, unit in ((gel, "gel"), (pixels, "image")):
        _check_spread(points, f"{where}: in the {unit}, ")


def _check_spread(points, where) -> None:
    extent = np.ptp(points, axis=0).max()
    apart = np.hypot(*(points[:, None] - points[None]).T)
    apart[np.diag_indices(len(points))] = np.inf
    if apart.min() <= ON_A_LINE * extent:
        pair = sorted(int(k) + 1 for k in np.unravel_index(apart.argmin(), apart.shape))
        raise BadInput(f"{where}points {pair[0]} and {pair[1]} are the same; give different ones")
    if _thickness(points) <= ON_A_LINE * extent:
        raise BadInput(f"{where}all points lie on one line; add points beside it")
    if sum(_thickness(np.delete(points, k, axis=0)) > ON_A_LINE * extent for k in range(len(points))) < len(points):
        raise BadInput(f"{where}all points but one lie on one line; add points beside it")


def _thickness(points) -> float:
    """Largest distance of the points from the line that fits them best."""
    centred = points - points.mean(axis=0)
    return float(np.abs(centred @ np.linalg.svd(centred, full_matrices=False)[2][1]).max())


def _normaliser(points) -> np.ndarray:
    """Similarity that moves points to the origin at a mean distance of sqrt(2)."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / np.hypot(*(points - centre).T).mean()
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])


def _design(source, target) -> np.ndarray:
    ones, zeros = np.ones((len(source), 1)), np.zeros((len(source), 3))
    lifted = np.hstack([source, ones])
    rows = [np.hstack([lifted, zeros, -target[:, :1] * lifted]), np.hstack([zeros, lifted, -target[:, 1:] * lifted])]
    return np.vstack(rows)


def _refine(homography, gel, pixels) -> np.ndarray:
    """Gauss-Newton on the eight free elements, kept only while it lowers the residual."""
    lifted = np.hstack([gel, np.ones((len(gel), 1))])
    best = homography
    for _ in range(STEPS):
        scale = lifted @ best[2]
        seen = (lifted @ best[:2].T) / scale[:, None]
        part, zeros = lifted / scale[:, None], np.zeros_like(lifted)
        jacobian = np.vstack(
            [
                np.hstack([part, zeros, -seen[:, :1] * part[:, :2]]),
                np.hstack([zeros, part, -seen[:, 1:] * part[:, :2]]),
            ]
        )
        step = np.linalg.lstsq(jacobian, (pixels - seen).T.ravel(), rcond=None)[0]
        trial = best + np.append(step, 0.0).reshape(3, 3)
        if ((transform(trial, gel) - pixels) ** 2).sum() >= ((seen - pixels) ** 2).sum():
            break
        best = trial
    return best
