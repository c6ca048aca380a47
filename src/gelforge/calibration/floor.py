"""How close any parameters of a model come to the readings, priors aside."""

from dataclasses import dataclass

import numpy as np

from gelforge.calibration.friction import friction_of
from gelforge.calibration.parameters import Model
from gelforge.calibration.posterior import Posterior

# Far beyond what a bench can be: the least error must not lie on a bound. The touch offset is bounded by the depth
# that the emulator was solved to.
BOUNDS = {"c10": (0.02, 0.4), "offset": (-0.3, 0.3), "compliance": (0.0, 0.08), "mu": (0.0, 0.999)}
DRAWS = 20000
STARTS = 8


@dataclass(frozen=True)
class Floor:
    """error: least mean absolute error, N. values: {parameter: value} there. residual: (r,) predicted - read, N."""

    error: float
    values: dict
    residual: np.ndarray


def least_error(posterior: Posterior) -> Floor:
    """Least mean absolute error of the noise-free forces over C10, offset, compliance and friction, no priors.

    Only parameters that the model leaves free move, friction as mu / (mu + 1/2); all others rest at no effect. Global
    by a random search, local by Nelder and Mead's simplex, restarted. Beyond the emulator's depth nothing counts.
    """
    from scipy.optimize import minimize

    names = [name for name in BOUNDS if name in posterior.model.free]
    low, high = np.array([BOUNDS[name] for name in names]).T
    used = np.isfinite(posterior.observed)

    def residuals(x):
        values = values_of(posterior.model, names, x)
        forces, _, depth = posterior.emulator.forces(posterior.depth, values)
        away = forces[:, used] - posterior.observed[used]
        return np.where((depth > posterior.emulator.top).any(axis=1)[:, None], np.inf, away)

    def error(x):
        inside = ((x >= low) & (x <= high)).all(axis=1)
        found = np.full(len(x), np.inf)
        found[inside] = np.abs(residuals(x[inside])).mean(axis=1)
        return np.where(np.isfinite(found), found, 1e9)

    rng = np.random.default_rng(0)
    draws = low + (high - low) * rng.random((DRAWS, len(names)))
    starts = draws[np.argsort(error(draws))[:STARTS]]
    for _ in range(4):  # a simplex that has shrunk onto an edge of |residual| finds on from a new one
        starts = np.array([_descend(minimize, error, x, 0.02 * (high - low)) for x in starts])
    best = starts[[np.argmin(error(starts))]]
    values = {name: float(v[0]) for name, v in values_of(posterior.model, names, best).items() if name in names}
    return Floor(float(error(best)[0]), values, residuals(best)[0])


def _descend(minimize, error, x, step) -> np.ndarray:
    simplex = np.vstack([x, x + np.diag(step)])
    options = {"initial_simplex": simplex, "xatol": 1e-9, "fatol": 1e-9, "maxiter": 800}
    return minimize(lambda y: error(y[None])[0], x, method="Nelder-Mead", options=options).x


def values_of(model: Model, names, x: np.ndarray) -> dict:
    """Every parameter as an array (w,) for Emulator.forces, from numbers x (w, len(names))."""
    count = len(x)
    values = {name: np.full(count, value) for name, value in model.fixed.items()}
    values |= {name: np.zeros(count) for name in model.free}
    if "nu" in model.free:
        values["nu"] = np.full(count, model.free["nu"].value(model.free["nu"].quantile(0.5)))
    for column, name in enumerate(names):
        values[name] = friction_of(x[:, column]) if name == "mu" else x[:, column]
    return {**values, "indenter": np.zeros((count, max(1, len(model.indenters))))}
