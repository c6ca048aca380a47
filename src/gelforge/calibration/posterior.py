"""Log-probability of a calibration model given force readings, for all walkers at once."""

from dataclasses import asdict, dataclass

import numpy as np
from scipy.special import gammaln

from gelforge.calibration.emulator import Emulator
from gelforge.calibration.parameters import Model

FORM = 4  # raise when the likelihood changes: a chain on disk of an older form is then not gone on with


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
        """Noise-free forces and scale of the likelihood, each (w, n, 3) N.

        The scale holds the sensor's noise and, in quadrature, what the scatter of touch from press to
        press makes of the slope of force over depth.
        """
        values = self.model.values(coordinates)
        forces, slopes, _ = self.emulator.forces(self.depth, values)
        return forces, self.scale(slopes, values)

    @staticmethod
    def scale(slopes, values: dict) -> np.ndarray:
        """Scale of the likelihood at slopes (w, n, 3) N per mm."""
        noise, scatter = (values[name][:, None, None] for name in ("noise", "scatter"))
        return np.sqrt(noise**2 + (scatter * slopes) ** 2)

    def pointwise(self, coordinates) -> np.ndarray:
        """Log-likelihood of every reading that serves, (w, r)."""
        forces, scale = self.predict(coordinates)
        used = np.isfinite(self.observed)
        scale = scale[:, used]
        z = (self.observed[used] - forces[:, used]) / scale
        v = self.tail
        constant = gammaln((v + 1) / 2) - gammaln(v / 2) - 0.5 * np.log(v * np.pi)
        return constant - np.log(scale) - (v + 1) / 2 * np.log1p(z * z / v)

    @property
    def identity(self) -> list:
        """Everything the log-probability depends on, as plain values and arrays."""
        free = {name: [type(prior).__name__, asdict(prior)] for name, prior in self.model.free.items()}
        plain = {"form": FORM, "free": free, "fixed": self.model.fixed, "law": self.model.law, "tail": self.tail}
        e = self.emulator
        return [plain, self.depth, self.observed, e.table, e.top, e.nu, e.group, e.travel]

    def __call__(self, coordinates) -> np.ndarray:
        """Log-probability (w,) at coordinates (w, free); -inf outside the priors."""
        coordinates = np.atleast_2d(coordinates)
        total = self.model.log_prior(coordinates)
        inside = np.isfinite(total)
        if inside.any():
            total[inside] += self.summed(self.pointwise(coordinates[inside]))
        return np.where(np.isnan(total), -np.inf, total)

    @staticmethod
    def summed(terms: np.ndarray) -> np.ndarray:
        """What the log-likelihoods (w, r) of readings add to the log-probability, (w,)."""
        return terms.sum(axis=1)


@dataclass(frozen=True)
class LeaveOneOut(Posterior):
    """Sum over readings of the posterior without that reading: one chain that serves every leave-one-out.

    Silva and Zanella (2024), Robust leave-one-out cross-validation for high-dimensional Bayesian
    models, JASA 119:2369: importance weights from it to each posterior without a reading are bounded.
    """

    @property
    def identity(self) -> list:
        return ["leave one out", *super().identity]

    @staticmethod
    def summed(terms: np.ndarray) -> np.ndarray:
        return terms.sum(axis=1) + np.logaddexp.reduce(-terms, axis=1)
