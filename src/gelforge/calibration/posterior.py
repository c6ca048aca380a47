"""Log-probability of a calibration model given force readings, for all walkers at once."""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from gelforge.calibration.emulator import Emulator
from gelforge.calibration.parameters import TARE, Model

# By how much emulated forces err from press to press, measured by solves of the demo's presses on fine hexahedra at other
# friction and depth (make benchmark-calibration): the normal force by a fraction of itself; sideways forces by one of
# themselves and, where a press hardly moves sideways, one of the normal force. Without it a thousandth of a firm press' force
# would decide on friction.
ERROR = 0.01
SIDEWAYS_ERROR, SIDEWAYS_ERROR_OF_NORMAL = 0.04, 0.002


@dataclass(frozen=True)
class Posterior:
    """Readings, emulator and model.

    depth: (n,) commanded, mm. observed: (n, 3) N on the gel, nan where a component does not serve.
    tail: degrees of freedom of Student's t, the robust likelihood (Lange, Little, Taylor 1989).
    """

    emulator: Emulator
    model: Model
    depth: np.ndarray
    observed: np.ndarray
    tail: float

    def predict(self, coordinates) -> tuple[np.ndarray, np.ndarray]:
        """Noise-free readings and scale of the likelihood, each (w, n, 3) N.

        A reading is the force on the gel and the sensor's constant force. The scale holds the sensor's noise and, in
        quadrature, what the scatter of touch from press to press makes of the slope of force over depth, and what the
        emulator errs by.
        """
        values = self.model.values(coordinates)
        forces, slopes, _ = self.emulator.forces(self.depth, values)
        return forces + tare_of(values)[:, None], self.scale(forces, slopes, values)

    @staticmethod
    def scale(forces, slopes, values: dict) -> np.ndarray:
        """Scale of the likelihood (w, n, 3) at forces (w, n, 3) N and slopes (w, n, 3) N per mm."""
        noise, scatter = (values[name][:, None, None] for name in ("noise", "scatter"))
        variance = noise**2 + (scatter * slopes) ** 2
        normal, sideways = forces[..., 2] ** 2, (forces[..., :2] ** 2).sum(axis=2)
        variance[..., :2] += (SIDEWAYS_ERROR**2 * sideways + SIDEWAYS_ERROR_OF_NORMAL**2 * normal)[..., None]
        variance[..., 2] += ERROR**2 * normal
        return np.sqrt(variance)

    def pointwise(self, coordinates) -> np.ndarray:
        """Log-likelihood of every reading that serves, (w, r)."""
        forces, scale = self.predict(coordinates)
        used = np.isfinite(self.observed)
        scale = scale[:, used]
        z = (self.observed[used] - forces[:, used]) / scale
        v = self.tail
        constant = gammaln((v + 1) / 2) - gammaln(v / 2) - 0.5 * np.log(v * np.pi)
        return constant - np.log(scale) - (v + 1) / 2 * np.log1p(z * z / v)

    def __call__(self, coordinates) -> np.ndarray:
        """Log-probability (w,) at coordinates (w, free); -inf outside the priors, and where a force is no number."""
        coordinates = np.atleast_2d(coordinates)
        total = self.model.log_prior(coordinates)
        inside = np.isfinite(total)
        if inside.any():
            total[inside] += self.pointwise(coordinates[inside]).sum(axis=1)
        return np.where(np.isnan(total), -np.inf, total)


def tare_of(values: dict) -> np.ndarray:
    """The sensor's constant force, (w, 3) N."""
    return np.stack([values[name] for name in TARE], axis=1)
