"""Moved images of a sensor, for tests and benchmarks."""

import cv2
import numpy as np


def moved(image: np.ndarray, shift=(0.0, 0.0), turn: float = 0.0, zoom: float = 1.0) -> np.ndarray:
    """The image (h, w, 3) shifted, zoomed and turned about its centre; turn in degrees, positive from u towards v."""
    h, w = image.shape[:2]
    matrix = cv2.getRotationMatrix2D((w / 2, h / 2), -turn, zoom)
    matrix[:, 2] += shift
    return cv2.warpAffine(image, matrix, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
