"""How well a model predicts a reading it was not given: leave-one-out, from pointwise likelihoods."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Score:
    """elpd: expected log pointwise predictive density (larger is better), sum over readings.

    pointwise: (r,). worst_k: largest Pareto shape; above 0.7 the estimate leans on few draws.
    """

    elpd: float
    pointwise: np.ndarray
    worst_k: float

    @property
    def reliable(self) -> bool:
        return self.worst_k <= 0.7


def fit_pareto(x: np.ndarray) -> tuple[float, float]:
    """Shape k and scale of a generalised Pareto distribution for exceedances x > 0, ascending.

    Zhang and Stephens (2009), Technometrics 51:316, with the weak prior on k of Vehtari et al.
    """
    n = len(x)
    m = 30 + int(np.sqrt(n))
    b = 1.0 - np.sqrt(m / (np.arange(1, m + 1) - 0.5))
    b = b / (3.0 * x[int(n / 4 + 0.5) - 1]) + 1.0 / x[-1]
    k = np.log1p(-b[:, None] * x).mean(axis=1)
    profile = n * (np.log(-b / k) - k - 1.0)
    weight = np.exp(profile - np.logaddexp.reduce(profile))
    best = float((b * weight).sum() / weight.sum())
    shape = float(np.log1p(-best * x).mean())
    scale = -shape / best
    return shape * n / (n + 10.0) + 0.5 * 10.0 / (n + 10.0), scale


def smooth_weights(log_ratio: np.ndarray) -> tuple[np.ndarray, float]:
    """Pareto-smoothed log importance weights (s,), normalised, and the shape k.

    Vehtari, Simpson, Gelman, Yao, Gabry (2024), JMLR 25(72), algorithm 1.
    """
    weights = log_ratio - log_ratio.max()
    tail = int(min(0.2 * len(weights), 3.0 * np.sqrt(len(weights))))
    order = np.argsort(weights)
    cut = weights[order[-tail - 1]]
    shape = -np.inf
    # a walker that stays gives the same draw again: where one equals the cut, the tail begins after it
    top = order[np.searchsorted(weights[order], cut, side="right") :]
    exceed = np.exp(weights[top]) - np.exp(cut)
    if len(top) >= 5 and exceed[-1] > exceed[0]:
        shape, scale = fit_pareto(exceed)
        p = (np.arange(1, len(top) + 1) - 0.5) / len(top)
        quantile = scale * np.expm1(-shape * np.log1p(-p)) / shape
        weights = weights.copy()
        weights[top] = np.minimum(np.log(np.exp(cut) + quantile), 0.0)
    weights -= np.logaddexp.reduce(weights)
    return weights, shape


def loo(pointwise: np.ndarray) -> Score:
    """PSIS-LOO from log-likelihoods (draws, readings).

    Vehtari, Gelman, Gabry (2017), Statistics and Computing 27:1413, equation 10.
    """
    terms, shapes = [], []
    for column in pointwise.T:
        weights, shape = smooth_weights(-column)
        terms.append(np.logaddexp.reduce(weights + column))
        shapes.append(shape)
    return Score(float(np.sum(terms)), np.array(terms), float(np.max(shapes)))


def loo_from_mixture(pointwise: np.ndarray) -> Score:
    """LOO from log-likelihoods (draws, readings) at draws of the posterior.LeaveOneOut mixture.

    Silva and Zanella (2024), JASA 119:2369, section 3. The weights are at most one, so no draw dominates.
    """
    log_weight = -pointwise - np.logaddexp.reduce(-pointwise, axis=1, keepdims=True)
    terms = np.logaddexp.reduce(log_weight + pointwise, axis=0) - np.logaddexp.reduce(log_weight, axis=0)
    return Score(float(terms.sum()), terms, -np.inf)


def difference(best: Score, other: Score) -> tuple[float, float]:
    """elpd of `other` minus that of `best`, and its standard error over readings (paired)."""
    d = other.pointwise - best.pointwise
    return float(d.sum()), float(np.sqrt(len(d)) * d.std(ddof=1)) if len(d) > 1 else float("inf")
