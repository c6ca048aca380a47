"""Moment of a map of forces about the apex: the middle of the gel's undeformed surface, the origin of the gel frame.

A cell is a piece of the undeformed surface and follows it, so its force acts where this piece has moved to. A map says
how far, by the compliance of an elastic layer on a rigid base: for an incompressible layer, of shear modulus G = 2 C10,
the displacement of the surface is (Johnson, Contact Mechanics, section 5.8; here for waves of wave number k, q = k h, by
Fourier transform, with D = cosh 2q + 1 + 2 q^2)

    along the wave  (sinh 2q + 2q) / (2 G k D),   across it  tanh q / (G k),   normal  (sinh 2q - 2q) / (2 G k D).

What couples along and normal adds nothing to the moment. Without this displacement moments are off by up to 3 % of
force times 10 mm where a press goes sideways, with it by up to 0.9 % (48 presses of the demo; against the nodes' moment).
"""

import numpy as np

from gelforge.geometry.gel import load_gel
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.material import REFERENCE_C10

LEAST_CELLS = 3  # rows and columns of a map; on fewer the place of a force is not known
PADDED = 2  # times as many rows and columns, so that no force acts across the edge of the map
FLAT = 20.0  # q from which the layer is as compliant as a half-space; larger ones overflow


class Arms:
    """Where the forces of a map act, for one sensor and grid."""

    def __init__(self, sensor: Sensor, grid: Grid) -> None:
        (rows, cols), (width, height), gel = grid.shape, sensor.image, load_gel(sensor.gel)
        u, v = np.meshgrid((np.arange(cols) + 0.5) * width / cols, (np.arange(rows) + 0.5) * height / rows)
        flat = sensor.unproject(np.stack([u, v], axis=-1))
        self.grid = grid
        self.places = np.concatenate([flat, gel.top(flat[..., 0], flat[..., 1])[..., None]], axis=-1)
        middle = np.array([width, height]) / 2
        corners = sensor.unproject(middle + np.array([[0.0, 0.0], [width / cols, 0.0], [0.0, height / rows]]))
        steps = corners[1:] - corners[0]  # of one column and of one row, mm along gel x and y
        waves = np.meshgrid(np.fft.fftfreq(PADDED * cols), np.fft.fftfreq(PADDED * rows))
        kx, ky = np.einsum("ij,jrc->irc", 2.0 * np.pi * np.linalg.inv(steps), np.array(waves))
        kx[0, 0] = 1e-9  # the mean of a map is a wave, too, of any direction
        k = np.hypot(kx, ky)
        q = np.minimum(k * gel.height, FLAT)
        bottom = 2.0 * k * (np.cosh(2.0 * q) + 1.0 + 2.0 * q**2) * abs(np.linalg.det(steps))
        along, normal = (np.sinh(2.0 * q) + 2.0 * q) / bottom, (np.sinh(2.0 * q) - 2.0 * q) / bottom
        across = np.tanh(q) / (k * abs(np.linalg.det(steps)))
        x, y = kx / k, ky / k
        zero = np.zeros_like(k)
        # (3, 3, rows, cols) mm MPa / N
        self._compliance = np.array([
            [x * x * along + y * y * across, x * y * (along - across), zero],
            [x * y * (along - across), y * y * along + x * x * across, zero],
            [zero, zero, normal],
        ])  # fmt: skip

    def displacement(self, cells: np.ndarray, c10: float = REFERENCE_C10) -> np.ndarray:
        """Displacement (3, rows, cols) mm of the surface under forces (3, rows, cols) N; c10 in MPa."""
        rows, cols = self.grid.shape
        waves = np.fft.fft2(cells, s=(PADDED * rows, PADDED * cols))
        moved = np.fft.ifft2(np.einsum("ijrc,jrc->irc", self._compliance, waves)).real
        return moved[:, :rows, :cols] / (2.0 * c10)

    def moment(self, cells: np.ndarray, c10: float = REFERENCE_C10) -> np.ndarray:
        """Moment (3,) N mm on the gel about its apex, along gel x, y, z, of forces (3, rows, cols) N per cell.

        c10: stiffness of the gel, MPa. NaN where the map has fewer than three rows or columns.
        """
        if min(self.grid.shape) < LEAST_CELLS:
            return np.full(3, np.nan)
        force = np.asarray(cells, float)
        arms = self.places + np.moveaxis(self.displacement(force, c10), 0, -1)
        return np.cross(arms, np.moveaxis(force, 0, -1)).sum(axis=(0, 1))
