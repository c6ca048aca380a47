"""Fit the parametric illumination of an appearance to a real no-contact image."""

import cv2
import numpy as np

from gelforge.errors import BadInput
from gelforge.virtualrig.appearance import HEIGHT, TERMS, WIDTH, normalised_pixels

DARKER = 0.72  # of its surroundings, from which a spot is a marker


def marker_spots(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Dark round spots of a gel with markers: centres (n, 2) px from the image's corner, diameters (n,) px of equal area.

    A spot is a connected part darker than DARKER times its surroundings, 40 to 500 pixels large.
    Centres are weighted by darkness, which is good to about 0.05 px on a sharp picture.
    """
    grey = image.astype(np.float32).mean(axis=2)
    around = cv2.GaussianBlur(cv2.medianBlur(np.rint(grey).astype(np.uint8), 61).astype(np.float32), (0, 0), 8)
    ratio = cv2.GaussianBlur(grey / np.maximum(around, 1.0), (0, 0), 0.8)
    count, label, stats, _ = cv2.connectedComponentsWithStats((ratio < DARKER).astype(np.uint8), connectivity=4)
    centres, diameters = [], []
    for k in range(1, count):
        left, top, width, height, area = stats[k]
        if not 40 <= area <= 500 or max(width, height) > 2.2 * min(width, height):
            continue
        window = np.s_[
            max(top - 2, 0) : min(top + height + 2, HEIGHT), max(left - 2, 0) : min(left + width + 2, WIDTH)
        ]
        near = cv2.dilate((label[window] == k).astype(np.uint8), np.ones((3, 3)))
        weight = np.clip(1.0 - ratio[window], 0.0, None) * near
        v, u = np.mgrid[window] + 0.5
        centres.append([(weight * u).sum() / weight.sum(), (weight * v).sum() / weight.sum()])
        diameters.append(2.0 * np.sqrt(area / np.pi))
    return np.array(centres).reshape(-1, 2), np.array(diameters)


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
    centres, diameters = marker_spots(image)
    if not len(centres):
        raise BadInput("no dark spots were found; give a picture of a gel with markers without contact")
    mask = marker_free(centres, 1.1 * float(np.median(diameters)))
    s, t = normalised_pixels()
    powers = np.stack([s[mask] ** i * t[mask] ** j for i, j in TERMS], axis=1)
    return np.linalg.lstsq(powers, image[mask].astype(float), rcond=None)[0]
