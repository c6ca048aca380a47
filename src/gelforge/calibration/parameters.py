"""Parameters of the calibration and their priors."""

import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy import stats

from gelforge.calibration.emulator import HALF_MU, friction_axis, friction_of
from gelforge.flow.tables import CalibrateTable, PriorTable
from gelforge.mechanics.contact.law import Frictionless, NoSlip

TARE = ("tare_x", "tare_y", "tare_z")
TILT = ("tilt_x", "tilt_y")
ORIGIN = ("origin_x", "origin_y")
NAMES = ("c10", "offset", "compliance", "shear_compliance", "mu", *TARE, "noise", "scatter", "discretisation")
SIDEWAYS = ("shear_compliance", "tare_x", "tare_y")  # that only sideways forces determine
LABELS = {
    "c10": "C10 (MPa)",
    "offset": "touch offset (mm)",
    "compliance": "frame compliance (mm/N)",
    "shear_compliance": "frame compliance sideways (mm/N)",
    "mu": "friction coefficient",
    "tare_x": "constant force along x (N)",
    "tare_y": "constant force along y (N)",
    "tare_z": "constant force along z (N)",
    "noise": "noise (N)",
    "scatter": "touch scatter (mm)",
    "discretisation": "ln of scale, all forces",
    "tilt_x": "tilt about x (degrees)",
    "tilt_y": "tilt about y (degrees)",
    "origin_x": "origin of the moments along x (mm)",
    "origin_y": "origin of the moments along y (mm)",
}
FRICTION = {Frictionless.name: 0.0, NoSlip.name: np.inf}  # coefficient that a law implies; Coulomb's is a parameter
# Distributions of scipy.stats by kind of prior, from the numbers of its table.
KINDS = {
    "normal": lambda n: stats.norm(n["mean"], n["spread"]),
    "lognormal": lambda n: stats.lognorm(n["spread"], scale=n["median"]),
    "halfnormal": lambda n: stats.halfnorm(scale=n["spread"]),
    "cauchy": lambda n: stats.cauchy(n["mean"], n["spread"]),
}
# What to check if a parameter is outside its usual range.
CHECK = {
    "c10": "check the gel's thickness, the sizes of the indenters and the unit of the forces",
    "offset": "check how touch was found and z0_mm of the log",
    "compliance": "check that the frame is screwed tight and the unit of the forces",
    "shear_compliance": "check that the frame is screwed tight, and the signs of dx_mm, dy_mm, fx_n and fy_n",
    "mu": "check dx_mm, dy_mm and the sideways forces",
    "discretisation": "check the unit of the forces",
    "indenter": "check this indenter's size and rot_deg",
    "tilt": "check how the sensor is mounted, and the signs of mx_nm and my_nm",
}
# A median in a tail of its prior, on either side, with less than this probability is unusual: for a cauchy prior,
# more than five spreads away.
BEYOND = {"cauchy": 0.063}
BEYOND_OTHERS = 0.005
POINTS = 6401  # of a prior's table over its coordinate; interpolated values are accurate to 1e-6


@dataclass(frozen=True)
class Prior:
    """Prior of one parameter: a distribution of scipy.stats whose kind is in KINDS.

    Walkers move in the coordinate z in which the prior is a standard normal distribution: F(value) = Phi(z).
    """

    kind: str
    law: Any

    RANGE: ClassVar[tuple[float, float]] = (-8.0, 8.0)  # of the coordinate

    def value(self, z: np.ndarray) -> np.ndarray:
        """Parameter values at coordinates `z`."""
        tail = stats.norm.sf(np.abs(z))  # from the nearer end, because probabilities near 1 have few digits
        return np.where(z > 0, self.law.isf(tail), self.law.ppf(tail))

    def log_density(self, z: np.ndarray) -> np.ndarray:
        """Log density in the coordinate, up to a constant."""
        return -0.5 * z**2

    def quantile(self, probability: np.ndarray) -> np.ndarray:
        """Coordinates at probabilities of the prior."""
        return stats.norm.ppf(probability)


