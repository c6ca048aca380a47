"""How far a network's forces may be off: intervals that hold a given share of them on sensors that it never saw.

The half width of an interval grows as errors do: with the component itself, and with the force as a whole, for of two
presses that slide alike the sideways force of the one that presses harder is told worse. Its size is set on pictures that
training did not see (conformal prediction with a local scale: Lei et al. 2018, J. Am. Stat. Assoc. 113, 1094-1111, section
5.2). Pictures of one press err alike, so it is presses that count (pooled groups: Dunn, Wasserman and Ramdas 2023, J. Am.
Stat. Assoc. 118, 2491-2502, section 3.1).
"""

import math
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from gelforge.networks.sensorprofile import AS_READ, Gain
from gelforge.records.axes import CHANNELS

HOLDS = 0.9  # share of the forces that intervals shall hold
LEAST_PICTURES = 20  # fewer tell no such share
LEAST_PRESSES = 9  # the largest error of k presses holds k of k + 1: of fewer it holds less than HOLDS
ROUNDS = 5  # of least squares, each weighting an error by what the one before expects of it


@dataclass(frozen=True)
class HalfWidth:
    """Half the width of a component's interval, N: `base`, `share` of the component, and `of_whole` of the force's magnitude."""

    base: float
    share: float
    of_whole: float

    def of(self, component: np.ndarray | float, magnitude: np.ndarray | float) -> np.ndarray:
        """Half widths (...) N of components (...) N of forces of magnitudes (...) N."""
        return self.base + self.share * np.abs(component) + self.of_whole * np.asarray(magnitude)


def magnitudes(totals: np.ndarray) -> np.ndarray:
    """Magnitudes (...) N of total forces (..., 3) N."""
    return np.linalg.norm(totals, axis=-1)


def fit_half_width(
    component: np.ndarray, magnitude: np.ndarray, error: np.ndarray, press: np.ndarray | None = None
) -> HalfWidth:
    """Half width from a component (n,) N of predicted forces, their magnitudes (n,) N and what it was off by, (n,) N.

    press: (n,) what tells the presses apart that are seen; None: each picture shows another one. The scale is linear and
    falls with neither. Its size is the least that, of k presses, holds HOLDS (k + 1) of them, a press counting by the share
    of its pictures that it holds; if none does, the largest.
    """
    press = np.arange(len(error)) if press is None else press
    error = np.abs(np.asarray(error, float))
    scale = usual_error(np.abs(component), np.asarray(magnitude, float), error)
    in_scale = error / scale.of(component, magnitude)
    order = np.argsort(in_scale)
    _, which, pictures = np.unique(press, return_inverse=True, return_counts=True)
    held = np.cumsum(1.0 / pictures[which[order]])  # presses that an interval of each size holds
    enough = int(np.searchsorted(held, HOLDS * (len(pictures) + 1) - 1e-9))
    size = float(in_scale[order[min(enough, len(order) - 1)]])
    return HalfWidth(scale.base * size, scale.share * size, scale.of_whole * size)


def usual_error(component: np.ndarray, magnitude: np.ndarray, error: np.ndarray) -> HalfWidth:
    """How large errors (n,) N are in the mean, growing with component and magnitude (n,) N from 0 on, by least squares.

    Where errors are large they also scatter more: each counts by the inverse of what is expected there.
    """
    from scipy.optimize import nnls  # who only reads pictures needs no scipy

    least = max(0.05 * float(error.mean()), 1e-9)  # of the base: no force is told without any error
    grows = np.column_stack([np.ones(len(error)), component, magnitude])
    expected = np.full(len(error), max(float(error.mean()), least))
    for _ in range(ROUNDS):
        found, _ = nnls(grows / expected[:, None], error / expected)
        found[0] = max(found[0], least)
        expected = grows @ found
    return HalfWidth(*found.tolist())


def tells_intervals(press: np.ndarray) -> bool:
    """Whether pictures of these presses (n,) are enough for an interval that holds HOLDS of others."""
    return len(press) >= LEAST_PICTURES and len(np.unique(press)) >= LEAST_PRESSES


def fit_intervals(predicted: np.ndarray, labels: np.ndarray, press: np.ndarray) -> dict[str, dict[str, list[float]]]:
    """Intervals of totals by channel, as a model file keeps them: the three numbers of HalfWidth.

    predicted, labels: (n, 3, rows, cols) N per cell of pictures that training did not see; press: (n,) what tells their
    presses apart. Empty where these are too few to tell (`tells_intervals`).
    """
    if not tells_intervals(press):
        return {}
    totals, wanted = (cells.sum((2, 3)) for cells in (predicted, labels))
    found = {}
    for k, name in enumerate(CHANNELS):
        width = fit_half_width(totals[:, k], magnitudes(totals), (wanted - totals)[:, k], press)
        found[name] = list(astuple(width))
    return {"total": found}


def half_widths(about: dict[str, Any], totals: np.ndarray, gain: Gain = AS_READ) -> np.ndarray | None:
    """Half widths (3,) N at total forces (3,) N; None where unknown.

    gain: of the sensor's profile, whose factor the forces were multiplied by. What is not known of it widens the intervals.
    """
    known = about.get("intervals", {}).get("total")
    if not known:
        return None
    whole = magnitudes(totals) / gain.value
    return np.array(
        [
            math.hypot(gain.value * HalfWidth(*known[name]).of(force / gain.value, whole), gain.unsure * force)
            for name, force in zip(CHANNELS, totals.tolist(), strict=True)
        ]
    )
