"""How far a network's forces may be off: intervals that hold a given share of them on sensors that it never saw.

The half width of an interval grows with the force, as errors do; its size is set on pictures that training did not see
(conformal prediction with a local scale: Lei et al. 2018, J. Am. Stat. Assoc. 113, 1094-1111, section 5.2). Pictures of
one press err alike, so it is presses that count (pooled groups: Dunn, Wasserman and Ramdas 2023, J. Am. Stat. Assoc. 118,
2491-2502, section 3.1).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.networks.sensorprofile import AS_READ, Gain
from gelforge.records.axes import CHANNELS

HOLDS = 0.9  # share of the forces that intervals shall hold
LEAST_PICTURES = 20  # fewer tell no such share
LEAST_PRESSES = 9  # the largest error of k presses holds k of k + 1: of fewer it holds less than HOLDS
BINS = 6  # groups of equally many pictures, by force, that the growth of errors is read from


@dataclass(frozen=True)
class HalfWidth:
    """Half an interval's width, N: `base` plus `share` of the force."""

    base: float
    share: float

    def of(self, force: np.ndarray | float) -> np.ndarray:
        """Half widths at forces of any shape, N."""
        return self.base + self.share * np.abs(force)


def fit_half_width(force: np.ndarray, error: np.ndarray, press: np.ndarray | None = None) -> HalfWidth:
    """Half width from predicted forces (n,) N of a component and what they were off by, (n,) N.

    press: (n,) what tells the presses apart that are seen; None: each picture shows another one. The scale is a line, not
    below zero and not falling, through the mean errors of weak to strong forces. Its size is the least that, of k presses,
    holds HOLDS (k + 1) of them, a press counting by the share of its pictures that it holds; if none does, the largest.
    """
    press = np.arange(len(force)) if press is None else press
    force, error = np.abs(np.asarray(force, float)), np.abs(np.asarray(error, float))
    groups = np.array_split(np.argsort(force), min(BINS, len(force)))
    x, y = (np.array([values[group].mean() for group in groups]) for values in (force, error))
    rise = float(np.clip(np.polyfit(x, y, 1)[0], 0.0, None)) if np.ptp(x) > 0 else 0.0
    base = max(float((y - rise * x).mean()), 0.05 * float(y.mean()), 1e-9)
    in_scale = error / (base + rise * force)
    order = np.argsort(in_scale)
    _, which, pictures = np.unique(press, return_inverse=True, return_counts=True)
    held = np.cumsum(1.0 / pictures[which[order]])  # presses that an interval of each size holds
    enough = int(np.searchsorted(held, HOLDS * (len(pictures) + 1) - 1e-9))
    size = in_scale[order[min(enough, len(order) - 1)]]
    return HalfWidth(base * float(size), rise * float(size))


def tells_intervals(press: np.ndarray) -> bool:
    """Whether pictures of these presses (n,) are enough for an interval that holds HOLDS of others."""
    return len(press) >= LEAST_PICTURES and len(np.unique(press)) >= LEAST_PRESSES


def fit_intervals(predicted: np.ndarray, labels: np.ndarray, press: np.ndarray) -> dict[str, dict[str, list[float]]]:
    """Intervals of totals by channel, as a model file keeps them: `base` N and `share`.

    predicted, labels: (n, 3, rows, cols) N per cell of pictures that training did not see; press: (n,) what tells their
    presses apart. Empty where these are too few to tell (`tells_intervals`).
    """
    if not tells_intervals(press):
        return {}
    found = {}
    for k, name in enumerate(CHANNELS):
        totals, wanted = predicted[:, k].sum((1, 2)), labels[:, k].sum((1, 2))
        width = fit_half_width(totals, wanted - totals, press)
        found[name] = [width.base, width.share]
    return {"total": found}


def half_widths(about: dict[str, Any], totals: np.ndarray, gain: Gain = AS_READ) -> np.ndarray | None:
    """Half widths (3,) N at total forces (3,) N; None where unknown.

    gain: of the sensor's profile, whose factor the forces were multiplied by. What is not known of it widens the intervals.
    """
    known = about.get("intervals", {}).get("total")
    if not known:
        return None
    return np.array(
        [
            math.hypot(gain.value * HalfWidth(*known[name]).of(force / gain.value), gain.unsure * force)
            for name, force in zip(CHANNELS, totals.tolist(), strict=True)
        ]
    )
