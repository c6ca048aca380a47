"""Fit the parametric illumination of an appearance to a real no-contact image."""

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.markers import markers_in
from gelforge.virtualrig.appearance import HEIGHT, TERMS, WIDTH, normalised_pixels


def marker_free(centres: np.ndarray, radius: float) -> np.ndarray:
    """Mask (240, 320) of the pixels farther than `radius` px from every centre."""
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    mask = np.ones((HEIGHT, WIDTH), bool)
    for cu, cv_ in centres:
        mask &= np.hypot(u - cu, v - cv_) > radius
    return mask


def fit_background(image: np.ndarray) -> np.ndarray:
    """Coefficients (15, 3) of Appearance.background by least squares over the marker-free pixels of an RGB image."""
    if image.shape != (HEIGHT, WIDTH, 3):
        raise BadInput(
            f"an image of shape {image.shape} was given; an appearance is fitted to {WIDTH} x {HEIGHT} RGB"
        )
    markers = markers_in(image)
    if not len(markers.points):
        raise BadInput("no dark spots were found; give a picture of a gel with markers without contact")
    mask = marker_free(markers.points, 1.1 * markers.diameter)
    s, t = normalised_pixels()
    powers = np.stack([s[mask] ** i * t[mask] ** j for i, j in TERMS], axis=1)
    return np.linalg.lstsq(powers, image[mask].astype(float), rcond=None)[0]
