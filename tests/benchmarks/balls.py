"""Presses of a ball by hand into a real sensor: the imprint's radius and finite elements give the force that was pressed.

The level is sure to a quarter (circles are marked by hand, the diameter is a catalogue's); spread and correlation are surer.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from gelforge.networks.balls.ballpresses import BallPress, read_presses
from gelforge.networks.inference.sensorprofile import fit_gain
from tests.benchmarks.figures import Figure

FOLDER = "balls/unit_a"
Read = Callable[
    [np.ndarray], tuple[np.ndarray, bool]
]  # a picture to its forces (3, rows, cols) N, and whether it is flagged


def ball_figures(presses: list[BallPress], read: Read) -> list[Figure]:
    """Forces that are read over those of finite elements, and again with a factor that every other press told."""
    found = [read(press.image) for press in presses]
    normal, force = (
        np.array([-forces[2].sum(dtype=float) for forces, _ in found]),
        np.array([p.force for p in presses]),
    )
    note = f"{len(presses)} presses that lie wholly in the picture; the level is sure to a quarter"
    gain = fit_gain(force[::2], normal[::2])
    fitted = (
        f"{len(force[1::2])} presses; factor {gain.value:.2f} ({gain.low:.2f} to {gain.high:.2f}) from the others"
    )
    return [
        *_level("real balls, read over finite elements", normal, force, note),
        *_level("real balls, factor of every other press", gain.value * normal[1::2], force[1::2], fitted),
        Figure("good ball presses flagged", 100 * float(np.mean([flag for _, flag in found])), "<=", 10.0, "%"),
    ]


def _level(what: str, normal: np.ndarray, force: np.ndarray, note: str) -> list[Figure]:
    """Level, spread and correlation of normal forces (n,) N with those of finite elements."""
    median = float(np.median(normal / force))
    low, high = (np.quantile(normal / force, [0.1, 0.9]) / median).tolist()
    r = float(np.corrcoef(normal, force)[0, 1])
    return [
        Figure(f"{what}, median: at least", median, ">=", 0.8, "", note),
        Figure(f"{what}, median: at most", median, "<=", 1.25),
        Figure(f"{what}: over the median, 10 %", low, ">=", 0.8),
        Figure(f"{what}: over the median, 90 %", high, "<=", 1.25),
        Figure(f"{what}: correlation", r, ">=", 0.75, "", "circles are marked in whole px, and this series spans little force"),
    ]  # fmt: skip


def circle_figures(folder: Path, nocontact: np.ndarray, px_per_mm: float) -> list[Figure]:
    """Circles of contact that are found without marks, against those marked by hand."""
    marked, found = (
        {
            press.name: press.circle
            for press in read_presses(folder, nocontact, px_per_mm=px_per_mm, marks=marks).presses
        }
        for marks in (True, False)
    )
    pairs = [(found[name], marked[name]) for name in marked.keys() & found.keys()]
    ratio = np.array([one.radius / other.radius for one, other in pairs])
    beside = np.array([np.hypot(one.u - other.u, one.v - other.v) for one, other in pairs])
    note = "10 to 90 % {:.2f} to {:.2f}; centres {:.1f} px beside in the median".format(
        *np.quantile(ratio, [0.1, 0.9]), np.median(beside)
    )
    return [Figure("real balls: found circles against marked ones, radius, median off by", 100 * abs(float(np.median(ratio)) - 1), "<=", 5.0, "%",
                   f"{len(pairs)} presses; {note}")]  # fmt: skip
