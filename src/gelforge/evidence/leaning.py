"""By how much a mounting leans against the gel, seen in the images of its flat presses.

An image shows slopes: each colour changes in proportion to the slope of the gel's surface, by a factor that the light
decides and that changes across the image. A flat body that leans slopes where it touches, and presses one side of its
rim deeper. So the colours of all presses of a sensor are fitted at a grid of tilts, balls and flat bodies together, and
the tilt is the one at which the least is left. Balls roll aside by it, and show what the light does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gelforge.evidence.imprints import COLS, ROWS, Window
from gelforge.geometry.solids import Indenter
from gelforge.labelling.sensor import Sensor
from gelforge.records.press import Press, PressRecord

LARGEST_DEG = 4.0  # tilts about each axis are searched for up to here
STEPS_DEG = (
    2.0,
    1.0,
    0.5,
)  # between the tilts of the first grid, over all of them, and of finer ones, three by three
FEWEST = 4  # flat presses from which a tilt is said
MOST_FLAT, MOST_ROUND = 8, 4  # presses that are looked at
LEAST_DEG, SURE = 1.0, 2.0  # least difference from the assumed tilt that is said, and over its error
# Error about each axis, degrees, however well the presses agree: of the tilts found in sessions of the rig, of which
# those with few and narrow flat bodies are off by up to 1.5.
FLOOR_DEG = 0.8
# Slope that halves the weight of a place: the sides of rims, which the expected surface has too sharp, would make tilts too
# small, by a third without it; places that the raised side leaves free show it best.
STEEP = 0.15
RIDGE = 1e-6  # of the normal equations: keeps the light's change across an image finite where few presses show it


@dataclass(frozen=True)
class Shaded:
    """A press as it is fitted: its image's signed change (30, 40, 3), window, indenter and path."""

    change: np.ndarray
    window: Window
    body: Indenter
    press: Press

    @cached_property
    def steepness(self) -> np.ndarray:
        """Expected slope (30, 40) at the path as it is assumed, which weighs the places at all tilts alike."""
        along, down, _ = self.window.slopes(self.body, self.press)
        return np.hypot(along, down)


@dataclass(frozen=True)
class Leaning:
    """Tilt about gel x and y, (2,) degrees, and its standard errors (2,)."""

    tilt: np.ndarray
    error: np.ndarray

    def differs(self, assumed: Sequence[float]) -> bool:
        """Whether it is not the assumed tilt, (2,) degrees."""
        off = self.tilt - np.asarray(assumed)
        size = float(np.hypot(*off))
        return size >= LEAST_DEG and size >= SURE * float(np.hypot(*(self.error * off))) / size


def leaning(flat: Sequence[Shaded], others: Sequence[Shaded]) -> Leaning:
    """Tilt of `flat` presses beside round `others`; its error from leaving out one flat press by one."""

    def at(tilts: np.ndarray) -> list[list[Equations]]:
        return [[equations(one, leant(one.press, x, y)) for one in (*flat, *others)] for x, y in tilts]

    axis = np.arange(-LARGEST_DEG, LARGEST_DEG + STEPS_DEG[0] / 2, STEPS_DEG[0])
    tilts = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    found = tilts[np.argmin([sum(every, Equations.empty()).left for every in at(tilts)])]
    for step in STEPS_DEG[1:]:
        tilts = found + step * NEIGHBOURS
        grid = at(tilts)
        found = np.clip(least_left(tilts, grid), -LARGEST_DEG, LARGEST_DEG)
    without = [[every[:k] + every[k + 1 :] for every in grid] for k in range(len(flat))]
    parts = np.array([least_left(tilts, every) for every in without])
    spread = (len(flat) - 1) / len(flat) * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0)
    return Leaning(found, np.sqrt(spread + FLOOR_DEG**2))


def leant(press: Press, x: float, y: float) -> Press:
    """The press at another tilt, degrees."""
    return replace(press, tilt_x_deg=float(x), tilt_y_deg=float(y))