class FrictionPrior(Prior):
    """Prior of a friction coefficient, whose walkers move on the emulator's friction axis, in (0, 1).

    Forces are nearly linear in it, and so is the ridge of the posterior along which C10 and friction trade off. In
    any other coordinate the ridge is curved, and walkers cannot follow it.
    """

    RANGE: ClassVar[tuple[float, float]] = (1e-4, 1.0 - 1e-4)

    def value(self, z: np.ndarray) -> np.ndarray:
        return friction_of(z)

    def log_density(self, z: np.ndarray) -> np.ndarray:
        # d mu / d axis = (mu + HALF_MU)^2 / HALF_MU
        mu = friction_of(z)
        return self.law.logpdf(mu) + 2.0 * np.log(mu + HALF_MU)

    def quantile(self, probability: np.ndarray) -> np.ndarray:
        return np.clip(friction_axis(self.law.ppf(probability)), *self.RANGE)


def prior_of(table: PriorTable, kind: type[Prior] = Prior) -> Prior:
    """The prior that a table [calibrate.priors.NAME] states."""
    return kind(table.kind, KINDS[table.kind]({key: float(value) for key, value in table.numbers.items()}))


@dataclass(frozen=True)
class BenchModel:
    """An interface law, and which parameters are free.

    free: {name: Prior} in the order of NAMES, then "scale of INDENTER" if several indenters
    are used. fixed: {name: value} of all others. indenters: names in the order of Emulator.group. mountings: names in
    the order of Emulator.mounting; with several of them, each has a parameter "offset of MOUNTING" and, if its tilt is
    found, "tilt_x of MOUNTING" and "tilt_y of MOUNTING".
    """

    law: str
    free: dict[str, Prior]
    fixed: dict[str, float]
    indenters: tuple[str, ...] = ()
    mountings: tuple[str, ...] = ("",)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.free)

    @cached_property
    def _tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ends of the coordinates (free, 2), and values and log densities (free, POINTS) of the priors in between."""
        ends = np.array([prior.RANGE for prior in self.free.values()])
        grids = np.linspace(ends[:, 0], ends[:, 1], POINTS, axis=1)
        pairs = list(zip(self.free.values(), grids, strict=True))
        values = np.array([prior.value(grid) for prior, grid in pairs])
        return ends, values, np.array([prior.log_density(grid) for prior, grid in pairs])

    def _between(self, coordinates: np.ndarray, table: np.ndarray) -> np.ndarray:
        """A table (free, POINTS) at coordinates (w, free), linear between its points; its ends beyond."""
        low, high = self._tables[0].T
        at = np.clip((coordinates - low) / (high - low), 0.0, 1.0) * (POINTS - 1)
        below = np.minimum(at.astype(int), POINTS - 2)
        column = np.arange(len(low))
        left = table[column, below]
        return left + (at - below) * (table[column, below + 1] - left)

    def log_prior(self, coordinates: np.ndarray) -> np.ndarray:
        """Sum of the priors' log densities at coordinates (w, free), (w,); -inf outside their ranges."""
        low, high = self._tables[0].T
        inside = ((coordinates >= low) & (coordinates <= high)).all(axis=1)
        return np.where(inside, self._between(coordinates, self._tables[2]).sum(axis=1), -np.inf)

    def coordinates(self, probabilities: np.ndarray) -> np.ndarray:
        """Coordinates (w, free) at probabilities (w, free) of the priors."""
        return np.stack(
            [prior.quantile(u) for prior, u in zip(self.free.values(), probabilities.T, strict=True)], axis=1
        )

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Coordinates (size, free) drawn from the priors."""
        return self.coordinates(rng.random((size, len(self.free))))

    def beyond_priors(self, medians: dict[str, float]) -> list[str]:
        """A sentence on each parameter whose median is unusual under its prior (BEYOND), with what to check."""
        said = []
        for name, value in medians.items():
            prior = self.free[name]
            tail = BEYOND.get(prior.kind, BEYOND_OTHERS)
            low, high = (float(v) for v in prior.law.ppf([tail, 1.0 - tail]))
            key = prior_name(name)
            if key in CHECK and not low <= value <= high:
                said.append(
                    f"The {label_of(name)} is {value:.3g}, outside of what its prior expects ({low:.3g} to {high:.3g}): "
                    f"{CHECK[key]}, or change [calibrate.priors.{key}] if you know better."
                )
        return said

    def values(self, coordinates) -> dict[str, np.ndarray]:
        """Every parameter as an array (w,) from coordinates (w, free), and those that several presses share.

        `indenter`: (w, indenters), logarithms of factors. `touch`: (w, mountings), mm. `tilt`: (w, mountings, 2), degrees.
        """
        coordinates = np.atleast_2d(coordinates)
        values = {name: np.full(len(coordinates), value) for name, value in self.fixed.items()}
        values |= zip(self.free, self._between(coordinates, self._tables[1]).T, strict=True)
        none = np.zeros(len(coordinates))
        scales = [values.get(f"scale of {name}", none) for name in self.indenters] or [none]
        touch = [values[self.of("offset", name)] for name in self.mountings]
        tilt = [[values.get(self.of(axis, name), none) for axis in TILT] for name in self.mountings]
        return {
            **values,
            "indenter": np.stack(scales, axis=1),
            "touch": np.stack(touch, axis=1),
            "tilt": np.moveaxis(np.array(tilt), 2, 0),
        }

    def of(self, name: str, mounting: str) -> str:
        """Name of a parameter of a mounting; that of rows which name none is as if there were one alone."""
        return name if len(self.mountings) == 1 or not mounting else f"{name} of {mounting}"


def make_model(
    params: CalibrateTable,
    law: str,
    indenters=(),
    sideways: bool = True,
    mountings: tuple[str, ...] = ("",),
    tilted: Collection[str] = (),
) -> BenchModel:
    """Model of `law` from the table [calibrate].

    A parameter is free unless its prior says `free = false`; then it stays at `fixed`. Several
    indenters get a scale each, with the prior `indenter`. sideways: whether sideways forces are used; if not, the
    parameters that only they determine (SIDEWAYS) are fixed at 0. tilted: the mountings whose tilt is free.
    """
    free: dict[str, Prior] = {}
    fixed: dict[str, float] = {}
    model = BenchModel(law, free, fixed, tuple(indenters), tuple(mountings))
    of_mountings = [model.of("offset", name) for name in mountings]
    of_mountings += [model.of(axis, name) for name in mountings if name in tilted for axis in TILT]
    shared = [name for name in NAMES if name != "offset"]
    for name in ["c10", *of_mountings, *shared[1:], *(ORIGIN if tilted else ())]:
        table = getattr(params.priors, prior_name(name))
        if name == "mu" and law in FRICTION:
            fixed[name] = FRICTION[law]
        elif not sideways and name in SIDEWAYS:
            fixed[name] = 0.0
        elif table.free is False and table.fixed is not None:
            fixed[name] = float(table.fixed)
        else:
            free[name] = prior_of(table, FrictionPrior if name == "mu" else Prior)
    if len(indenters) > 1 and params.priors.indenter.free is not False:
        prior = prior_of(params.priors.indenter)
        free.update({f"scale of {name}": prior for name in indenters})
    return model


def prior_name(name: str) -> str:
    """Name of a parameter's table in [calibrate.priors]."""
    if name.startswith("scale of "):
        return "indenter"
    kind = name.split(" of ", maxsplit=1)[0]
    shared = ((TARE, "tare"), (TILT, "tilt"), (ORIGIN, "origin"))
    return next((table for names, table in shared if kind in names), kind)


def label_of(name: str) -> str:
    """Name of a parameter for people, with its unit."""
    kind, _, mounting = name.partition(" of ")
    if mounting and kind in LABELS:
        return f"{LABELS[kind]} of {mounting}"
    return LABELS.get(name, name.replace("scale of ", "ln of scale, "))


def plain_name(name: str) -> str:
    """Name of a parameter for people, without its unit."""
    return re.sub(r" \(.*?\)", "", label_of(name))
