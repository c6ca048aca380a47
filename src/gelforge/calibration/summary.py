"""What a posterior says, in numbers and in sentences a person can act on."""

from dataclasses import asdict

import numpy as np

from gelforge.calibration import scores
from gelforge.calibration.parameters import NAMES, SOFT_BENCH, label_of

QUANTILES = {"interval68": (0.16, 0.84), "interval95": (0.025, 0.975)}
DRAWS = 4000  # draws for predictions and scores; Monte Carlo error far below the posterior's width
SEVERAL = 3.0  # times the usual stiffness: no gel of the kind is so soft or so hard
UNITS = {
    "kilogram-force": 9.80665,
    "pound-force": 4.44822,
    "gram-force": 9.80665e-3,
    "millinewtons": 1e-3,
    "kilonewtons": 1e3,
}
ALIKE = 1.5  # the factor within which a unit explains a stiffness
NEAR = 4.0  # differences of elpd below this are small (Sivula et al. 2020, arXiv:2008.10296, section 5)


def describe(draws) -> dict:
    """Median, 68 % and 95 % interval of draws (s,), as plain floats."""
    numbers = {name: [float(q) for q in np.quantile(draws, pair)] for name, pair in QUANTILES.items()}
    return {"median": float(np.median(draws)), **numbers}


def parameter_table(chain, model) -> dict:
    """Posterior of every parameter with its prior's 95 % interval and how far the data narrowed it."""
    values = model.values(chain.flat())
    coordinates = chain.flat()
    table = {}
    for column, (name, prior) in enumerate(model.free.items()):
        low, high = prior.quantile(np.array([0.16, 0.84]))
        width = np.diff(np.quantile(coordinates[:, column], [0.16, 0.84]))[0] / (high - low)
        table[name] = {
            **describe(values[name]),
            "label": label_of(name),
            "prior_kind": prior.kind,
            "prior_interval95": [float(v) for v in prior.value(prior.quantile(np.array([0.025, 0.975])))],
            "width_over_prior": float(width),
        }
    return table


def bench(parameters: dict, fixed: dict) -> dict[str, float]:
    """What the bench does to a path: medians of its parameters, or what they were held at; mm and mm/N."""
    return {
        name: float(parameters[name]["median"] if name in parameters else fixed[name])
        for name in ("offset", *SOFT_BENCH)
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

    Each press keeps its own error of touch, a latent variable of the model with deviation `scatter`, which the
    likelihood has integrated out. Given the reading of its normal force, which is thus used twice, the mean of that
    error follows from the linear slope; it is the same for normal errors and for Student's t.
    """
    coordinates = chain.flat(DRAWS)
    values = posterior.model.values(coordinates)
    forces, slopes, _ = posterior.emulator.forces(posterior.depth, values)
    scatter, noise = values["scatter"][:, None], values["noise"][:, None]
    slope = slopes[:, :, 2]
    residual = posterior.observed[:, 2] - forces[:, :, 2]
    error = scatter**2 * slope * residual / (noise**2 + (scatter * slope) ** 2)
    return (forces + slopes * error[:, :, None]).mean(axis=0)


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


def score_models(results) -> list[dict]:
    """Table of models, best first. results: list of (posterior, chain, score)."""
    entries = sorted(results, key=lambda entry: -entry[2].elpd)
    best = entries[0][2]
    table = []
    for posterior, chain, score in entries:
        mean, _ = predictions(chain, posterior)
        gap, error = scores.difference(best, score)
        table.append(
            {
                "model": posterior.model.name,
                "elpd": score.elpd,
                "behind": -gap,
                "behind_standard_error": error,
                "indistinguishable": bool(-gap <= max(NEAR, 2.0 * error)),
                "c10": describe(posterior.model.values(chain.flat())["c10"]),
                "predictive_mae_n": predictive_error(mean, posterior.observed),
                "own_touch_mae_n": predictive_error(own_forces(chain, posterior), posterior.observed),
                "diagnostics": asdict(chain.figures),
            }
        )
    return table


def sentences(parameters: dict, correlation: dict, models: list[dict], model_name: str) -> list[str]:
    """What the data say and what they cannot separate, in plain words."""
    c10 = parameters["c10"]
    low, high = c10["interval95"]
    said = [
        f"C10 is {c10['median']:.4f} MPa under {model_name}, between {low:.4f} and {high:.4f} with 95 % probability."
    ]
    return said + model_sentences(models) + _trades(correlation) + _unseen(parameters)


def units_sentence(c10: float, usual: float) -> list[str]:
    """What a median of C10, MPa, far from the usual one says of the log: forces are proportional to it."""
    ratio = c10 / usual
    if 1.0 / SEVERAL < ratio < SEVERAL:
        return []
    far = f"{ratio:.3g} times" if ratio > 1.0 else f"1/{1.0 / ratio:.3g} of"
    like = [name for name, factor in UNITS.items() if abs(np.log(ratio * factor)) < np.log(ALIKE)]
    said = f", as where they are logged in {like[0]}" if like else ""
    return [
        f"C10 is {far} the usual {usual:g} MPa: most likely forces are not in newtons{said}, or lengths not in mm; check the"
        " units of fz_n and dz_mm in the log before you use it."
    ]


def model_sentences(models: list[dict]) -> list[str]:
    """Which models predict equally well, what that leaves open, and which are ruled out."""
    alike = [m for m in models if m["indistinguishable"]]
    unlikely = [m["model"] for m in models if not m["indistinguishable"]]
    said = []
    if len(alike) > 1:
        medians = [m["c10"]["median"] for m in alike]
        said.append(
            f"The data cannot separate {len(alike)} of {len(models)} models "
            f"({', '.join(m['model'] for m in alike)}): their predictive scores differ by less than the comparison "
            f"can resolve, yet their medians of C10 run from "
            f"{min(medians):.4f} to {max(medians):.4f} MPa."
        )
    if unlikely:
        said.append(f"The data speak against {', '.join(unlikely)}.")
    return said


def predictive_sentence(repeated: dict, own: dict, least: float | None) -> str:
    """How far the normal force is off, in both senses of a predictive mean, and how near any parameters come."""
    text = (
        f"The predictive mean of the normal force has an error of {repeated['fz']:.3f} N on average for a press repeated, "
        f"by {own['fz']:.3f} N at these very presses, each with its own error of touch"
    )
    if least is not None:
        text += f"; without such errors no parameters of this model, priors aside, come nearer than {least:.3f} N"
    return text + "."


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
    # The emulator's scale is there to widen C10 and is never seen by data.
    blind = [
        n for n in NAMES if n in parameters and n != "discretisation" and parameters[n]["width_over_prior"] > 0.8
    ]
    if not blind:
        return []
    names = ", ".join(label_of(n).split(" (")[0] for n in blind)
    return [f"About {names} the data say almost nothing: the posterior is the prior."]
