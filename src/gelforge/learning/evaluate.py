"""Errors of a trained network on presses that it did not learn from, with those of baselines and reference forces."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.tables import EvaluateTable
from gelforge.learning.data import Data, press_keys
from gelforge.learning.predictions import Predicted, predict_rows, require_fit
from gelforge.reading.model import ForceModel, datasets_of
from gelforge.records.axes import CHANNELS, MOMENTS
from gelforge.records.press import FORCE, MOMENT, N_M
from gelforge.records.samplefile import TRAINING, UNSEEN_BOTH, UNSEEN_SENSOR

CONFIDENCE = 0.95
LEAST_CELL = 0.02  # fraction of the strongest cell's normal force below which a cell belongs to no contact
LEAST_FORCE = 0.5  # N; a patch of cells with less normal force is no contact
REACH = 2.0  # cells around a contact whose predicted force counts as the contact's


def bootstrap_mean(values, rng, resamplings: int, alike=None) -> tuple[np.ndarray, np.ndarray]:
    """95 % confidence interval of the mean of `values` (n, k): low and high, (k,) each.

    Percentile bootstrap (Efron 1979). alike: (n,) the group of each value, such as its press. Whole groups are drawn,
    because errors within one are correlated (cluster bootstrap, Davison and Hinkley 1997, section 3.8); None: each
    value is a group.
    """
    values = np.asarray(values, float)
    _, group = np.unique(np.arange(len(values)) if alike is None else alike, return_inverse=True)
    sizes = np.bincount(group)
    sums = np.stack([np.bincount(group, column) for column in values.T], axis=1)
    n = len(sizes)
    means = np.empty((resamplings, values.shape[1]))
    for i in range(resamplings):
        drawn = rng.integers(0, n, n)
        means[i] = sums[drawn].sum(0) / sizes[drawn].sum()
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
    return low, high


def error_table(error, rng, resamplings: int, force_range=None, alike=None, names=CHANNELS) -> dict:
    """Summarise signed errors (n, 3) in N per component of `names`: MAE, its deviation and interval, bias, root mean square.

    `force_range` (3,) N adds the MAE in percent of it (None for a range of 0); `alike` (n,) is as for
    `bootstrap_mean`.
    """
    size = np.abs(error)
    low, high = bootstrap_mean(size, rng, resamplings, alike)
    table: dict[str, dict[str, float | None]] = {}
    for i, axis in enumerate(names):
        table[axis] = {
            "mae": float(size[:, i].mean()),
            "std": float(size[:, i].std()),
            "mae_low": float(low[i]),
            "mae_high": float(high[i]),
            "bias": float(error[:, i].mean()),
            "rms": float(np.sqrt((error[:, i] ** 2).mean())),
        }
        if force_range is not None:
            fraction = 100 * size[:, i].mean() / force_range[i] if force_range[i] > 0 else None
            table[axis]["mae_percent_of_range"] = None if fraction is None else float(fraction)
    return table


def cell_table(predicted, labels) -> dict:
    """Absolute error per cell of maps (n, 3, rows, cols) in N: mean over cells and images, deviation over images."""
    per_image = np.abs(predicted - labels).mean((2, 3), dtype=np.float64)
    return {
        axis: {"mae": float(per_image[:, i].mean()), "std": float(per_image[:, i].std())}
        for i, axis in enumerate(CHANNELS)
    }


def by_group(error, groups) -> dict:
    """MAE and bias per component for each value of `groups` (n,), with the count."""
    result = {}
    for name in sorted(set(groups)):
        part = error[np.asarray(groups) == name]
        result[str(name)] = {"n": len(part)} | {
            axis: {"mae": float(np.abs(part[:, i]).mean()), "bias": float(part[:, i].mean())}
            for i, axis in enumerate(CHANNELS)
        }
    return result


def slope(values, reference) -> dict:
    """Slope per component of values (n, 3) N over a reference (n, 3) N: least squares through zero, or None."""
    squares = (np.asarray(reference) ** 2).sum(axis=0)
    factors = (np.asarray(values) * reference).sum(axis=0) / np.where(squares > 0, squares, np.nan)
    return {axis: float(factor) if np.isfinite(factor) else None for axis, factor in zip(CHANNELS, factors)}


def force_bins(normal_force, edges) -> list[str]:
    """Name of the bin of |f_z| of each press, `low-high N`, or `high+ N` from the last edge on.

    Presses below the first edge have a bin from 0.
    """
    edges = sorted({0.0, *edges})
    names = [f"{low:04.1f}-{high:04.1f} N" for low, high in zip(edges, edges[1:])] + [f"{edges[-1]:04.1f}+ N"]
    place = np.searchsorted(edges, np.abs(normal_force), side="right") - 1
    return [names[i] for i in place]


def constant_guess(train_totals, n: int) -> np.ndarray:
    """The best constant for the absolute error: the median total force of the training presses, (n, 3)."""
    return np.tile(np.median(train_totals, axis=0), (n, 1))


def linear_on_means(train_means, train_totals, means) -> np.ndarray:
    """Total force by least squares on the mean colour of an image, (n, 3); fitted to the training presses."""

    def design(x):
        return np.column_stack([x, np.ones(len(x))])

    weights, *_ = np.linalg.lstsq(design(train_means), train_totals, rcond=None)
    return design(means) @ weights


def image_means(images, rows) -> np.ndarray:
    """Mean colour (k, 3) of some rows of images (n, h, w, 3), one image at a time."""
    return np.stack([images[row].mean((0, 1)) for row in rows])


def contacts_of(label: np.ndarray) -> np.ndarray:
    """Number of the contact that each cell belongs to, (rows, cols) int, 0 for none; label: (3, rows, cols) N.

    Pressed cells that touch, also at corners, are one contact. It includes the cells within REACH that are nearer to
    it than to any other contact.
    """
    from scipy import ndimage

    pressed = -label[2]
    found, count = ndimage.label(pressed > LEAST_CELL * max(pressed.max(), 0.0), np.ones((3, 3)))
    force = ndimage.sum_labels(pressed, found, np.arange(1, count + 1)) if count else np.zeros(0)
    number = np.zeros(count + 1, int)
    strong = np.flatnonzero(force >= LEAST_FORCE) + 1
    number[strong] = np.arange(1, len(strong) + 1)
    contact = number[found]
    if not len(strong):
        return contact
    away, nearest = ndimage.distance_transform_edt(contact == 0, return_indices=True)
    return np.where(away <= REACH, contact[tuple(nearest)], 0)


def contact_forces(labels: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Normal force of each contact by label and by network, (m, 2) N, of presses with several contacts.

    labels, forces: (n, 3, rows, cols) N per cell, compression negative; the forces returned are positive.
    """
    from scipy import ndimage

    pairs = []
    for label, predicted in zip(labels, forces, strict=True):
        contact = contacts_of(label)
        count = int(contact.max(initial=0))
        if count > 1:
            which = np.arange(1, count + 1)
            pairs.append(
                np.stack([-ndimage.sum_labels(part[2], contact, which) for part in (label, predicted)], axis=1)
            )
    return np.concatenate(pairs) if pairs else np.zeros((0, 2))


