"""Readings of frames as `gelforge live` makes them, with known forces."""

import numpy as np

from gelforge.live.reading import Reading
from gelforge.reading.forcereading import ForceReading

GREY = np.full((6, 8, 3), 90, np.uint8)


def reading(number: int, flag: bool = False, image: np.ndarray = GREY, **changes) -> Reading:
    """Reading of frame `number` at 100 frames per second: `number` N of normal force in one cell of (4, 5)."""
    forces = np.zeros((3, 4, 5), np.float32)
    forces[:, 1, 1] = 0.0, 0.0, -number
    said = {
        "half_width": np.array([0.1, 0.2, 0.3]), "reason": "dark" if flag else "", "edge_peak": 0.0, "image": image,
        "moment": np.array([2.0, -1.5 * number, 0.1]), "moment_half_width": np.array([1.1, 1.2, 1.3]),
    }  # fmt: skip
    found = ForceReading(cells=forces, total=forces.sum((1, 2), dtype=np.float64), **(said | changes))
    return Reading(number, 0.01 * number, found, ms=3.0)
