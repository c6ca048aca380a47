"""Log-probability of a calibration model given force readings, for all walkers at once."""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from gelforge.calibration.emulator import Emulator
from gelforge.calibration.parameters import ORIGIN, TARE, BenchModel

# Relative errors of emulated forces from press to press, measured by solves on fine hexahedra at other friction and
# depth (make benchmark-calibration): of all components, of sideways forces in addition, and of the normal force for
# presses that hardly move sideways. Without them 0.1 % of a large force would decide friction.
ERROR = 0.01
SIDEWAYS_ERROR, SIDEWAYS_ERROR_OF_NORMAL = 0.03, 0.002
# N mm: six-axis sensors resolve moments to 0.1 to 1 N mm and drift by as much. It is no parameter: a chain would take
# longer, and a few presses do not show it.
MOMENT_NOISE = 1.0
# Error of the emulated centre of a force, mm, and as a fraction of its motion by tilt: where one side of a wide block leaves
# the gel, at 3 degrees, it moves by a tenth less than in proportion.
CENTRE_ERROR, CENTRE_SHARE = 0.05, 0.07
ERRORS = np.array([ERROR, SIDEWAYS_ERROR, SIDEWAYS_ERROR_OF_NORMAL])


@dataclass(frozen=True)
class Posterior:
    """Readings, emulator and model.

    depth: (n,) commanded, mm. observed: (n, 3) N on the gel, nan where a component is not used.
    tail: degrees of freedom of Student's t, the robust likelihood (Lange, Little, Taylor 1989). centre: (n, 2) mm, where
    the moments put the force of a press, nan where that is not used; None: of no press.
    """

    emulator: Emulator
    model: BenchModel
    depth: np.ndarray
    observed: np.ndarray
    tail: float
    centre: np.ndarray | None = None

    def predict(self, coordinates) -> tuple[np.ndarray, np.ndarray]:
        """Noise-free readings and scale of each one's likelihood, each (w, n, 3) N.

        A reading is the force on the gel plus the sensor's constant force. The scale adds in quadrature the sensor's
        noise, the scatter of touch from press to press times the slope of force over depth, and the emulator's
        errors.
        """
        values = self.model.values(coordinates)
        forces, slopes, _ = self.emulator.forces(self.depth, values)
        return forces + tare_of(values)[:, None], self.scale(forces, slopes, values)

    @staticmethod
    def scale(forces, slopes, values: dict) -> np.ndarray:
        """Scale of the likelihood (w, n, 3) at forces (w, n, 3) N and slopes (w, n, 3) N per mm."""
        noise, scatter = (values[name][:, None, None] for name in ("noise", "scatter"))
        variance = noise**2 + (scatter * slopes) ** 2 + (ERROR * forces) ** 2
        variance[..., :2] += (SIDEWAYS_ERROR * forces[..., :2]) ** 2
        variance[..., :2] += ((SIDEWAYS_ERROR_OF_NORMAL * forces[..., 2]) ** 2)[..., None]
        return np.sqrt(variance)

    def by_press(self, coordinates) -> np.ndarray:
        """Log-likelihood of every press, (w, n): a multivariate t, because its components share errors."""
        from gelforge.calibration.kernel import log_likelihood

        values = self.model.values(coordinates)
        forces, slopes, depth = self.emulator.forces(self.depth, values)
        residual = self.observed - tare_of(values)[:, None] - forces
        found = log_likelihood(
            residual, np.isfinite(self.observed), forces, slopes, values["noise"], values["scatter"], ERRORS, self.tail,
            constants(self.tail),
        )  # fmt: skip
        return found if self.centre is None else found + self._by_centre(values, depth)

    def _by_centre(self, values: dict, depth: np.ndarray) -> np.ndarray:
        """Log-likelihood (w, n) of the centres of forces; 0 for a press without one.

        A centre is off by MOMENT_NOISE over the force that was read, by CENTRE_ERROR, and by CENTRE_SHARE of what
        tilt moves it. All have the
        sensor's origin in common.
        """
        assert self.centre is not None
        origin = np.stack([values[name] for name in ORIGIN], axis=1)
        centres, tilts = self.emulator.centres(depth, values), self.emulator.tilts
        assert tilts is not None
        residual = self.centre - origin[:, None] - centres
        moved = CENTRE_SHARE * np.hypot(*np.moveaxis(centres - tilts.centre, 2, 0))
        force = np.abs(self.observed[:, 2])
        scale = np.hypot(np.hypot(MOMENT_NOISE / force, CENTRE_ERROR), moved)
        square = (residual**2).sum(axis=2) / scale**2
        found = constants(self.tail)[2] - 2.0 * np.log(scale) - 0.5 * (self.tail + 2) * np.log1p(square / self.tail)
        return np.where(np.isfinite(found), found, 0.0)

    def __call__(self, coordinates) -> np.ndarray:
        """Log-probability (w,) at coordinates (w, free); -inf outside the priors, and where a force is NaN."""
        coordinates = np.atleast_2d(coordinates)
        total = self.model.log_prior(coordinates)
        inside = np.isfinite(total)
        if inside.any():
            total[inside] += self.by_press(coordinates[inside]).sum(axis=1)
        return np.where(np.isnan(total), -np.inf, total)


def tare_of(values: dict) -> np.ndarray:
    """The sensor's constant force, (w, 3) N."""
    return np.stack([values[name] for name in TARE], axis=1)


def constants(tail: float) -> np.ndarray:
    """Constant of the log-density of a multivariate t of 0 to 3 components, (4,) (Kotz, Nadarajah 2004, equation 1.1)."""
    k = np.arange(4)
    return gammaln((tail + k) / 2) - gammaln(tail / 2) - 0.5 * k * np.log(tail * np.pi)
