"""Summary of a posterior in numbers and in sentences that a person can act on."""

import numpy as np
from scipy.stats import norm

from gelforge.calibration.parameters import ORIGIN, TARE, TILT, BenchModel, label_of, plain_name
from gelforge.calibration.posterior import Posterior
from gelforge.calibration.sampling import Chain

QUANTILES = {"interval68": (0.16, 0.84), "interval95": (0.025, 0.975)}
DRAWS = 4000  # draws for predictions and scores; Monte Carlo error far below the posterior's width
RELIABLE = 0.7  # Pareto shape up to which leave-one-out by importance sampling can be trusted (Vehtari et al. 2024)


def describe(draws) -> dict:
    """Median, 68 % and 95 % interval of draws (s,), as plain floats."""
    numbers = {name: [float(q) for q in np.quantile(draws, pair)] for name, pair in QUANTILES.items()}
    return {"median": float(np.median(draws)), **numbers}


def parameter_table(chain: Chain, model: BenchModel) -> dict[str, dict]:
    """Posterior of every parameter with its prior's 95 % interval and how far the data narrowed it.

    The width is that of the 68 % interval, in the coordinate in which the prior is a standard normal distribution.
    """
    draws, table = model.values(chain.flat()), {}
    for name, prior in model.free.items():
        low, high = normal_coordinate(prior.law, np.quantile(draws[name], QUANTILES["interval68"]))
        table[name] = {
            **describe(draws[name]),
            "label": label_of(name),
            "prior_kind": prior.kind,
            "prior_interval95": [float(v) for v in prior.law.ppf(QUANTILES["interval95"])],
            "width_over_prior": float((high - low) / 2.0),
        }
    return table


def normal_coordinate(law, values: np.ndarray) -> np.ndarray:
    """Values (n,) in the coordinate in which a prior's law is a standard normal; in its tails by the smaller side."""
    below, above = law.cdf(values), law.sf(values)
    return np.where(below < 0.5, norm.ppf(below), -norm.ppf(above))


def bench(parameters: dict, model: BenchModel) -> dict:
    """Parameters of the bench that change a path: medians, or their fixed values; mm, mm/N and degrees.

    mountings: by name, offset and, where it was found, tilt. `offset` is that of the rows that name no mounting; if all
    name one, that of the middle one.
    """

    def value(name: str) -> float:
        return float(parameters[name]["median"] if name in parameters else model.fixed[name])

    mountings: dict[str, dict] = {}
    for name in model.mountings:
        mountings[name] = {"offset": value(model.of("offset", name))}
        if model.of(TILT[0], name) in parameters:
            mountings[name]["tilt_deg"] = [value(model.of(axis, name)) for axis in TILT]
    middle = float(np.median([one["offset"] for one in mountings.values()]))
    offset = mountings[""]["offset"] if "" in mountings else middle
    return (
        {"offset": offset}
        | {name: value(name) for name in ("compliance", "shear_compliance")}
        | {"mountings": mountings}
    )


def correlations(chain, model) -> dict:
    """Correlation matrix of the walkers' coordinates."""
    matrix = np.corrcoef(chain.flat(DRAWS), rowvar=False)
    return {"names": list(model.names), "matrix": np.round(np.atleast_2d(matrix), 4).tolist()}


def predictions(chain, posterior) -> tuple[np.ndarray, np.ndarray]:
    """Posterior predictive mean (n, 3) of a repeated press, and the scale (n, 3) of a reading about it, N.

    A repeated press has another touch error, so the mean does not include that of the logged one.
    """
    forces, scale = posterior.predict(chain.flat(DRAWS))
    spread = np.sqrt(forces.var(axis=0) + (scale**2).mean(axis=0))
    return forces.mean(axis=0), spread


def predictive_error(mean, observed) -> dict:
    """Mean absolute error of the predictive mean, N, per component that is used."""
    error = {}
    for column, name in enumerate(("fx", "fy", "fz")):
        used = np.isfinite(observed[:, column])
        if used.any():
            error[name] = float(np.abs(mean[used, column] - observed[used, column]).mean())
    return error