def tilt_notes(found: Sequence[Mapping], presses: Sequence[PressRecord], sensors: Mapping[str, Sensor]) -> list[str]:
    """A note on each mounting whose images show another tilt than the paths of its presses. found: tilt_deg and error_deg by sensor and mounting."""
    notes = []
    for one in found:
        mine = [
            press.tilt for press in presses if (press.sensor_id, press.mounting) == (one["sensor"], one["mounting"])
        ]
        seen = Leaning(np.array(one["tilt_deg"]), np.array(one["error_deg"]))
        if mine and seen.differs(assumed := np.median(mine, axis=0).tolist()):
            where = f"sensor {one['sensor']}" + (f", mounting {one['mounting']}" if one["mounting"] else "")
            notes.append(f"{where}: {sentence(seen, assumed, sensors[one['sensor']])}")
    return notes


def sentence(found: Leaning, assumed: Sequence[float], sensor: Sensor) -> str:
    """What the images say of a mounting's tilt, degrees, beside the one that labels assume."""
    x, y = found.tilt - np.asarray(assumed)
    # turned about x, the side at -y sinks; about y, that at +x
    ends = np.asarray(sensor.project(np.array([[0.0, 0.0], [y, -x]])))
    across, down = ends[1] - ends[0]
    side = ("right" if across > 0 else "left") if abs(across) > abs(down) else ("lower" if down > 0 else "upper")
    about = [
        f"about {axis} {tilt:.1f} +- {error:.1f}"
        for axis, tilt, error in zip("xy", found.tilt, found.error, strict=True)
    ]
    return (
        f"flat bodies touch with their {side} side first: tilt {' and '.join(about)} degrees, labels assume {assumed[0]:.1f} and"
        f" {assumed[1]:.1f}: set tilt_deg or mounting_tilt_deg in [params.poses], or log mx_nm and my_nm for make calibrate"
    )


@dataclass(frozen=True)
class Equations:
    """Normal equations of the fit: X'X (k, k), X'Y (k, 3) and the sum of squares of Y."""

    xx: np.ndarray
    xy: np.ndarray
    yy: float

    @classmethod
    def empty(cls) -> "Equations":
        return cls(np.zeros((TERMS, TERMS)), np.zeros((TERMS, 3)), 0.0)

    def __add__(self, other: "Equations") -> "Equations":
        return Equations(self.xx + other.xx, self.xy + other.xy, self.yy + other.yy)

    @property
    def left(self) -> float:
        """Sum of squares that the best fit leaves."""
        ridge = RIDGE * np.trace(self.xx) * np.eye(TERMS)
        return self.yy - float((np.linalg.solve(self.xx + ridge, self.xy) * self.xy).sum())


TERMS = 8


def equations(one: Shaded, press: Press) -> Equations:
    """Equations of one press; all presses weigh alike.

    Terms: slopes along columns and rows, both also times the place in the image; the contact, which may be brighter or
    darker as a whole, and the size of the slope, which only darkens.
    """
    along, down, contact = one.window.slopes(one.body, press)
    v, u = np.meshgrid(np.linspace(-1.0, 1.0, ROWS), np.linspace(-1.0, 1.0, COLS), indexing="ij")
    terms = [along, down, along * u, along * v, down * u, down * v, contact, np.hypot(along, down)]
    design = np.stack(terms).reshape(TERMS, -1).T.astype(float)
    change = one.change.reshape(-1, 3) - np.median(one.change.reshape(-1, 3), axis=0)
    weight = 1.0 / (STEEP + one.steepness.reshape(-1, 1))
    weight /= max(float((weight * change**2).sum()), 1e-12)
    return Equations(design.T @ (weight * design), design.T @ (weight * change), 1.0)


NEIGHBOURS = np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])


def least_left(tilts: np.ndarray, grid: Sequence[list[Equations]]) -> np.ndarray:
    """Where a paraboloid through what is left at tilts (9, 2) is smallest, (2,) degrees, within their square.

    grid: for each tilt, the equations of the presses. A paraboloid without a minimum gives the best of the tilts.
    """
    left = np.array([sum(every, Equations.empty()).left for every in grid])
    middle, step = tilts.mean(axis=0), np.ptp(tilts, axis=0) / 2.0
    x, y = ((tilts - middle) / step).T
    _, gx, gy, xx, yy, xy = np.linalg.lstsq(
        np.column_stack([np.ones_like(x), x, y, x * x, y * y, x * y]), left, rcond=None
    )[0]
    bend = np.array([[2.0 * xx, xy], [xy, 2.0 * yy]])
    if np.linalg.eigvalsh(bend).min() <= 0.0:
        return tilts[left.argmin()]
    return middle + step * np.clip(np.linalg.solve(bend, [-gx, -gy]), -1.0, 1.0)
