"""90 % prediction intervals of total force, by split conformal prediction.

The half width of an interval grows as errors do: with the component itself, and with the force as a whole, for of two
presses that slide alike the sideways force of the one that presses harder is predicted worse. Its size is set on presses that
neither trained nor chose anything (conformal prediction with a local scale: Lei et al. 2018, J. Am. Stat. Assoc. 113, 1094-1111, section
5.2). Pictures of one press err alike, so it is presses that count (pooled groups: Dunn, Wasserman and Ramdas 2023, J. Am.
Stat. Assoc. 118, 2491-2502, section 3.1).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.reading.profile import AS_READ, Gain
from gelforge.records.axes import CHANNELS

HOLDS = 0.9  # fraction of the forces that intervals shall hold
LEAST_PICTURES = 20  # fewer give no such fraction
LEAST_PRESSES = 9  # the largest error of k presses holds k of k + 1: of fewer it holds less than HOLDS
ROUNDS = 5  # of least squares, each weighting an error by what the one before expects of it


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
    """The least size, in units of a scale, that holds HOLDS of other presses; the largest if none is sure to.

    in_scale: (n,) errors over their scale. press: (n,) their presses: of k presses it holds HOLDS (k + 1), a
    press counting by the fraction of its pictures that it holds.
    """
    order = np.argsort(in_scale)
    _, which, pictures = np.unique(press, return_inverse=True, return_counts=True)
    held = np.cumsum(1.0 / pictures[which[order]])  # presses that an interval of each size holds
    enough = int(np.searchsorted(held, HOLDS * (len(pictures) + 1) - 1e-9))
    return float(in_scale[order[min(enough, len(order) - 1)]])


def usual_error(component: np.ndarray, magnitude: np.ndarray, error: np.ndarray) -> HalfWidth:
    """How large errors (n,) N are in the mean, growing with component and magnitude (n,) N from 0 on, by least squares.

    Where errors are large they also scatter more: each counts by the inverse of what is expected there.
    """
    from scipy.optimize import nnls  # who only reads pictures needs no scipy

    least = max(0.05 * float(error.mean()), 1e-9)  # of the base: no force is predicted without any error
    grows = np.column_stack([np.ones(len(error)), component, magnitude])
    expected = np.full(len(error), max(float(error.mean()), least))
    for _ in range(ROUNDS):
        found, _ = nnls(grows / expected[:, None], error / expected)
        found[0] = max(found[0], least)
        expected = grows @ found
    return HalfWidth(*found.tolist())


@dataclass(frozen=True)
class Errors:
    """Predicted totals (n, 3) N, what they were wrong by (n, 3) N, and their presses, (n,)."""

    total: np.ndarray
    error: np.ndarray
    press: np.ndarray

    @property
    def enough(self) -> bool:
        """Whether these are enough for an interval that holds HOLDS of others."""
        return len(self.press) >= LEAST_PICTURES and len(np.unique(self.press)) >= LEAST_PRESSES


def fit_intervals(scale_on: Errors, size_on: Errors) -> dict[str, dict[str, list[float]]]:
    """Intervals of totals by channel, as a model file keeps them: the three numbers of HalfWidth.

    Split conformal prediction: how widths grow is fitted to presses that may have chosen the epoch (scale_on), how wide they
    are is set on presses that chose nothing (size_on). Empty where either are too few.
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
    """The least fraction of what is read by which intervals (n,) N must grow to hold HOLDS of the forces (n,) N of real sensors.

    read, force, half: normal force as it is read, as it is known, and half the width that the network itself knows.
    """
    lacking = np.sqrt(np.maximum((read - force) ** 2 - half**2, 0.0)) / np.maximum(np.abs(read), 1e-9)
    rank = math.ceil(HOLDS * (len(read) + 1)) - 1
    return float(np.sort(lacking)[min(rank, len(read) - 1)])


def half_widths(metadata: dict[str, Any], totals: np.ndarray, gain: Gain = AS_READ) -> np.ndarray | None:
    """Half widths (3,) N at total forces (3,) N; None where unknown.

    gain: of the sensor's profile, whose factor the forces were multiplied by. What is not known of it widens the intervals, and so
    does what real sensors showed of a network that learnt from drawn ones (`intervals.real`): without a profile their level is
    unknown, too, with one what images of one sensor differ by. Of a press straight down real sensors read a fraction of the whole force
    sideways, whatever the component is.
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
