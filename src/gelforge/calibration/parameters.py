"""Parameters of the calibration, their priors, and the interface laws that are compared."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import stats

from gelforge.calibration.emulator import HALF_MU, friction_axis, friction_of
from gelforge.flow.params.tables import CalibrateTable, PriorTable
from gelforge.mechanics.contact.laws.coulomb import Coulomb
from gelforge.mechanics.contact.laws.frictionless import Frictionless
from gelforge.mechanics.contact.laws.no_slip import NoSlip

TARE = ("tare_x", "tare_y", "tare_z")
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
}
# The contact laws that are compared, each with the friction coefficient it implies; Coulomb's is a parameter.
FRICTION = {Frictionless.name: 0.0, Coulomb.name: None, NoSlip.name: np.inf}
LAWS = tuple(FRICTION)
# Distributions of scipy.stats by kind of prior, from the numbers of its table.
KINDS = {
    "normal": lambda n: stats.norm(n["mean"], n["spread"]),
    "lognormal": lambda n: stats.lognorm(n["spread"], scale=n["median"]),
    "halfnormal": lambda n: stats.halfnorm(scale=n["spread"]),
    "cauchy": lambda n: stats.cauchy(n["mean"], n["spread"]),
    "uniform": lambda n: stats.uniform(n["low"], n["high"] - n["low"]),
    "loguniform": lambda n: stats.loguniform(n["low"], n["high"]),
}
# Standard normal coordinates at which a prior is tabulated, so fine that values in between are good to 1e-6.
COORDINATES = np.linspace(-8.0, 8.0, 6401)
FRICTION_COORDINATES = np.linspace(0.0, 1.0, 4001)[1:-1]


@dataclass(frozen=True)
class Prior:
    """Prior of one parameter: a distribution of scipy.stats, of one of KINDS.

    Walkers move in the coordinate z in which the prior is a standard normal distribution: F(value) = Phi(z).
    """

    kind: str
    law: Any

    @property
    def informative(self) -> bool:
        """Whether the prior alone bounds the parameter to a region it prefers."""
        return self.kind not in ("uniform", "loguniform")

    @cached_property
    def _values(self) -> np.ndarray:
        z = COORDINATES
        upper = z > 0  # from the upper end, where probabilities near 1 have few digits
        return np.where(upper, self.law.isf(stats.norm.sf(np.abs(z))), self.law.ppf(stats.norm.sf(np.abs(z))))

    def value(self, z) -> np.ndarray:
        """Parameter values at coordinates `z`, any shape."""
        return np.interp(z, COORDINATES, self._values)

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Coordinates (size,) drawn from the prior."""
        return rng.standard_normal(size)

    def log_density(self, z: np.ndarray) -> np.ndarray:
        """Log density in the coordinate, up to a constant."""
        return -0.5 * z**2


class FrictionPrior(Prior):
    """Prior of a friction coefficient, whose walkers move on the emulator's friction axis, in (0, 1).

    Along it forces are nearly straight, and with them the ridge on which C10 and friction trade. In any other
    coordinate the ridge is bent, and walkers cannot follow.
    """

    @cached_property
    def _densities(self) -> np.ndarray:
        # d mu / d axis = (mu + HALF_MU)^2 / HALF_MU
        mu = friction_of(FRICTION_COORDINATES)
        return self.law.logpdf(mu) + 2.0 * np.log(mu + HALF_MU)

    def value(self, z) -> np.ndarray:
        return friction_of(np.clip(z, FRICTION_COORDINATES[0], FRICTION_COORDINATES[-1]))

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        return friction_axis(super().value(super().draw(rng, size)))

    def log_density(self, z: np.ndarray) -> np.ndarray:
        return np.interp(z, FRICTION_COORDINATES, self._densities, left=-np.inf, right=-np.inf)


def prior_of(table: PriorTable, kind: type[Prior] = Prior) -> Prior:
    """The prior that a table [calibrate.priors.NAME] states."""
    return kind(table.kind, KINDS[table.kind]({key: float(value) for key, value in table.numbers.items()}))


@dataclass(frozen=True)
class Model:
    """One hypothesis: an interface law, and which parameters are free.

    free: {name: Prior} in the order of NAMES, then "scale of INDENTER" where several indenters
    serve. fixed: {name: value} of all others. indenters: names in the order of Emulator.group.
    """

    law: str
    free: dict[str, Prior]
    fixed: dict[str, float]
    indenters: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.free)

    def log_prior(self, coordinates: np.ndarray) -> np.ndarray:
        """Sum of the priors' log densities, (w,)."""
        densities = [prior.log_density(coordinates[:, i]) for i, prior in enumerate(self.free.values())]
        return np.sum(densities, axis=0)

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Coordinates (size, free) drawn from the priors."""
        return np.stack([prior.draw(rng, size) for prior in self.free.values()], axis=1)

    def values(self, coordinates) -> dict[str, np.ndarray]:
        """Every parameter as an array (w,) from coordinates (w, free), and `indenter`, (w, indenters)."""
        coordinates = np.atleast_2d(coordinates)
        values = {name: np.full(len(coordinates), value) for name, value in self.fixed.items()}
        for column, (name, prior) in enumerate(self.free.items()):
            values[name] = prior.value(coordinates[:, column])
        none = np.zeros(len(coordinates))
        scales = [values.get(f"scale of {name}", none) for name in self.indenters] or [none]
        return {**values, "indenter": np.stack(scales, axis=1)}


def make_model(params: CalibrateTable, law: str, indenters=(), sideways: bool = True) -> Model:
    """Model of `law` from the table [calibrate].

    A parameter is free unless its prior says `free = false`; then it stays at `fixed`. Several
    indenters get a scale each, with the prior `indenter`. sideways: whether readings of sideways forces serve; without
    any, the parameters that only they determine have no effect.
    """
    free, fixed = {}, {}
    for name in NAMES:
        table = params.priors.tare if name in TARE else getattr(params.priors, name)
        implied = FRICTION[law] if name == "mu" else None
        if implied is not None:
            fixed[name] = implied
        elif not sideways and name in SIDEWAYS:
            fixed[name] = 0.0
        elif table.free is False and table.fixed is not None:
            fixed[name] = float(table.fixed)
        else:
            free[name] = prior_of(table, FrictionPrior if name == "mu" else Prior)
    if len(indenters) > 1 and params.priors.indenter.free is not False:
        prior = prior_of(params.priors.indenter)
        free.update({f"scale of {name}": prior for name in indenters})
    return Model(law, free, fixed, tuple(indenters))


def label_of(name: str) -> str:
    """Name of a parameter for people, with its unit."""
    return LABELS.get(name, name.replace("scale of ", "ln of scale, "))