def contact_table(labels: np.ndarray, forces: np.ndarray) -> dict:
    """Number `n` of contacts in presses with several; mean absolute error of their normal forces, N and percent."""
    pairs = contact_forces(labels, forces)
    if not len(pairs):
        return {"n": 0}
    off = np.abs(pairs[:, 1] - pairs[:, 0])
    return {"n": len(pairs), "mae": float(off.mean()), "percent": float(100 * (off / pairs[:, 0]).mean())}


# Total forces in samples.csv (gel frame: x short side) that do not come from the labels: those of the rig's force
# sensor, and the true ones, which only a virtual rig knows. A dataset may lack them.
REFERENCES = {"sensor": "measured_{}", "truth": "true_{}"}

# Fewest sensors for a bootstrap over sensors: with fewer, its interval means nothing.
FEWEST_DRAWN = 5


def reference_totals(data: Data, kind: str, columns: Sequence[str] = FORCE) -> np.ndarray | None:
    """Total forces (n, 3) N of a reference, or moments N m, NaN where a press has none; None if no press has one.

    columns: of the log, FORCE or MOMENT. What the label has outside the image, where known, is subtracted, because the
    image does not show it.
    """
    totals = np.stack([data.column(REFERENCES[kind].format(name)) for name in columns], axis=1)
    outside = np.stack([data.column(f"outside_{name}") for name in columns], axis=1)
    totals = totals - np.nan_to_num(outside)
    return totals if np.isfinite(totals).all(1).any() else None


