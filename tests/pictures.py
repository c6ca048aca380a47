"""Pictures of a sensor seen otherwise, for tests and benchmarks."""

import cv2
import numpy as np


def moved(image: np.ndarray, shift=(0.0, 0.0), turn: float = 0.0, zoom: float = 1.0) -> np.ndarray:
    """The picture (h, w, 3) with every point moved about its middle; turn in degrees, positive from u towards v."""
    h, w = image.shape[:2]
    matrix = cv2.getRotationMatrix2D((w / 2, h / 2), -turn, zoom)
    matrix[:, 2] += shift
    return cv2.warpAffine(image, matrix, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def distance_of(
    placement, points: np.ndarray, shift=(0.0, 0.0), turn: float = 0.0, zoom: float = 1.0, size=(240, 320)
) -> float:
    """How far a placement (networks.placement) takes points (n, 2) from where `moved` does, px, root mean square.

    size: (height, width) of the picture.
    """
    matrix = cv2.getRotationMatrix2D((size[1] / 2, size[0] / 2), -turn, zoom)
    wanted, found = (points @ linear[:, :2].T + linear[:, 2] for linear in (matrix, placement.matrix))
    return float(np.sqrt(((found - wanted - shift) ** 2).sum(axis=1).mean()))
