"""Two readers of one picture: the network of its brightness and that of its dots, their mean, and where they contradict."""

from dataclasses import astuple

import numpy as np

from gelforge.networks.intervals import HalfWidth, fit_half_width, magnitudes
from gelforge.records.axes import CHANNELS, MEANINGS
from gelforge.records.totals import LEAST_PRESS

WEIGHTS = np.linspace(0.0, 1.0, 21)  # of the dots' total in both readers' mean, that are tried
# Half widths of what the two readers usually differ by, beyond which one of them is wrong: on units of the rig that training
# never saw 96 % of the pictures that are read wrong are then flagged, and 2 % of the good ones (with 3: 95 and 1.5 %).
APART = 2.25
LEAST_APART = 0.3  # N by which they differ at least: on real sensors they do by that where neither is wrong
MOST_FACTOR = 2.0  # by which a map is scaled at most
# As long as two readers have not met: the dots have no say, and nothing contradicts them.
APART_NOTHING = {"weight": [0.0, 0.0, 0.0], "apart": {name: [np.inf, 0.0, 0.0] for name in CHANNELS}}


def fit_blend(
    by_picture: np.ndarray, by_dots: np.ndarray, true: np.ndarray, counts: np.ndarray | None = None
) -> dict:
    """How the totals (n, 3) N of both readers meet best, from presses whose true totals are known.

    counts: (n,) how much each picture counts for the weight, all alike if not given. weight: of the dots' total in their
    mean, by component, that leaves the least mean error. apart: half widths by component, the three numbers of HalfWidth, of what nine
    of ten of the readers' differences stay within.
    """
    errors = [np.average(np.abs((1 - w) * by_picture + w * by_dots - true), axis=0, weights=counts) for w in WEIGHTS]
    weight = WEIGHTS[np.argmin(errors, axis=0)].tolist()
    apart, (components, whole) = {}, larger(by_picture, by_dots)
    for k, name in enumerate(CHANNELS):
        width = fit_half_width(components[:, k], whole, by_picture[:, k] - by_dots[:, k])
        apart[name] = list(astuple(width))
    return {"weight": weight, "apart": apart}


def larger(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The larger of two readers' totals (..., 3) N: components without their signs (..., 3) N, and magnitudes (...) N."""
    return np.maximum(np.abs(one), np.abs(other)), np.maximum(magnitudes(one), magnitudes(other))


def has_shape(forces: np.ndarray) -> bool:
    """Whether forces (3, rows, cols) N press so much that another total can be laid on them."""
    return bool(-forces[2].sum(dtype=float) >= LEAST_PRESS)


def blend(forces: np.ndarray, by_dots: np.ndarray, weight: list[float]) -> np.ndarray:
    """Forces (3, rows, cols) N of the pictures' network, whose totals are moved towards those of the dots (3,) N.

    The normal map is scaled; sideways force is added where the gel is pressed, as the pressure is spread there. A map of
    less than LEAST_PRESS has no shape that a total could be laid on, and stays as it is.
    """
    if not has_shape(forces):
        return forces
    total = forces.sum((1, 2), dtype=float)
    wanted = total + np.array(weight) * (by_dots - total)
    pressed = np.maximum(-forces[2], 0.0)
    found = forces.copy()
    found[2] *= np.float32(np.clip(wanted[2] / total[2], 1 / MOST_FACTOR, MOST_FACTOR))
    found[:2] += ((wanted - total)[:2, None, None] * (pressed / pressed.sum())).astype(np.float32)
    return found


def dots_fault(apart: dict, total: np.ndarray, by_dots: np.ndarray, gain: float = 1.0) -> str:
    """What tells that a picture and its dots contradict each other, totals (3,) N; empty where they agree.

    gain: of the sensor, by which what is told is multiplied, as all that its user reads is.
    """
    components, whole = larger(total, by_dots)
    for k, name in enumerate(CHANNELS):
        usual = HalfWidth(*apart[name]).of(components[k], whole)
        if abs(total[k] - by_dots[k]) > max(APART * usual, LEAST_APART):
            told, read = gain * by_dots[k], gain * total[k]
            return f"its dots tell {MEANINGS[k]} of {told:.1f} N, its brightness of {read:.1f} N"
    return ""
