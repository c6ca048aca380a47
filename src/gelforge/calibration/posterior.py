"""Log-probability of a calibration model given force readings, for all walkers at once."""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from gelforge.calibration.emulator import Emulator
from gelforge.calibration.parameters import Model


@dataclass(frozen=True)
class Posterior:
    """Readings, emulator and model.

    depth: (n,) commanded, mm. observed: (n, 3) N on the gel, nan where a component does not serve.
    tail: degrees of freedom of Student's t, the robust likelihood (Lange, Little, Taylor 1989).
    model_error: standard error of the emulator, as a fraction of the force of each reading.
    """

    emulator: Emulator
    model: Model
    depth: np.ndarray
    observed: np.ndarray
    tail: float
    model_error: float

    def predict(self, coordinates) -> tuple[np.ndarray, dict]:
        """Noise-free forces (w, n, 3) and the parameter values."""
        values = self.model.values(coordinates)
        return self.emulator.forces(self.depth, values)[0], values

    def scale(self, forces, noise) -> np.ndarray:
        """Scale of the likelihood, (w, n): noise and emulator error in quadrature, N."""
        size = np.sqrt((forces**2).sum(axis=2))
        return np.sqrt(noise[:, None] ** 2 + (self.model_error * size) ** 2)

    def pointwise(self, coordinates) -> np.ndarray:
        """Log-likelihood of every reading that serves, (w, r)."""
        forces, values = self.predict(coordinates)
        used = np.isfinite(self.observed)
        scale = np.broadcast_to(self.scale(forces, values["noise"])[:, :, None], forces.shape)[:, used]
        z = (self.observed[used] - forces[:, used]) / scale
        v = self.tail
        constant = gammaln((v + 1) / 2) - gammaln(v / 2) - 0.5 * np.log(v * np.pi)
        return constant - np.log(scale) - (v + 1) / 2 * np.log1p(z * z / v)

    def __call__(self, coordinates) -> np.ndarray:
        """Log-probability (w,) at coordinates (w, free); -inf outside the priors."""
        coordinates = np.atleast_2d(coordinates)
        total = self.model.log_prior(coordinates)
        inside = np.isfinite(total)
        if inside.any():
            total[inside] += self.pointwise(coordinates[inside]).sum(axis=1)
        return np.where(np.isnan(total), -np.inf, total)
