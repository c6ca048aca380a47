"""How far a network's forces may be off: intervals that hold a given share of them on sensors that it never saw.

The half width of an interval grows with the force, as errors do; its size is set on pictures that training did not see
(conformal prediction with a local scale: Lei et al. 2018, J. Am. Stat. Assoc. 113, 1094-1111, section 5.2).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.records.axes import CHANNELS

HOLDS = 0.9  # share of the forces that intervals shall hold
LEAST_PICTURES = 20  # fewer tell no such share
BINS = 6  # groups of equally many pictures, by force, that the growth of errors is read from


@dataclass(frozen=True)
class HalfWidth:
    """Half an interval's width, N: `base` plus `share` of the force."""

    base: float
    share: float

    def of(self, force: np.ndarray | float) -> np.ndarray:
        """Half widths at forces of any shape, N."""
        return self.base + self.share * np.abs(force)


def fit_half_width(force: np.ndarray, error: np.ndarray) -> HalfWidth:
    """Half width from predicted forces (n,) N of a component and what they were off by, (n,) N.

    The scale is a line, not below zero and not falling, through the mean errors of weak to strong forces; its size is the
    quantile of what errors are in that scale, for n pictures the ceil((n + 1) HOLDS)-th smallest.
    """
    force, error = np.abs(np.asarray(force, float)), np.abs(np.asarray(error, float))
    groups = np.array_split(np.argsort(force), min(BINS, len(force)))
    x, y = (np.array([values[group].mean() for group in groups]) for values in (force, error))
    rise = float(np.clip(np.polyfit(x, y, 1)[0], 0.0, None)) if np.ptp(x) > 0 else 0.0
    base = max(float((y - rise * x).mean()), 0.05 * float(y.mean()), 1e-9)
    in_scale = np.sort(error / (base + rise * force))
    size = in_scale[min(math.ceil((len(force) + 1) * HOLDS), len(force)) - 1]
    return HalfWidth(base * float(size), rise * float(size))


def fit_intervals(predicted: np.ndarray, labels: np.ndarray) -> dict[str, dict[str, list[float]]]:
    """Intervals of totals and of cells by channel, as a model file keeps them: `base` N and `share`.

    predicted, labels: (n, 3, rows, cols) N per cell of pictures that training did not see. Empty for too few pictures.
    """
    if len(predicted) < LEAST_PICTURES:
        return {}
    found: dict[str, dict[str, list[float]]] = {"total": {}, "cell": {}}
    for k, name in enumerate(CHANNELS):
        for what, values in (("total", (predicted[:, k].sum((1, 2)), labels[:, k].sum((1, 2)))),
                             ("cell", (predicted[:, k].ravel(), labels[:, k].ravel()))):  # fmt: skip
            width = fit_half_width(values[0], values[1] - values[0])
            found[what][name] = [width.base, width.share]
    return found


def half_widths(about: dict[str, Any], what: str, forces: np.ndarray, gain: float = 1.0) -> np.ndarray | None:
    """Half widths (3, ...) N at forces (3, ...) N, `what` being totals ("total") or cells ("cell"); None where unknown.

    gain: the factor of a sensor's profile that the forces were multiplied by.
    """
    known = about.get("intervals", {}).get(what)
    if not known:
        return None
    return np.stack(
        [gain * HalfWidth(*known[name]).of(force / gain) for name, force in zip(CHANNELS, forces, strict=True)]
    )
