"""Parameters of the calibration, their priors, and the interface and rig models compared."""

from dataclasses import dataclass, replace

import numpy as np

from gelforge.calibration.friction import HALF_MU, friction_axis, friction_of
from gelforge.errors import BadInput
from gelforge.flow.params.tables import CalibrateTable, PriorTable
from gelforge.mechanics.contact.laws.coulomb import Coulomb
from gelforge.mechanics.contact.laws.frictionless import Frictionless
from gelforge.mechanics.contact.laws.no_slip import NoSlip

SOFT_BENCH = ("compliance", "shear_compliance")
NAMES = ("c10", "offset", *SOFT_BENCH, "mu", "noise", "scatter", "discretisation", "nu")
LABELS = {
    "c10": "C10 (MPa)",
    "offset": "touch offset (mm)",
    "compliance": "frame compliance (mm/N)",
    "shear_compliance": "frame compliance sideways (mm/N)",
    "mu": "friction coefficient",
    "noise": "noise (N)",
    "scatter": "touch scatter (mm)",
    "discretisation": "ln of scale, all forces",
    "nu": "Poisson's ratio",
}
# The contact laws that are compared, each with the friction coefficient it implies; Coulomb's is a parameter.
FRICTION = {Frictionless.name: 0.0, Coulomb.name: None, NoSlip.name: np.inf}
LAWS = tuple(FRICTION)


@dataclass(frozen=True)
class Prior:
    """Prior of one parameter; walkers move in a coordinate of it: its logarithm for the kinds named log….

    kind: "normal" (mean, spread), "lognormal" (median, spread of the logarithm), "halfnormal"
    (spread; values below zero excluded), "uniform" or "loguniform" (low, high).
    """

    kind: str
    a: float
    b: float

    @property
    def informative(self) -> bool:
        """Whether the prior alone bounds the parameter to a region it prefers."""
        return self.kind in ("normal", "lognormal", "halfnormal")

    @property
    def logarithmic(self) -> bool:
        return self.kind in ("lognormal", "loguniform")

    def value(self, coordinate):
        """Parameter values from walkers' coordinates, any shape."""
        return np.exp(coordinate) if self.logarithmic else np.asarray(coordinate)

    def log_density(self, coordinate) -> np.ndarray:
        """Log density in the coordinate, up to a constant; -inf outside the support."""
        x = np.asarray(coordinate, float)
        if self.kind == "halfnormal":
            return np.where(x >= 0.0, -0.5 * (x / self.b) ** 2, -np.inf)
        if self.informative:
            centre = np.log(self.a) if self.logarithmic else self.a
            return -0.5 * ((x - centre) / self.b) ** 2
        low, high = (np.log(self.a), np.log(self.b)) if self.logarithmic else (self.a, self.b)
        return np.where((x >= low) & (x <= high), 0.0, -np.inf)

    def draw(self, rng: np.random.Generator, size) -> np.ndarray:
        """Coordinates drawn from the prior, (size,)."""
        return self.quantile(rng.random(size))

    def quantile(self, u) -> np.ndarray:
        """Coordinates at probabilities `u` of the prior."""
        from scipy.special import ndtri

        u = np.asarray(u, float)
        if self.kind == "halfnormal":
            return self.b * ndtri(0.5 + 0.5 * u)
        if self.informative:
            return (np.log(self.a) if self.logarithmic else self.a) + self.b * ndtri(u)
        low, high = (np.log(self.a), np.log(self.b)) if self.logarithmic else (self.a, self.b)
        return low + (high - low) * u


@dataclass(frozen=True)
class FrictionPrior(Prior):
    """Prior of a friction coefficient whose walkers move on the emulator's friction axis, in (0, 1).

    Forces are nearly straight along that axis, and level off along mu itself: there the walkers
    would have to follow a bend.
    """

    def value(self, coordinate):
        return friction_of(np.asarray(coordinate))

    def log_density(self, coordinate) -> np.ndarray:
        x = np.asarray(coordinate, float)
        inside = (x > 0.0) & (x < 1.0)
        mu = friction_of(np.where(inside, x, 0.5))
        inner = super().log_density(np.log(mu) if self.logarithmic else mu)
        # d mu / d x = (mu + HALF_MU)^2 / HALF_MU; a logarithmic density is one in log mu.
        change = 2.0 * np.log(mu + HALF_MU) - (np.log(mu) if self.logarithmic else 0.0)
        return np.where(inside, inner + change, -np.inf)

    def quantile(self, u) -> np.ndarray:
        return friction_axis(super().value(super().quantile(u)))


