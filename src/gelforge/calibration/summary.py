"""What a posterior says, in numbers and in sentences a person can act on."""

import numpy as np
from scipy.stats import norm

from gelforge.calibration.parameters import NAMES, TARE, Model, label_of
from gelforge.calibration.posterior import Posterior, tare_of
from gelforge.calibration.sampling import Chain

QUANTILES = {"interval68": (0.16, 0.84), "interval95": (0.025, 0.975)}
DRAWS = 4000  # draws for predictions and scores; Monte Carlo error far below the posterior's width
NEAR = 4.0  # differences of elpd below this are small (Sivula et al. 2020, arXiv:2008.10296, section 5)
RELIABLE = 0.7  # Pareto shape up to which leave-one-out by importance sampling can be trusted (Vehtari et al. 2024)


def describe(draws) -> dict:
    """Median, 68 % and 95 % interval of draws (s,), as plain floats."""
    numbers = {name: [float(q) for q in np.quantile(draws, pair)] for name, pair in QUANTILES.items()}
    return {"median": float(np.median(draws)), **numbers}


def parameter_table(chain: Chain, model: Model) -> dict[str, dict]:
    """Posterior of every parameter with its prior's 95 % interval and how far the data narrowed it.

    The width is that of the 68 % interval, in the coordinate in which the prior is a standard normal distribution.
    """
    draws, table = model.values(chain.flat()), {}
    for name, prior in model.free.items():
        low, high = norm.ppf(prior.law.cdf(np.quantile(draws[name], QUANTILES["interval68"])))
        table[name] = {
            **describe(draws[name]),
            "label": label_of(name),
            "prior_kind": prior.kind,
            "prior_interval95": [float(v) for v in prior.law.ppf(QUANTILES["interval95"])],
            "width_over_prior": float((high - low) / 2.0),
        }
    return table


def bench(parameters: dict, fixed: dict) -> dict[str, float]:
    """What the bench does to a path: medians of its parameters, or what they were held at; mm and mm/N."""
    return {
        name: float(parameters[name]["median"] if name in parameters else fixed[name])
        for name in ("offset", "compliance", "shear_compliance")
    }


def correlations(chain, model) -> dict:
    """Correlation matrix of the walkers' coordinates."""
    matrix = np.corrcoef(chain.flat(), rowvar=False)
    return {"names": list(model.names), "matrix": np.round(np.atleast_2d(matrix), 4).tolist()}


def predictions(chain, posterior) -> tuple[np.ndarray, np.ndarray]:
    """Posterior predictive mean (n, 3) of a press repeated, and the scale (n, 3) of a reading about it, N.

    A press repeated touches anew: its error of touch is another one, and the mean knows nothing of it.
    """
    forces, scale = posterior.predict(chain.flat(DRAWS))
    spread = np.sqrt(forces.var(axis=0) + (scale**2).mean(axis=0))
    return forces.mean(axis=0), spread


def own_forces(chain, posterior) -> np.ndarray:
    """Posterior predictive mean at these very presses, (n, 3) N: what their sensor would read if read again.

    Each press keeps what is its own: an error of touch with deviation `scatter`, and the emulator's error. The likelihood has
    integrated both out; all but the sensor's noise stays when a press is read again. Given the reading of its normal
    force, which is thus used twice, their mean follows from the linear slope; it is the same for normal errors and
    for Student's t. Sideways only the error of touch is carried over.
    """
    coordinates = chain.flat(DRAWS)
    values = posterior.model.values(coordinates)
    forces, slopes, _ = posterior.emulator.forces(posterior.depth, values)
    own = forces + tare_of(values)[:, None]
    slope, residual = slopes[:, :, 2], posterior.observed[:, 2] - own[:, :, 2]
    explained = residual / posterior.scale(forces, slopes, values)[:, :, 2] ** 2  # by a unit of variance
    noise, scatter = (values[name][:, None] ** 2 for name in ("noise", "scatter"))
    own[:, :, :2] += slopes[:, :, :2] * (scatter * slope * explained)[:, :, None]
    own[:, :, 2] += residual - noise * explained
    return own.mean(axis=0)


def predictive_error(mean, observed) -> dict:
    """Mean absolute error of the predictive mean, N, per component that serves."""
    error = {}
    for column, name in enumerate(("fx", "fy", "fz")):
        used = np.isfinite(observed[:, column])
        if used.any():
            error[name] = float(np.abs(mean[used, column] - observed[used, column]).mean())
    return error


