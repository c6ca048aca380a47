"""90 % prediction intervals of total force, by split conformal prediction.

The half width of an interval grows as errors do: with the component itself, and with the magnitude of the force,
because of two presses that slide alike, the harder one has the larger error of sideways force. Its size is calibrated
on presses that were used neither for training nor for any selection (conformal prediction with a local scale: Lei et
al. 2018, J. Am. Stat. Assoc. 113, 1094-1111, section 5.2). Errors in images of one press are correlated, so presses
are counted, not images (pooled groups: Dunn, Wasserman and Ramdas 2023, J. Am. Stat. Assoc. 118, 2491-2502, section
3.1).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.reading.profile import AS_READ, Gain
from gelforge.records.axes import CHANNELS

HOLDS = 0.9  # coverage of the intervals
LEAST_PICTURES = 20  # images without which no such coverage can be set
LEAST_PRESSES = 9  # the largest error of k presses covers k / (k + 1) of new ones, with fewer presses less than HOLDS
# 90 % of the errors of a force's centre along an axis, mm: 0.28 in the demo's images, whose moments are known, and the 0.4
# by which the gels of real units lie off the middle of the image.
PLACE_MM = 0.5
ROUNDS = 5  # of least squares, each weighted by the errors that the previous one expects


@dataclass(frozen=True)
class HalfWidth:
    """Half the width of a component's interval, N: `base`, `fraction` of the component, and `of_whole` of the force's magnitude."""

    base: float
    fraction: float
    of_whole: float

    def of(self, component: np.ndarray | float, magnitude: np.ndarray | float) -> np.ndarray:
        """Half widths (...) N of components (...) N of forces of magnitudes (...) N."""
        return self.base + self.fraction * np.abs(component) + self.of_whole * np.asarray(magnitude)


def magnitudes(totals: np.ndarray) -> np.ndarray:
    """Magnitudes (...) N of total forces (..., 3) N."""
    return np.linalg.norm(totals, axis=-1)


def conformal_size(in_scale: np.ndarray, press: np.ndarray) -> float:
    """The smallest factor on a scale that covers HOLDS of other presses; the largest error if none is certain to.

    in_scale: (n,) errors divided by their scale. press: (n,) their presses. Of k presses the factor covers HOLDS (k +
    1); a press counts by the fraction of its images that are covered.
    """
    order = np.argsort(in_scale)
    _, which, pictures = np.unique(press, return_inverse=True, return_counts=True)
    held = np.cumsum(1.0 / pictures[which[order]])  # number of presses that each factor covers
    enough = int(np.searchsorted(held, HOLDS * (len(pictures) + 1) - 1e-9))
    return float(in_scale[order[min(enough, len(order) - 1)]])


def usual_error(component: np.ndarray, magnitude: np.ndarray, error: np.ndarray) -> HalfWidth:
    """Mean error as a function of component and magnitude, all (n,) N from 0 on, by non-negative least squares.

    Large errors also scatter more, so each is weighted by the inverse of its expected size.
    """
    from scipy.optimize import nnls  # prediction needs no scipy

    least = max(0.05 * float(error.mean()), 1e-9)  # smallest base: no force is predicted without any error
    grows = np.column_stack([np.ones(len(error)), component, magnitude])
    expected = np.full(len(error), max(float(error.mean()), least))
    for _ in range(ROUNDS):
        found, _ = nnls(grows / expected[:, None], error / expected)
        found[0] = max(found[0], least)
        expected = grows @ found
    return HalfWidth(*found.tolist())


@dataclass(frozen=True)
class Errors:
    """Predicted totals (n, 3) N, their errors (n, 3) N, and their presses (n,)."""

    total: np.ndarray
    error: np.ndarray
    press: np.ndarray

    @property
    def enough(self) -> bool:
        """Whether these are enough for an interval with coverage HOLDS."""
        return len(self.press) >= LEAST_PICTURES and len(np.unique(self.press)) >= LEAST_PRESSES


def fit_intervals(scale_on: Errors, size_on: Errors) -> dict[str, dict[str, list[float]]]:
    """Intervals of totals by channel, as a model file keeps them: the three numbers of HalfWidth.

    Split conformal prediction: the growth of the widths is fitted to presses that may have been used to select the
    epoch (scale_on), their size to presses that were used for no selection (size_on). Empty where either are too few.
    """
    if not (scale_on.enough and size_on.enough):
        return {}
    found = {}
    for k, name in enumerate(CHANNELS):
        grown = np.abs(scale_on.total[:, k]), magnitudes(scale_on.total), np.abs(scale_on.error[:, k])
        scale = usual_error(*grown)
        in_scale = np.abs(size_on.error[:, k]) / scale.of(size_on.total[:, k], magnitudes(size_on.total))
        size = conformal_size(in_scale, size_on.press)
        found[name] = [scale.base * size, scale.fraction * size, scale.of_whole * size]
    return {"total": found}


def real_width(read: np.ndarray, force: np.ndarray, half: np.ndarray) -> float:
    """The least fraction of the predicted force that widens intervals to cover HOLDS of the forces of real sensors.

    It is added to the half widths in quadrature. read, force, half: (n,) N, predicted and true normal force, and the
    half width of the network itself.
    """
    lacking = np.sqrt(np.maximum((read - force) ** 2 - half**2, 0.0)) / np.maximum(np.abs(read), 1e-9)
    rank = math.ceil(HOLDS * (len(read) + 1)) - 1
    return float(np.sort(lacking)[min(rank, len(read) - 1)])


def real_sideways(aside: np.ndarray, magnitude: np.ndarray, half: np.ndarray) -> float:
    """The least fraction of a force's magnitude that widens intervals of sideways force to cover HOLDS of real presses.

    It is added to the half widths in quadrature. aside, half: (n, 2) N, predicted sideways forces of presses straight down, and
    the half widths of the network itself; magnitude: (n,) N. Each press counts once, by the worse of its two components.
    """
    lacking = np.sqrt(np.maximum(aside**2 - half**2, 0.0)).max(axis=1) / np.maximum(magnitude, 1e-9)
    rank = math.ceil(HOLDS * (len(aside) + 1)) - 1
    return float(np.sort(lacking)[min(rank, len(aside) - 1)])


def half_widths(metadata: dict[str, Any], totals: np.ndarray, gain: Gain = AS_READ) -> np.ndarray | None:
    """Half widths (3,) N at total forces (3,) N; None where unknown.

    gain: of the sensor's profile, whose factor is already applied to the totals. Its uncertainty widens the
    intervals. So do the errors on real sensors of a network that was trained on rendered ones (`intervals.real`):
    without a profile these include the sensor's unknown level of force, with one only the differences between images
    of one sensor. On real sensors a press straight down gives sideways forces, so these widen by a fraction of the
    magnitude, whatever the component is.
    """
    known = metadata.get("intervals", {}).get("total")
    if not known:
        return None
    real = metadata["intervals"].get("real", {})
    beside = math.hypot(gain.unsure, real.get("profiled", 0.0)) if gain.readings else real.get("unprofiled", 0.0)
    magnitude = float(magnitudes(totals))
    aside = (real.get("sideways", 0.0) * magnitude,) * 2 + (0.0,)
    return np.array([
        math.hypot(gain.value * HalfWidth(*known[name]).of(force / gain.value, magnitude / gain.value), beside * force, more)
        for name, force, more in zip(CHANNELS, totals.tolist(), aside, strict=True)
    ])  # fmt: skip


def moment_half_widths(total: np.ndarray, moment: np.ndarray, half_width: np.ndarray | None) -> np.ndarray | None:
    """Half widths (3,) N mm of moments (3,) N mm of total forces (3,) N with half widths (3,) N; None where unknown.

    A moment is force times the place of its centre: it has the force's relative error, and force times an error of
    PLACE_MM.
    """
    if half_width is None:
        return None
    (fx, fy, fz), (wx, wy, wz) = np.abs(total), half_width
    x, y = np.abs(moment[[1, 0]]) / max(fz, 1e-9)
    return np.array([math.hypot(y * wz, PLACE_MM * fz), math.hypot(x * wz, PLACE_MM * fz),
                     math.hypot(x * wy, y * wx, PLACE_MM * math.hypot(fx, fy))])  # fmt: skip
