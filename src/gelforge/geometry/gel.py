"""The gel pad: outline and top surface."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gel:
    """GelSight Mini gel in the gel frame (mm): crown at the origin, z out of the gel."""

    name: str = "gelsight_mini"
    width: float = 20.75  # along x
    length: float = 25.25  # along y
    corner_radius: float = 1.5
    height: float = 4.0

    def top(self, x, y) -> np.ndarray:
        """Height z of the undeformed top surface at (x, y), mm (clamped to the outline)."""
        x, y = np.abs(np.asarray(x, float)), np.abs(np.asarray(y, float))
        return -(x**2 / (2 * 113.7) + y**2 / (2 * 188.3))