def find_outliers(readings, mean, scale, observed, threshold: float) -> list[dict]:
    """Readings further than `threshold` scales from the predictive mean; they still serve, with a low weight."""
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


def score(posterior: Posterior, chain: Chain) -> tuple[np.ndarray, float]:
    """Expected log predictive density (r,) of each reading when it is left out, and the largest Pareto shape.

    By Pareto-smoothed importance sampling (Vehtari, Gelman, Gabry 2017, Statistics and Computing 27:1413).
    """
    from arviz_stats.base import array_stats

    terms = posterior.pointwise(chain.flat(DRAWS))
    elpd, shape, _ = array_stats.loo(terms.T[:, None, :])
    return np.asarray(elpd), float(np.max(shape))


def compare(results: list[tuple[Posterior, Chain]]) -> list[dict]:
    """Table of the interface laws, the best predicting first."""
    scores = [score(*result) for result in results]
    order = sorted(range(len(results)), key=lambda k: -scores[k][0].sum())
    best = scores[order[0]][0]
    table = []
    for k in order:
        (posterior, chain), (elpd, shape) = results[k], scores[k]
        gap = best - elpd
        behind, error = float(gap.sum()), float(np.sqrt(len(gap)) * gap.std(ddof=1))
        mean, _ = predictions(chain, posterior)
        table.append(
            {
                "law": posterior.model.law,
                "elpd": float(elpd.sum()),
                "behind": behind,
                "behind_standard_error": error,
                "pareto_shape": shape,
                "indistinguishable": bool(behind <= max(NEAR, 2.0 * error)),
                "c10": describe(posterior.model.values(chain.flat())["c10"]),
                "predictive_mae_n": predictive_error(mean, posterior.observed),
                "own_touch_mae_n": predictive_error(own_forces(chain, posterior), posterior.observed),
            }
        )
    return table


def sentences(parameters: dict, correlation: dict, laws: list[dict], law: str) -> list[str]:
    """What the data say and what they cannot separate, in plain words."""
    c10 = parameters["c10"]
    low, high = c10["interval95"]
    said = [f"C10 is {c10['median']:.4f} MPa under {law}, between {low:.4f} and {high:.4f} with 95 % probability."]
    return said + law_sentences(laws) + _trades(correlation) + _unseen(parameters)


def law_sentences(laws: list[dict]) -> list[str]:
    """Which interface laws predict equally well, what that leaves open, and which are ruled out."""
    if len(laws) < 2:
        return []
    alike = [m for m in laws if m["indistinguishable"]]
    unlikely = [m["law"] for m in laws if not m["indistinguishable"]]
    said = []
    if len(alike) > 1:
        medians = [m["c10"]["median"] for m in alike]
        said.append(
            f"The data cannot separate {', '.join(m['law'] for m in alike)}: they predict readings that were left out equally"
            f" well, yet their medians of C10 run from {min(medians):.4f} to {max(medians):.4f} MPa."
        )
    if unlikely:
        said.append(f"The data speak against {', '.join(unlikely)}.")
    if max(m["pareto_shape"] for m in laws) > RELIABLE:
        said.append("The comparison of the laws turns on single readings and is rough.")
    return said


def predictive_sentence(repeated: dict, own: dict) -> str:
    """How far the normal force is off, in both senses of a predictive mean."""
    return (
        f"The predictive mean of the normal force has an error of {repeated['fz']:.3f} N on average for a press repeated, "
        f"by {own['fz']:.3f} N at these very presses, each with its own errors of touch and emulator."
    )


def _trades(correlation: dict) -> list[str]:
    names = correlation["names"]
    row = correlation["matrix"][names.index("c10")]
    strong = [(n, r) for n, r in zip(names, row, strict=True) if n != "c10" and abs(r) > 0.5]
    strong.sort(key=lambda pair: -abs(pair[1]))
    said = []
    for name, r in strong:
        hint = "press other indenters" if name.startswith("scale of ") else "measure that one separately"
        what = label_of(name).split(" (")[0]
        said.append(f"C10 trades against the {what} (correlation {r:+.2f}): {hint} to narrow C10.")
    return said


def _unseen(parameters: dict) -> list[str]:
    # Data never see the emulator's scale, which is there to widen C10; and a tare that stays as its prior is good news.
    expected = ("discretisation", *TARE)
    blind = [n for n in NAMES if n in parameters and n not in expected and parameters[n]["width_over_prior"] > 0.8]
    if not blind:
        return []
    names = ", ".join(label_of(n).split(" (")[0] for n in blind)
    return [f"About {names} the data say almost nothing: the posterior is the prior."]
