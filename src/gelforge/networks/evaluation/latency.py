"""How long one image takes, from pixels in memory to newtons in memory."""

import time
from collections.abc import Mapping

import numpy as np

from gelforge.networks.inference.predictor import Predictor

WARM_UP = 5


def time_predictors(predictors: Mapping[str, Predictor], image: np.ndarray, seconds: float) -> dict[str, dict]:
    """Latency of the graphs of several predictors on one image (h, w, 3) uint8, in ms: median, 10th and 90th percentile, runs.

    The predictors take turns until each has had `seconds`, so that a machine that slows down slows all of them; the first
    `WARM_UP` runs of each are not counted.
    """
    runs: dict[str, list[float]] = {name: [] for name in predictors}
    spent = dict.fromkeys(predictors, 0.0)
    seen = {name: one.prepare(image) for name, one in predictors.items()}
    for name, one in predictors.items():
        for _ in range(WARM_UP):
            one.raw(seen[name])
    while any(spent[name] < seconds for name in predictors):
        for name, one in predictors.items():
            if spent[name] < seconds:
                started = time.perf_counter()
                one.raw(seen[name])
                runs[name].append(time.perf_counter() - started)
                spent[name] += runs[name][-1]
    return {name: summarise(1e3 * np.array(values)) for name, values in runs.items()}


def summarise(values) -> dict:
    """Median and spread of run times in ms."""
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return {"median_ms": float(middle), "p10_ms": float(low), "p90_ms": float(high), "runs": len(values)}
