"""Predictions of a model on a dataset, and what they set: limits of usual images, intervals and latency."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.learning.data import Data, calibration_rows, press_keys, split_validation
from gelforge.reading.faults import nocontact_limits, pair_limits, pair_signs, wider
from gelforge.reading.frame import Learnt, learnt_from
from gelforge.reading.interval import Errors, fit_intervals
from gelforge.reading.model import ForceModel, require_sensor
from gelforge.reading.predictor import Predictor
from gelforge.records.networkkind import kind_of
from gelforge.records.samplefile import TRAINING, VALIDATION

WARM_UP = 5  # runs that are not timed


@dataclass(frozen=True)
class Predicted:
    """Predictions for some rows: forces (n, 3, rows, cols) N, and half widths (n, 3) N of the totals' intervals.

    half_widths: None where the model has no intervals. in_place: whether the cells coincide with those of the labels;
    False if a sensor's images were scaled or turned.
    """

    forces: np.ndarray
    half_widths: np.ndarray | None
    in_place: bool


def predict_rows(model: ForceModel, data: Data, rows: np.ndarray) -> Predicted:
    """Predict some rows of a dataset, each with the no-contact image of its own sensor."""
    names = data.names("sensor_id")[rows].tolist()
    # one row of each sensor, to look up its no-contact image
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

    called: name of the model in messages; empty for the one that it was trained under.
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
    """Latency of predictors' graphs on one image (h, w, 3) uint8, in ms: median, 10th and 90th percentile, runs.

    The predictors take turns until each has run for `seconds`, so that a machine that slows down slows all of them
    alike. The first `WARM_UP` runs of each are not counted.
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


ENOUGH_PAIRS = 200  # images that suffice to set the limits of good pairs


def unaltered(data: Data) -> Data:
    """A dataset without the images that a virtual rig altered, which do not show what is usual.

    BadInput if none is left to train on or to validate with.
    """
    left = {name: data.unaltered(rows) for name, rows in data.splits.items()}
    if not len(left[TRAINING]) or not len(left[VALIDATION]):
        raise BadInput(
            f"{data.folder}: the virtual rig altered light or markers in all images of the training or validation split, so"
            " none of them shows usual conditions: lower relit_fraction and worn_fraction of the plan's units"
        )
    return replace(data, splits=left)


def set_limits(metadata: dict[str, Any], learnt: Data, before: dict[str, Any] | None) -> dict[str, Any]:
    """The part of a model's metadata on usual images: `limits`, and `frame`, its cameras' view of the gel.

    learnt: all that it learnt from. Altered images set no limits: these would be so wide that a contact in a
    no-contact image would pass. before: metadata of the network that it is fine-tuned from, whose limits are widened
    if new images are few.
    """
    data = unaltered(learnt)
    if not kind_of(metadata["model"]).pair:
        return {"limits": {}}
    limits = good_pairs(data, usual_rows(data))
    if before is not None and len(data.splits[TRAINING]) < ENOUGH_PAIRS:
        limits = wider(before["limits"], limits)
    return {"limits": limits, "frame": frame_of(learnt, before).table()}


def usual_rows(data: Data) -> np.ndarray:
    """Rows that set the limits of good pairs: those of validation, and if these are few, evenly spaced training rows.

    Training rows serve as well, because limits depend on the images and not on the network.
    """
    rows, trained = data.splits[VALIDATION], data.splits[TRAINING]
    picked = np.linspace(0, len(trained) - 1, min(max(ENOUGH_PAIRS - len(rows), 0), len(trained))).astype(int)
    return np.concatenate([rows, trained[picked]])


def good_pairs(data: Data, rows: np.ndarray) -> dict[str, float]:
    """Limits of `reading.faults` from the pairs of some rows and their no-contact images."""
    pairs = [data.prepared(int(row), np.ascontiguousarray(data.images[row])) for row in rows]
    sensors = [data.sensor(name) for name in sorted(set(data.names("sensor_id")[rows].tolist()))]
    return pair_limits([found for one in pairs if (found := pair_signs(one))]) | nocontact_limits(sensors)


def frame_of(data: Data, before: dict[str, Any] | None) -> Learnt:
    """How the cameras of the training rows show the gel, together with those that `before` knew."""
    names = sorted(set(data.names("sensor_id")[data.splits[TRAINING]].tolist()))
    return learnt_from(
        (data.nocontact[name] for name in names), None if before is None else Learnt.of(before["frame"])
    )


def set_intervals(model: ForceModel, data: Data) -> dict[str, Any]:
    """The part of a model's metadata on its 90 % prediction intervals.

    How they grow with force is fitted to the selecting rows of validation, their size to `calibration_rows`. Empty if
    the model's grid is not the dataset's; without intervals if there are too few presses.
    """
    if list(model.metadata["grid"]) != list(data.grid):
        return {}
    scale_on, size_on = split_validation(data)[0], calibration_rows(data)
    found = fit_intervals(errors_of(model, data, scale_on), errors_of(model, data, size_on)) if len(size_on) else {}
    sensors = sorted(set(data.names("sensor_id")[size_on].tolist()))
    pressed = sorted(set(press_keys(data, np.union1d(scale_on, size_on)).tolist()))
    return {"intervals": found | {"sensors": sensors, "data": data.name, "presses": pressed}}


def errors_of(model: ForceModel, data: Data, rows: np.ndarray) -> Errors:
    """Predicted totals of some rows, their errors and their presses."""
    total = predict_rows(model, data, rows).forces.sum((2, 3), dtype=float)
    return Errors(total, total - data.totals(rows), data.presses(rows))