def find_outliers(readings, mean, scale, observed, threshold: float) -> list[dict]:
    """Readings further than `threshold` scales from the predictive mean; they stay in the fit, with a low weight."""
    rows = []
    for i, column in zip(*np.nonzero(np.isfinite(observed)), strict=True):
        z = (observed[i, column] - mean[i, column]) / scale[i, column]
        if abs(z) > threshold:
            rows.append(
                {
                    "row": int(readings.rows[i]), "sample_id": str(readings.ids[i]), "component": "xyz"[column],
                    "measured_n": float(observed[i, column]), "predicted_n": float(mean[i, column]),
                    "scales_away": round(float(z), 2),
                }
            )  # fmt: skip
    return sorted(rows, key=lambda r: -abs(r["scales_away"]))


def left_out(chain: Chain, posterior: Posterior) -> tuple[np.ndarray, float]:
    """Predictive mean (n, 3) N of each press when the whole of it is left out, and the largest Pareto shape.

    By Pareto-smoothed importance sampling (Vehtari, Gelman, Gabry 2017, Statistics and Computing 27:1413), without new solves.
    """
    from arviz_stats.base import array_stats

    coordinates = chain.flat(DRAWS)
    forces, _ = posterior.predict(coordinates)
    # psislw takes the log-likelihood of the left-out press and changes its sign itself
    weights, shape = array_stats.psislw(posterior.by_press(coordinates).T, axis=-1)
    return np.einsum("nw,wnc->nc", np.exp(weights), forces), float(np.max(shape))


def sentences(parameters: dict, correlation: dict, model: BenchModel) -> list[str]:
    """What the data say and what they cannot separate, in plain words."""
    c10 = parameters["c10"]
    low, high = c10["interval95"]
    said = [
        f"C10 is {c10['median']:.4f} MPa under {model.law}, between {low:.4f} and {high:.4f} with 95 % probability."
    ]
    return (
        said
        + _tilts(parameters, model)
        + model.beyond_priors({name: row["median"] for name, row in parameters.items()})
        + _trades(correlation)
        + _unseen(parameters)
    )


def _tilts(parameters: dict, model: BenchModel) -> list[str]:
    """A sentence on the tilt of each mounting that has one, with its 95 % interval."""
    said = []
    for name in model.mountings:
        rows = [parameters.get(model.of(axis, name)) for axis in TILT]
        if rows[0] and rows[1]:
            about = [
                f"{row['median']:.1f} degrees about {axis} ({row['interval95'][0]:.1f} to {row['interval95'][1]:.1f})"
                for axis, row in zip("xy", rows, strict=True)
                if row
            ]
            where = (
                f"mounting {name!r}"
                if name
                else "the bench" + " without a named mounting" * (len(model.mountings) > 1)
            )
            said.append(f"By the moments of its flat presses {where} leans by {' and '.join(about)}.")
    return said


def predictive_sentence(error: dict, shape: float) -> str:
    """Sentence on the error of the normal force of a press that is left out of the fit."""
    rough = "" if shape <= RELIABLE else " Single presses decide on much of the result, so this is rough."
    return f"A press that is left out is predicted with an error of {error['fz']:.3f} N of normal force on average.{rough}"


def _trades(correlation: dict) -> list[str]:
    names = correlation["names"]
    row = correlation["matrix"][names.index("c10")]
    strong = [(n, r) for n, r in zip(names, row, strict=True) if n != "c10" and abs(r) > 0.5]
    strong.sort(key=lambda pair: -abs(pair[1]))
    said = []
    for name, r in strong:
        hint = "press other indenters" if name.startswith("scale of ") else "measure that one separately"
        what = plain_name(name)
        said.append(f"C10 trades off against the {what} (correlation {r:+.2f}): {hint} to narrow C10.")
    return said


def _unseen(parameters: dict) -> list[str]:
    # Data cannot determine the emulator's scale, which only widens C10; a tare that stays as its prior is good news.
    expected = ("discretisation", *TARE, *ORIGIN)
    blind = [
        n
        for n in parameters
        if n not in expected
        and not n.startswith("scale of ")
        and parameters[n]["width_over_prior"] > 0.8
        and not _far(parameters[n])
    ]
    if not blind:
        return []
    names = ", ".join(plain_name(n) for n in blind)
    return [f"The data say almost nothing about {names}: the posterior is the prior."]


def _far(row: dict) -> bool:
    """Whether the data moved a parameter out of its prior's 95 % interval: then the prior disagrees, not the data."""
    low, high = row["prior_interval95"]
    return not low <= row["median"] <= high
