"""Errors of a trained network on a dataset it did not learn from: against labels, controls and sensors."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from gelforge.errors import BadInput
from gelforge.flow.params.tables import EvaluateTable
from gelforge.networks import metrics
from gelforge.networks.contacts import contact_table
from gelforge.networks.data import Data, data_version, rows_for_intervals
from gelforge.networks.errortables import tables
from gelforge.networks.modelfile import Trained, datasets_of, lessons_of, require_fit
from gelforge.networks.training import predict_rows
from gelforge.networks.use import tell_rows
from gelforge.records.axes import CHANNELS, FORCE_OF_CHANNEL
from gelforge.records.splits import TRAINING

# Where a dataset has them, total forces (samples.csv, gel frame: x short side) that did not come from
# the labels: the force sensor of the rig, and what a virtual rig knows and a real one cannot.
REFERENCES = {"sensor": "measured_{}", "truth": "true_{}"}

# Of fewer sensors than these, an interval that draws whole sensors says nothing.
FEWEST_DRAWN = 5


def reference_totals(data: Data, kind: str) -> np.ndarray | None:
    """Total forces (n, 3) of a reference in the labels' channel order, NaN where a press has none.

    Without what fell outside the image, where the label knows it: a picture does not show it.
    """
    columns = [REFERENCES[kind].format(column) for column in FORCE_OF_CHANNEL]
    totals = np.stack([data.column(name) for name in columns], axis=1)
    outside = np.stack([data.column(f"outside_{name}") for name in FORCE_OF_CHANNEL], axis=1)
    totals = totals - np.nan_to_num(outside)
    return totals if np.isfinite(totals).all(1).any() else None


def another_of_each(press: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """For each row of `press` (n,), a row of another press, drawn evenly; None where all are of one press."""
    _, number, views = np.unique(press, return_inverse=True, return_counts=True)
    if len(views) < 2:
        return None
    # rows of a press lie side by side in `order`; the draw counts the rows of all others
    order, first = np.argsort(number, kind="stable"), (np.cumsum(views) - views)[number]
    drawn = rng.integers(len(press) - views[number])
    return order[np.where(drawn < first, drawn, drawn + views[number])]


@dataclass(frozen=True)
class Lesson:
    """What a guess may know of the presses that train: their totals (n, 3) N, and the mean colours (n, 3) of their pictures."""

    totals: np.ndarray
    means: np.ndarray

    @classmethod
    def of(cls, data: Data) -> "Lesson":
        train = data.splits[TRAINING]
        return cls(data.totals(train), metrics.image_means(data.images, train))

    @property
    def force_range(self) -> np.ndarray:
        """From the least to the largest total by component, (3,) N."""
        return self.totals.max(0) - self.totals.min(0)


def controls(
    data: Data, rows: np.ndarray, predicted_totals: np.ndarray, lesson: Lesson, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Totals (k, 3) that know less than the network: a constant, another press's prediction, the image's mean.

    Of rows that show one press alone there is no other's prediction.
    """
    other = another_of_each(data.presses(rows), rng)
    return {
        "constant_guess": metrics.constant_guess(lesson.totals, len(rows)),
        **({} if other is None else {"shuffled_images": predicted_totals[other]}),
        "linear_on_image_means": metrics.linear_on_means(
            lesson.means, lesson.totals, metrics.image_means(data.images, rows)
        ),
    }


def fitted_rows(trained: Trained, data: Data, version: str) -> np.ndarray:
    """Rows that a network's intervals were set on; none of a dataset of another `version` (networks.data.data_version)."""
    own = trained.about.get("intervals", {}).get("version") == version
    return rows_for_intervals(data) if own else np.zeros(0, int)


def learnt_sensors(trained: Trained, data: Data, version: str) -> set[str]:
    """Sensors of a dataset of this `version` (networks.data.data_version) whose presses a network learnt from.

    Empty where it learnt nothing from this dataset. Where it learnt from a part of it, they are the sensors of that part.
    """
    if version not in [one["version"] for one in lessons_of(trained.about)]:
        return set()
    training = data.names("sensor_id")[data.splits.get(TRAINING, np.zeros(0, int))]
    return set(trained.about["sensors"]) & set(training.tolist())


def what_errs_alike(data: Data, rows: np.ndarray, learnt: set[str]) -> np.ndarray:
    """What the interval of a mean error over some rows draws whole, (k,): their sensors or their presses.

    It is the sensor where the network learnt from none of them (`learnt_sensors`) and there are FEWEST_DRAWN or more: what
    matters then is how much sensors differ. Model cards say so.
    """
    sensors = data.names("sensor_id")[rows]
    seen = set(sensors.tolist())
    return data.presses(rows) if seen & learnt or len(seen) < FEWEST_DRAWN else sensors


def as_predicted(data, rows, trained, fitted, alike, settings: EvaluateTable, force_range, rng) -> dict:
    """Errors of what `predict` tells of a split: of totals, with the share that their intervals hold, cells and contacts.

    fitted: rows that the intervals were set on; of their presses the intervals hold by construction. alike: (k,) of
    `what_errs_alike`.
    """
    told = tell_rows(trained, data, rows)
    wanted, press = data.totals(rows), data.presses(rows)
    error = told.forces.sum((2, 3), dtype=np.float64) - wanted
    mapped = told.in_place and told.forces.shape[2:] == data.grid
    apart = ~np.isin(press, data.presses(fitted))  # another sensor's picture of a press errs as its own does
    counts = told.half_widths is not None and apart.any()
    held = (np.abs(error) <= told.half_widths)[apart].mean(axis=0) if counts else None
    return {
        "total": metrics.error_table(error, rng, settings.bootstrap, force_range, alike),
        "per_indenter": metrics.by_group(error, data.names("indenter")[rows]),
        "held": None if held is None else dict(zip(CHANNELS, held.tolist(), strict=True)),
        "cell": metrics.cell_table(told.forces, data.labels[rows]) if mapped else None,
        "contacts": contact_table(data.labels[rows], told.forces) if mapped else {"n": 0},
    }


