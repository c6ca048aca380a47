"""A homography from point correspondences, and whether they determine it."""

from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput
from gelforge.labelling.sensor import transform

ON_A_LINE = 1e-3  # tolerance, fraction of the points' extent, for points on one line and for equal points


@dataclass(frozen=True)
class Fit:
    """homography (3, 3) with last element 1, residual (n,) px of each point."""

    homography: np.ndarray
    residual: np.ndarray

    @property
    def rms(self) -> float:
        return float(np.sqrt((self.residual**2).mean()))


def fit_homography(gel: np.ndarray, pixels: np.ndarray, where: str = "correspondences") -> Fit:
    """Least-squares homography from gel points (n, 2) mm to pixels (n, 2), n >= 4, by distance in the image.

    OpenCV's result, accurate to 1e-5 px, is refined by scipy. Points that do not determine it raise BadInput with the
    reason.
    """
    import cv2
    from scipy.optimize import least_squares

    gel, pixels = np.asarray(gel, float), np.asarray(pixels, float)
    check_points(gel, pixels, where)
    near, _ = cv2.findHomography(gel, pixels)
    if near is None or not np.isfinite(near).all():
        raise BadInput(f"{where}: the projection sends the gel's centre to infinity; check the pixel coordinates")

    def off(eight: np.ndarray) -> np.ndarray:
        return (transform(np.append(eight, 1.0).reshape(3, 3), gel) - pixels).ravel()

    found = least_squares(off, near.ravel()[:8], method="lm", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return Fit(np.append(found.x, 1.0).reshape(3, 3), np.hypot(*off(found.x).reshape(-1, 2).T))


def check_points(gel, pixels, where) -> None:
    """Raise BadInput for fewer than four, repeated or infinite points, or if all, or all but one, are on a line."""
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