def moment_table(error: np.ndarray, rng, resamplings: int, alike: np.ndarray) -> dict:
    """`error_table` of moments (n, 3) N mm about the gel's apex, of the rows that have them, with their number `n`."""
    known = np.isfinite(error).all(1)
    found = error_table(error[known], rng, resamplings, alike=alike[known], names=MOMENTS) if known.any() else {}
    return {"n": int(known.sum())} | found


def another_of_each(press: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """For each row of `press` (n,), a row of another press, drawn uniformly; None if all are of one press."""
    _, number, views = np.unique(press, return_inverse=True, return_counts=True)
    if len(views) < 2:
        return None
    # rows of a press are consecutive in `order`; draw among all rows but these
    order, first = np.argsort(number, kind="stable"), (np.cumsum(views) - views)[number]
    drawn = rng.integers(len(press) - views[number])
    return order[np.where(drawn < first, drawn, drawn + views[number])]


@dataclass(frozen=True)
class Lesson:
    """What baselines may use of the training presses: totals (n, 3) N and mean colours (n, 3) of their images."""

    totals: np.ndarray
    means: np.ndarray

    @classmethod
    def of(cls, data: Data) -> "Lesson":
        train = data.splits[TRAINING]
        return cls(data.totals(train), image_means(data.images, train))

    @property
    def force_range(self) -> np.ndarray:
        """Largest minus least total by component, (3,) N."""
        return self.totals.max(0) - self.totals.min(0)


def controls(
    data: Data, rows: np.ndarray, predicted_totals: np.ndarray, lesson: Lesson, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Totals (k, 3) of baselines: a constant, the prediction for another press, a linear fit to the mean colour.

    The prediction for another press is left out if all rows show one press.
    """
    other = another_of_each(data.presses(rows), rng)
    return {
        "constant_guess": constant_guess(lesson.totals, len(rows)),
        **({} if other is None else {"shuffled_images": predicted_totals[other]}),
        "linear_on_image_means": linear_on_means(lesson.means, lesson.totals, image_means(data.images, rows)),
    }


def known_rows(model: ForceModel, data: Data) -> np.ndarray:
    """Which rows of a dataset, (n,) bool, show presses that a model learnt from, in this dataset or another.

    Presses are identified one by one, so a dataset that has grown may hold both kinds.
    """
    pressed = {key for one in datasets_of(model.metadata) for key in one["pressed"]}
    if not pressed:
        return np.zeros(len(data.table), bool)
    return np.isin(press_keys(data, range(len(data.table))), sorted(pressed))


def learnt_sensors(model: ForceModel, data: Data) -> set[str]:
    """Sensors in the training split of a dataset whose presses, all or some of them, a model learnt from."""
    training = data.splits.get(TRAINING, np.zeros(0, int))
    seen = training[known_rows(model, data)[training]]
    return set(model.metadata["sensors"]) & set(data.names("sensor_id")[seen].tolist())


def what_errs_alike(data: Data, rows: np.ndarray, learnt: set[str]) -> np.ndarray:
    """Groups (k,) of some rows for the bootstrap of their mean error: sensors or presses.

    Sensors if the network learnt from none of them (`learnt_sensors`) and there are FEWEST_DRAWN or more, because
    then the differences between sensors matter; else presses. Model cards say so.
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
    """All tables of one split; predicted: for its rows, by `predict_rows`."""
    target, alike = data.totals(rows), what_errs_alike(data, rows, learnt_sensors(model, data))
    totals = predicted.forces.sum((2, 3), dtype=np.float64)
    error = totals - target
    mapped = predicted.in_place and predicted.forces.shape[2:] == data.grid
    against: dict[str, dict] = {}
    result = {
        "n": len(rows),
        "presses": len(np.unique(data.presses(rows))),
        "total": error_table(error, rng, settings.bootstrap, lesson.force_range, alike),
        "held": held(data, rows, predicted, error, model),
        "cell": cell_table(predicted.forces, data.labels[rows]) if mapped else None,
        "contacts": contact_table(data.labels[rows], predicted.forces) if mapped else {"n": 0},
        "per_indenter": by_group(error, data.names("indenter")[rows]),
        "per_force": by_group(error, force_bins(target[:, 2], settings.force_edges)),
        "per_sensor": by_group(error, data.names("sensor_id")[rows]),
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
        turning = reference_totals(data, kind, MOMENT)
        moments = np.full((len(rows), 3), np.nan) if turning is None else turning[rows] / N_M
        if known.any():
            mine, labels = totals[known] - reference[rows][known], target[known] - reference[rows][known]
            against[kind] = {
                "n": int(known.sum()),
                "network": error_table(mine, rng, settings.bootstrap, alike=alike[known]),
                "labels": error_table(labels, rng, settings.bootstrap, alike=alike[known]),
                "labels_over": slope(target[known], reference[rows][known]),
                "moment": {
                    "network": moment_table(predicted.moments - moments, rng, settings.bootstrap, alike),
                    "labels": moment_table(data.moments(rows) - moments, rng, settings.bootstrap, alike),
                },
            }
    result["moment"] = moment_table(predicted.moments - data.moments(rows), rng, settings.bootstrap, alike)
    return result


def held(
    data: Data, rows: np.ndarray, predicted: Predicted, error: np.ndarray, model: ForceModel
) -> dict[str, float] | None:
    """Coverage by channel of the intervals of totals, on presses that did not calibrate them.

    None if there are no intervals or no such presses.
    """
    set_on = model.metadata.get("intervals", {}).get("presses", [])
    # whole presses are left out: errors on images of one press by several sensors are correlated
    unseen = ~np.isin(press_keys(data, rows), set_on)
    if predicted.half_widths is None or not unseen.any():
        return None
    inside = (np.abs(error) <= predicted.half_widths)[unseen].mean(axis=0)
    return dict(zip(CHANNELS, inside.tolist(), strict=True))


def judged_splits(data: Data, learnt: bool) -> dict[str, np.ndarray]:
    """Rows by split that a network is evaluated on: all splits but `train`, on which the baselines are fitted.

    learnt: whether the network learnt from this dataset. If not, and the dataset is too small to have other splits,
    it is evaluated on `train`. Raises BadInput if there is no split to evaluate on, or no `train`.
    """
    splits = {name: rows for name, rows in data.splits.items() if len(rows)}
    others = {name: rows for name, rows in splits.items() if name != TRAINING}
    if TRAINING in splits and others:
        return others
    if TRAINING in splits and not learnt:
        return splits
    lacks = f"one other than `{TRAINING}`, which the network learnt from; log more presses, or evaluate MODEL=shipped"
    if TRAINING not in splits:
        lacks = f"`{TRAINING}`, for the baselines; leave some indenters and sensors seen"
    raise BadInput(f"{data.folder}: has splits {', '.join(splits) or 'none'}; an evaluation needs {lacks}")


def unlearnt(splits: dict[str, np.ndarray], known: np.ndarray) -> dict[str, np.ndarray]:
    """Rows by split without presses that a network, or the one that it began as, learnt from, known (n,) bool.

    All rows of unseen sensors stay, because these test the sensor, whoever else saw the press; so does `train` where it
    is evaluated for want of another split.
    """
    kept = (TRAINING, UNSEEN_SENSOR, UNSEEN_BOTH)
    return {name: rows if name in kept else rows[~known[rows]] for name, rows in splits.items()}


def evaluate(
    data: Data, model: ForceModel, settings: EvaluateTable, called: str = ""
) -> tuple[dict[str, Any], dict[str, tuple]]:
    """Evaluate a model, as `predict` uses it, on the splits of a dataset that `judged_splits` names.

    Returns the figures, and per split its rows and predictions (k, 3, rows, cols) in N per cell. called: as for
    `require_fit`.
    """
    require_fit(model, data, called)
    known = known_rows(model, data)
    splits = judged_splits(data, learnt=bool(learnt_sensors(model, data)))
    splits = {name: rows for name, rows in unlearnt(splits, known).items() if len(rows)}
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
        "knows": bool(known.any()),
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
