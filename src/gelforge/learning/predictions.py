"""Predictions of a model on a dataset, as a reader makes them, and what is measured by them: errors, intervals, latency."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.labelling.grid import Grid
from gelforge.labelling.moment import Arms
from gelforge.learning.data import Data, Groups, press_keys
from gelforge.reading.frame import Learnt, image_frame
from gelforge.reading.interval import Errors, fit_intervals, half_widths
from gelforge.reading.model import ForceModel, require_sensor
from gelforge.reading.reader import Reader
from gelforge.records.samplefile import TRAINING

WARM_UP = 5  # runs that are not timed


@dataclass(frozen=True)
class Predicted:
    """Predictions for some rows: forces (n, 3, rows, cols) N, and half widths (n, 3) N of the totals' intervals.

    half_widths: None where the model has no intervals. moments: (n, 3) N mm, of the forces about the gel's apex. in_place: whether the cells coincide with those of the labels;
    False if a sensor's images were scaled or turned.
    """

    forces: np.ndarray
    half_widths: np.ndarray | None
    in_place: bool
    moments: np.ndarray


def predict_rows(model: ForceModel, data: Data, rows: np.ndarray) -> Predicted:
    """Predict some rows of a dataset, each with the no-contact image of its own sensor, tared as a reader does.

    The pictures of stage 60 are what a reader would prepare; only images of a sensor that the model turns, crops or scales
    are prepared anew.
    """
    rows = np.asarray(rows, int)
    names = data.names("sensor_id")[rows]
    forces = np.zeros((len(rows), 3, *model.metadata["grid"]), np.float32)
    in_place = True
    for name in np.unique(names).tolist():
        mine = np.flatnonzero(names == name)
        as_logged = sees_as_logged(model, data, name, int(rows[mine[0]]))
        in_place &= as_logged
        found = _stored(model, data, rows[mine]) if as_logged else _prepared(model, data, name, rows[mine])
        for at, cells in zip(mine.tolist(), found, strict=True):
            forces[at] = cells
    totals = forces.sum((2, 3), dtype=float)
    widths = [half_widths(model.metadata, total) for total in totals]
    known = bool(widths) and widths[0] is not None
    return Predicted(forces, np.array(widths) if known else None, in_place, moments_of(data, rows, forces))


def moments_of(data: Data, rows: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Moments about the gel's apex, (k, 3) N mm, of maps (k, 3, rows, cols) N of some rows of a dataset."""
    names, moments = data.names("sensor_id")[rows], np.zeros((len(rows), 3))
    for name in np.unique(names).tolist():
        arms = Arms(data.sensor(name), Grid(*forces.shape[2:]))
        for at in np.flatnonzero(names == name).tolist():
            moments[at] = arms.moment(forces[at], data.c10)
    return moments


def sees_as_logged(model: ForceModel, data: Data, name: str, row: int) -> bool:
    """Whether a model reads the images of a sensor as they were logged; row: one of that sensor."""
    if not model.needs_nocontact:
        return True
    data.require_nocontact([row])
    try:
        return image_frame(data.nocontact[name], model.size, Learnt.of(model.metadata["frame"]))[0].as_logged
    except BadInput as error:
        raise BadInput(f"sensor {name}: {error}") from None


def _stored(model: ForceModel, data: Data, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Forces (3, rows, cols) N of rows of one sensor, from the pictures of stage 60."""
    rest: dict[int, np.ndarray] = {}  # read in a no-contact image, by its row
    for row in rows.tolist():
        if not model.needs_nocontact:
            yield model.graph({"image": np.ascontiguousarray(data.images[[row]])})[0]
            continue
        at = int(data.beside[row])
        beside = data.rests[[at]]
        if at not in rest:
            rest = {at: model.graph({"image": beside, "nocontact": beside})[0]}
        yield model.graph({"image": data.pairs[[row]], "nocontact": beside})[0] - rest[at]


def _prepared(model: ForceModel, data: Data, name: str, rows: np.ndarray) -> Iterator[np.ndarray]:
    """Forces (3, rows, cols) N of rows of one sensor, from the images as they were logged."""
    reader = Reader(data.nocontact[name], model=model)
    for row in rows.tolist():
        yield reader(data.images[row]).cells


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
    require_sensor(model, *data.names("sensor_id").tolist())


def time_models(models: Mapping[str, ForceModel], image: np.ndarray, seconds: float) -> dict[str, dict]:
    """Latency of models' graphs on one image (h, w, 3) uint8, in ms: median, 10th and 90th percentile, runs.

    It also serves as the no-contact image; its content does not affect the time. The models take turns until each has run
    for `seconds`, so that a machine that slows down slows all of them alike. The first `WARM_UP` runs of each are not
    counted.
    """
    runs: dict[str, list[float]] = {name: [] for name in models}
    spent = dict.fromkeys(models, 0.0)
    given = dict.fromkeys(("image", "nocontact"), np.ascontiguousarray(image[None]))
    for one in models.values():
        for _ in range(WARM_UP):
            one.graph(given)
    while any(spent[name] < seconds for name in models):
        for name, one in models.items():
            if spent[name] < seconds:
                started = time.perf_counter()
                one.graph(given)
                runs[name].append(time.perf_counter() - started)
                spent[name] += runs[name][-1]
    return {name: summarise(1e3 * np.array(values)) for name, values in runs.items()}


def summarise(values) -> dict:
    """Median and spread of run times in ms."""
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return {"median_ms": float(middle), "p10_ms": float(low), "p90_ms": float(high), "runs": len(values)}


def intervals_of(
    model: ForceModel, data: Data, groups: Groups, start: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The part of a model's metadata on its 90 % prediction intervals.

    How they grow with force is fitted to the rows of `data` that chose the epoch, their size to those that calibrate. start:
    metadata of the network that it was fine-tuned from, whose widening on real sensors it keeps. Empty if the model's
    grid is not the dataset's; without intervals if there are too few presses.
    """
    if list(model.metadata["grid"]) != list(data.grid):
        return {}
    choose, size_on = groups.choose[groups.choose < len(data.table)], groups.calibrate
    found = fit_intervals(errors_of(model, data, choose), errors_of(model, data, size_on)) if len(size_on) else {}
    sensors = sorted(set(data.names("sensor_id")[size_on].tolist()))
    pressed = sorted(set(press_keys(data, np.union1d(choose, size_on)).tolist()))
    real = (start or {}).get("intervals", {}).get("real")
    if found and real:
        found |= {"real": real}
    return {"intervals": found | {"sensors": sensors, "data": data.name, "presses": pressed}}


def errors_of(model: ForceModel, data: Data, rows: np.ndarray) -> Errors:
    """Predicted totals of some rows, their errors and their presses."""
    total = predict_rows(model, data, rows).forces.sum((2, 3), dtype=float)
    return Errors(total, total - data.totals(rows), data.presses(rows))


def learnt_names(data: Data) -> list[str]:
    """Sensors of the training split, sorted."""
    return sorted(set(data.names("sensor_id")[data.splits[TRAINING]].tolist()))