def evaluate_split(data, rows, predicted, alike, settings: EvaluateTable, lesson: Lesson, rng) -> dict:
    """All tables of one split; `predicted` is (k, 3, rows, cols) in N per cell, `alike` (k,) of `what_errs_alike`."""
    wanted = data.totals(rows)
    totals = predicted.sum((2, 3), dtype=np.float64)
    error = totals - wanted
    against: dict[str, dict] = {}
    result = {
        "n": len(rows),
        "presses": len(np.unique(data.presses(rows))),
        "total": metrics.error_table(error, rng, settings.bootstrap, lesson.force_range, alike),
        "cell": metrics.cell_table(predicted, data.labels[rows]) if predicted.shape[2:] == data.grid else None,
        "per_indenter": metrics.by_group(error, data.names("indenter")[rows]),
        "per_force": metrics.by_group(error, metrics.force_bins(wanted[:, 2], settings.force_edges)),
        "per_sensor": metrics.by_group(error, data.names("sensor_id")[rows]),
        "controls": {
            name: {axis: float(np.abs(guess - wanted).mean(0)[i]) for i, axis in enumerate(CHANNELS)}
            for name, guess in controls(data, rows, totals, lesson, rng).items()
        },
        "against": against,
    }
    for kind in REFERENCES:
        reference = reference_totals(data, kind)
        if reference is None:
            continue
        known = np.isfinite(reference[rows]).all(1)
        if known.any():
            mine, labels = totals[known] - reference[rows][known], wanted[known] - reference[rows][known]
            against[kind] = {
                "n": int(known.sum()),
                "network": metrics.error_table(mine, rng, settings.bootstrap, alike=alike[known]),
                "labels": metrics.error_table(labels, rng, settings.bootstrap, alike=alike[known]),
                "labels_over": metrics.slope(wanted[known], reference[rows][known]),
            }
    return result


def judged_splits(data: Data, learnt: bool) -> dict[str, np.ndarray]:
    """Rows by split that a network is judged on: all but `train`, on which the controls are fitted.

    learnt: whether it learnt from this dataset. One that did not is judged on `train` where the dataset is too small to
    have other splits.
    """
    splits = {name: rows for name, rows in data.splits.items() if len(rows)}
    others = {name: rows for name, rows in splits.items() if name != TRAINING}
    if TRAINING in splits and others:
        return others
    if TRAINING in splits and not learnt:
        return splits
    lacks = f"one other than `{TRAINING}`, which it learnt from; log more presses, or let MODEL=shipped read them"
    if TRAINING not in splits:
        lacks = f"`{TRAINING}`, for the controls; leave some indenters and sensors seen"
    raise BadInput(f"{data.folder}: has splits {', '.join(splits) or 'none'}; an evaluation needs {lacks}")


def evaluate(
    data: Data, trained: Trained, settings: EvaluateTable, called: str = ""
) -> tuple[dict[str, Any], dict[str, tuple]]:
    """Evaluate a model on every split of a dataset but the one it was fitted to (`judged_splits`).

    Returns the figures, and per split its rows and predictions (k, 3, rows, cols) in N per cell. Figures are of the network
    alone; under "told" those of what `predict` makes of it, with light, tare and dots, where it reads pairs. called: of
    `require_fit`.
    """
    require_fit(trained, data, called)
    torch.set_num_threads(settings.threads)
    version = data_version(data)
    learnt = learnt_sensors(trained, data, version)
    splits = judged_splits(data, learnt=bool(learnt))
    rng = np.random.default_rng(settings.seed)
    lesson = Lesson.of(data)
    about = trained.about
    result = {
        "model": about["name"],
        "kind": about["model"]["kind"],
        "parameters": about["parameters"],
        "grid": list(data.grid),
        "dataset": next((one for one in lessons_of(about) if one["version"] == version), about["data"]),
        "lessons": {one["name"]: one["samples"].get(TRAINING, 0) for one in datasets_of(about)},
        "knows": version in [one["version"] for one in datasets_of(about)],
        "judged_on": data.name,
        "best_epoch": about["best_epoch"],
        "force_range": dict(zip(CHANNELS, lesson.force_range.tolist())),
        "curve": about["curve"],
        "cost": about["cost"],
        "splits": {},
    }
    predictions, fitted = {}, fitted_rows(trained, data, version)
    for name, rows in splits.items():
        predictions[name] = (rows, predict_rows(trained.net, data, rows, about["normalisation"]))
        alike = what_errs_alike(data, rows, learnt)
        split = evaluate_split(data, *predictions[name], alike, settings, lesson, rng)
        paired = trained.needs_untouched
        split["told"] = (
            as_predicted(data, rows, trained, fitted, alike, settings, lesson.force_range, rng) if paired else None
        )
        result["splits"][name] = split
    result["tables"] = tables(result)
    return result, predictions