def prior_of(name: str, table: PriorTable) -> Prior:
    """The prior of a parameter, from its table [calibrate.priors.NAME]."""
    numbers = [float(value) for value in table.numbers.values()]
    a, b = numbers if len(numbers) == 2 else (0.0, numbers[0])  # a halfnormal has no first number
    return FrictionPrior(table.kind, a, b) if name == "mu" else Prior(table.kind, a, b)


def held_nu(table: CalibrateTable, nu: float) -> float:
    """Poisson's ratio where its prior is not free: the value that the prior says, else `nu`, that of [material]."""
    fixed = table.priors.nu.fixed
    return nu if fixed is None else float(fixed)


def with_nu(table: CalibrateTable, nu: float) -> CalibrateTable:
    """The table [calibrate] with Poisson's ratio held at `nu` where its prior is not free and says no other value."""
    held = replace(table.priors.nu, fixed=held_nu(table, nu))
    return replace(table, priors=replace(table.priors, nu=held))


@dataclass(frozen=True)
class Model:
    """One hypothesis: an interface law, and which parameters are free.

    free: {name: Prior} in the order of NAMES, then "scale of INDENTER" where several indenters
    serve. fixed: {name: value} of all others. indenters: names in the order of Emulator.group.
    """

    law: str
    free: dict
    fixed: dict
    indenters: tuple = ()

    @property
    def name(self) -> str:
        """The law and what the rig is free in; a soft bench goes by the first of its compliances that is free."""
        soft = [part for part in SOFT_BENCH if part in self.free][:1]
        rig = ["offset", *soft] if "offset" in self.free else soft
        return self.law + "".join(f"+{part}" for part in rig)

    @property
    def names(self) -> tuple:
        return tuple(self.free)

    def values(self, coordinates) -> dict:
        """Every parameter as an array (w,) from coordinates (w, free), and `indenter`, (w, indenters)."""
        coordinates = np.atleast_2d(coordinates)
        values = {name: np.full(len(coordinates), value) for name, value in self.fixed.items()}
        for column, (name, prior) in enumerate(self.free.items()):
            values[name] = prior.value(coordinates[:, column])
        none = np.zeros(len(coordinates))
        scales = [values.get(f"scale of {name}", none) for name in self.indenters] or [none]
        return {**values, "indenter": np.stack(scales, axis=1)}

    def log_prior(self, coordinates) -> np.ndarray:
        """Sum of the log densities, (w,)."""
        return sum(prior.log_density(coordinates[:, i]) for i, prior in enumerate(self.free.values()))

    def draw(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Coordinates drawn from the priors, (size, free)."""
        return np.stack([prior.draw(rng, size) for prior in self.free.values()], axis=1)


def make_model(params: CalibrateTable, law: str, without=(), indenters=()) -> Model:
    """Model of `law` from the table [calibrate]; free ones that `without` names are held at no effect.

    A parameter is free unless its prior says `free = false`; then it stays at `fixed`. Several
    indenters get a scale each, with the prior `indenter`.
    """
    free, fixed = {}, {}
    for name in NAMES:
        table = getattr(params.priors, name)
        if name == "mu" and (implied := FRICTION[law]) is not None:
            fixed[name] = implied
        elif name in without and table.free is not False:
            fixed[name] = 0.0
        elif table.free is not False:
            free[name] = prior_of(name, table)
        elif table.fixed is not None:
            fixed[name] = float(table.fixed)
        else:
            raise BadInput(f"[calibrate.priors.{name}]: free = false needs `fixed`, the value it is held at")
    if len(indenters) > 1 and params.priors.indenter.free is not False:
        prior = prior_of("indenter", params.priors.indenter)
        free.update({f"scale of {name}": prior for name in indenters})
    return Model(law, free, fixed, tuple(indenters))


def label_of(name: str) -> str:
    """Name of a parameter for people, with its unit."""
    return LABELS.get(name, name.replace("scale of ", "ln of scale, "))


def compared_models(params: CalibrateTable, indenters=(), held=()) -> list[Model]:
    """Every law with and without touch offset and a soft bench; parameters named in `held` are at no effect in all."""
    rigs: list[tuple] = [(), SOFT_BENCH, ("offset",), ("offset", *SOFT_BENCH)]
    models = [make_model(params, law, (*without, *held), indenters) for law in LAWS for without in rigs]
    return list({model.name: model for model in models}.values())
