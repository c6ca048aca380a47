"""Errors of a trained network on a dataset it did not learn from: against labels, controls and sensors."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.params.tables import EvaluateTable
from gelforge.networks.data.arrays import Data, press_keys
from gelforge.networks.evaluation import metrics
from gelforge.networks.evaluation.metrics import contact_table
from gelforge.networks.evaluation.predicted import Predicted, predict_rows, require_fit
from gelforge.reading.model import ForceModel, datasets_of
from gelforge.records.axes import CHANNELS
from gelforge.records.press import FORCE
from gelforge.records.samplefile import TRAINING

# Where a dataset has them, total forces (samples.csv, gel frame: x short side) that did not come from
# the labels: the force sensor of the rig, and what a virtual rig knows and a real one cannot.
REFERENCES = {"sensor": "measured_{}", "truth": "true_{}"}

# Of fewer sensors than these, an interval that draws whole sensors says nothing.
FEWEST_DRAWN = 5


def reference_totals(data: Data, kind: str) -> np.ndarray | None:
    """Total forces (n, 3) N of a reference, NaN where a press has none.

    Without what fell outside the image, where the label knows it: a picture does not show it.
    """
    columns = [REFERENCES[kind].format(column) for column in FORCE]
    totals = np.stack([data.column(name) for name in columns], axis=1)
    outside = np.stack([data.column(f"outside_{name}") for name in FORCE], axis=1)
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


def known_rows(model: ForceModel, data: Data) -> np.ndarray:
    """Which rows of a dataset (n,) bool show presses that a model learnt from, in whatever dataset these were.

    Each press is identified by itself, so a dataset that has grown holds both.
    """
    pressed = {key for one in datasets_of(model.metadata) for key in one["pressed"]}
    if not pressed:
        return np.zeros(len(data.table), bool)
    return np.isin(press_keys(data, range(len(data.table))), sorted(pressed))


def learnt_sensors(model: ForceModel, data: Data) -> set[str]:
    """Sensors of a dataset whose presses a model learnt from; of a part of it, those of that part."""
    training = data.splits.get(TRAINING, np.zeros(0, int))
    seen = training[known_rows(model, data)[training]]
    return set(model.metadata["sensors"]) & set(data.names("sensor_id")[seen].tolist())


def what_errs_alike(data: Data, rows: np.ndarray, learnt: set[str]) -> np.ndarray:
    """What the interval of a mean error over some rows draws whole, (k,): their sensors or their presses.

    It is the sensor where the network learnt from none of them (`learnt_sensors`) and there are FEWEST_DRAWN or more: what
    matters then is how much sensors differ. Model cards say so.
    """
    sensors = data.names("sensor_id")[rows]
    seen = set(sensors.tolist())
    return data.presses(rows) if seen & learnt or len(seen) < FEWEST_DRAWN else sensors


def evaluate_split(
    data: Data,
    rows: np.ndarray,
    predicted: Predicted,
    model: ForceModel,
    settings: EvaluateTable,
    lesson: Lesson,
    rng,
) -> dict[str, Any]:
    """All tables of one split, of what `predict` gives for its rows."""
    target, alike = data.totals(rows), what_errs_alike(data, rows, learnt_sensors(model, data))
    totals = predicted.forces.sum((2, 3), dtype=np.float64)
    error = totals - target
    mapped = predicted.in_place and predicted.forces.shape[2:] == data.grid
    against: dict[str, dict] = {}
    result = {
        "n": len(rows),
        "presses": len(np.unique(data.presses(rows))),
        "total": metrics.error_table(error, rng, settings.bootstrap, lesson.force_range, alike),
        "held": held(data, rows, predicted, error, model),
        "cell": metrics.cell_table(predicted.forces, data.labels[rows]) if mapped else None,
        "contacts": contact_table(data.labels[rows], predicted.forces) if mapped else {"n": 0},
        "per_indenter": metrics.by_group(error, data.names("indenter")[rows]),
        "per_force": metrics.by_group(error, metrics.force_bins(target[:, 2], settings.force_edges)),
        "per_sensor": metrics.by_group(error, data.names("sensor_id")[rows]),
        "controls": {
            name: {axis: float(np.abs(guess - target).mean(0)[i]) for i, axis in enumerate(CHANNELS)}
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
            mine, labels = totals[known] - reference[rows][known], target[known] - reference[rows][known]
            against[kind] = {
                "n": int(known.sum()),
                "network": metrics.error_table(mine, rng, settings.bootstrap, alike=alike[known]),
                "labels": metrics.error_table(labels, rng, settings.bootstrap, alike=alike[known]),
                "labels_over": metrics.slope(target[known], reference[rows][known]),
            }
    return result


def held(
    data: Data, rows: np.ndarray, predicted: Predicted, error: np.ndarray, model: ForceModel
) -> dict[str, float] | None:
    """Fraction of totals by channel that their intervals hold, of presses that these were not set on; None where none are left."""
    set_on = model.metadata.get("intervals", {}).get("presses", [])
    unseen = ~np.isin(press_keys(data, rows), set_on)  # another sensor's picture of a press errs as its own does
    if predicted.half_widths is None or not unseen.any():
        return None
    inside = (np.abs(error) <= predicted.half_widths)[unseen].mean(axis=0)
    return dict(zip(CHANNELS, inside.tolist(), strict=True))


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
    data: Data, model: ForceModel, settings: EvaluateTable, called: str = ""
) -> tuple[dict[str, Any], dict[str, tuple]]:
    """Evaluate a model, as `predict` uses it, on every split of a dataset but the one it was fitted to (`judged_splits`).

    Returns the figures, and per split its rows and predictions (k, 3, rows, cols) in N per cell. called: of `require_fit`.
    """
    require_fit(model, data, called)
    splits = judged_splits(data, learnt=bool(learnt_sensors(model, data)))
    rng = np.random.default_rng(settings.seed)
    lesson = Lesson.of(data)
    metadata = model.metadata
    lessons = datasets_of(metadata)
    result = {
        "model": metadata["name"],
        "kind": metadata["model"]["kind"],
        "parameters": metadata["parameters"],
        "grid": list(data.grid),
        "dataset": next((one for one in lessons if one["name"] == data.name), metadata["data"]) | {"pressed": None},
        "lessons": {one["name"]: one["samples"].get(TRAINING, 0) for one in lessons},
        "knows": bool(known_rows(model, data).any()),
        "judged_on": data.name,
        "fewest_drawn": FEWEST_DRAWN,
        "best_epoch": metadata["best_epoch"],
        "force_range": dict(zip(CHANNELS, lesson.force_range.tolist())),
        "curve": metadata["curve"],
        "cost": metadata["cost"],
        "splits": {},
    }
    predictions = {}
    for name, rows in splits.items():
        predicted = predict_rows(model, data, rows)
        predictions[name] = (rows, predicted.forces)
        result["splits"][name] = evaluate_split(data, rows, predicted, model, settings, lesson, rng)
    return result, predictions
