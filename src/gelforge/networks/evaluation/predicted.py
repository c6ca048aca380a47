"""What `predict` gives for the rows of a dataset, and how long one image takes, from pixels in memory to newtons in memory."""

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.data.arrays import Data
from gelforge.reading.model import ForceModel, require_sensor
from gelforge.reading.predictor import Predictor

WARM_UP = 5  # runs that are not timed


@dataclass(frozen=True)
class Predicted:
    """What `predict` gives for some rows: forces (n, 3, rows, cols) N and half widths (n, 3) N of the totals' intervals.

    half_widths: None where the model knows none. in_place: whether all cells are those of the labels; False where a sensor's
    pictures were scaled or turned, because then its cells show other places.
    """

    forces: np.ndarray
    half_widths: np.ndarray | None
    in_place: bool


def predict_rows(model: ForceModel, data: Data, rows: np.ndarray) -> Predicted:
    """Predict some rows of a dataset, each beside the no-contact image of its own sensor."""
    names = data.names("sensor_id")[rows].tolist()
    # One row of each sensor is enough to find its picture.
    first = dict(zip(names, rows, strict=True))
    beside = {name: _predictor(model, data, name, row) for name, row in first.items()}
    forces = np.zeros((len(rows), 3, *model.metadata["grid"]), np.float32)
    widths = np.zeros((len(rows), 3))
    known = len(rows) > 0
    for k, (row, name) in enumerate(zip(rows, names, strict=True)):
        found = beside[name].predict(np.ascontiguousarray(data.images[row]))
        forces[k] = found.cells
        known = known and found.half_width is not None
        widths[k] = found.half_width if known else 0.0
    return Predicted(forces, widths if known else None, all(one.prepare.frame.as_logged for one in beside.values()))


def _predictor(model: ForceModel, data: Data, name: str, row: int) -> Predictor:
    try:
        return Predictor(model, data.nocontact_of([row])[0] if model.needs_nocontact else None)
    except BadInput as error:
        raise BadInput(f"sensor {name}: {error}") from None


def require_fit(model: ForceModel, data: Data, called: str = "") -> None:
    """Raise BadInput if a model cannot be used on a dataset: other grid, image size or sensor.

    called: what people call it, where that is not the name that it was trained under.
    """
    metadata = model.metadata
    called = called or f"model {metadata['name']}"
    (high, wide), (height, width) = metadata["image"], data.image_size
    if (high, wide) != (height, width):
        raise BadInput(
            f"{called} reads images of {wide} x {high}, the dataset has {width} x {height}: use a model trained on this size"
        )
    (rows, cols), (of_rows, of_cols) = metadata["grid"], data.grid
    if (of_rows, of_cols) not in ((rows, cols), (1, 1)):  # totals are compared with the sum of the map
        raise BadInput(
            f"{called} writes a grid of {rows}x{cols}, the dataset has {of_rows}x{of_cols}: evaluate it on the dataset of its"
            " own RES"
        )
    require_sensor(model, set(data.names("sensor_id").tolist()))


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
