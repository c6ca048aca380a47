"""Stage 80: errors of one trained network, in the paper's tables, against labels, controls and sensors."""

from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish, write_json
from gelforge.flow.layout import beside
from gelforge.flow.main import command, option
from gelforge.flow.params.slices import ForEvaluate, read_slice
from gelforge.flow.params.tables import EvaluateTable
from gelforge.networks import metrics
from gelforge.networks.contacts import contact_table
from gelforge.networks.errortables import tables
from gelforge.networks.use import tell_rows
from gelforge.records.axes import CHANNELS, FORCE_OF_CHANNEL
from gelforge.records.predictionfile import write_predictions
from gelforge.reporting.networkcharts import draw_predictions

VERSION = 8
# Where a dataset has them, total forces (samples.csv, gel frame: x short side) that did not come from
# the labels: the force sensor of the rig, and what a virtual rig knows and a real one cannot.
REFERENCES = {"sensor": "measured_{}", "truth": "true_{}"}


def reference_totals(data, kind: str) -> np.ndarray | None:
    """Total forces (n, 3) of a reference in the labels' channel order, NaN where a press has none.

    Without what fell outside the image, where the label knows it: a picture does not show it.
    """
    columns = [REFERENCES[kind].format(column) for column in FORCE_OF_CHANNEL]
    totals = np.stack([data.column(name) for name in columns], axis=1)
    outside = np.stack([data.column(f"outside_{name}") for name in FORCE_OF_CHANNEL], axis=1)
    totals = totals - np.nan_to_num(outside)
    return totals if np.isfinite(totals).all(1).any() else None


def another_of_each(press, rng) -> np.ndarray:
    """For each row of `press` (n,), a row of another press, each taken once; with one press only, any row."""
    _, number = np.unique(press, return_inverse=True)
    views = np.bincount(number)
    # rows of a press lie side by side in `order`: a roll by the most views leaves the press
    order = np.argsort(rng.permutation(len(views))[number], kind="stable")
    other = np.empty(len(order), int)
    other[order] = np.roll(order, views.max())
    return other


def controls(data, rows, predicted_totals, rng) -> dict:
    """Totals (k, 3) that know less than the network: a constant, another press's prediction, the image's mean."""
    train = data.splits["train"]
    totals = data.totals(train)
    return {
        "constant_guess": metrics.constant_guess(totals, len(rows)),
        "shuffled_images": predicted_totals[another_of_each(data.presses(rows), rng)],
        "linear_on_image_means": metrics.linear_on_means(
            metrics.image_means(data.images, train), totals, metrics.image_means(data.images, rows)
        ),
    }


def fitted_rows(trained, data, version: str) -> np.ndarray:
    """Rows that a network's intervals were set on; none of a dataset of another `version` (networks.data.data_version)."""
    from gelforge.networks.data import rows_to_judge_by

    own = trained.about.get("intervals", {}).get("version") == version
    return rows_to_judge_by(data) if own else np.zeros(0, int)


def as_told(data, rows, trained, fitted, settings: EvaluateTable, force_range, rng) -> dict:
    """Errors of what `predict` tells of a split: of totals, with the share that their intervals hold, cells and contacts.

    fitted: rows that the intervals were set on, where they hold by construction.
    """
    told = tell_rows(trained, data, rows)
    wanted, press = data.totals(rows), data.presses(rows)
    error = told.forces.sum((2, 3), dtype=np.float64) - wanted
    mapped = told.in_place and told.forces.shape[2:] == data.grid
    apart = ~np.isin(rows, fitted)
    counts = told.half_widths is not None and apart.any()
    held = (np.abs(error) <= told.half_widths)[apart].mean(axis=0) if counts else None
    return {
        "total": metrics.error_table(error, rng, settings.bootstrap, force_range, press),
        "per_indenter": metrics.by_group(error, data.names("indenter")[rows]),
        "held": None if held is None else dict(zip(CHANNELS, held.tolist(), strict=True)),
        "cell": metrics.cell_table(told.forces, data.labels[rows]) if mapped else None,
        "contacts": contact_table(data.labels[rows], told.forces) if mapped else {"n": 0},
    }


def evaluate_split(data, rows, predicted, settings: EvaluateTable, force_range, rng) -> dict:
    """All tables of one split; `predicted` is (k, 3, rows, cols) in N per cell."""
    wanted = data.totals(rows)
    totals = predicted.sum((2, 3), dtype=np.float64)
    error = totals - wanted
    press = data.presses(rows)
    against: dict[str, dict] = {}
    result = {
        "n": len(rows),
        "presses": len(np.unique(press)),
        "total": metrics.error_table(error, rng, settings.bootstrap, force_range, press),
        "cell": metrics.cell_table(predicted, data.labels[rows]) if predicted.shape[2:] == data.grid else None,
        "per_indenter": metrics.by_group(error, data.names("indenter")[rows]),
        "per_force": metrics.by_group(error, metrics.force_bins(wanted[:, 2], settings.force_edges)),
        "per_sensor": metrics.by_group(error, data.names("sensor_id")[rows]),
        "controls": {
            name: {axis: float(np.abs(guess - wanted).mean(0)[i]) for i, axis in enumerate(CHANNELS)}
            for name, guess in controls(data, rows, totals, rng).items()
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
                "network": metrics.error_table(mine, rng, settings.bootstrap, press=press[known]),
                "labels": metrics.error_table(labels, rng, settings.bootstrap, press=press[known]),
                "labels_over": metrics.slope(wanted[known], reference[rows][known]),
            }
    return result


def judged_splits(data, learnt: bool) -> dict[str, np.ndarray]:
    """Rows by split that a network is judged on: all but those it learnt from.

    learnt: whether it learnt from this dataset; of one that is too small to have other splits, it is judged on `train` too
    where it did not.
    """
    splits = {name: rows for name, rows in data.splits.items() if len(rows)}
    others = {name: rows for name, rows in splits.items() if name != "train"}
    if "train" in splits and others:
        return others
    if "train" in splits and not learnt:
        return splits
    lacks = "one other than `train`, which it learnt from; log more presses, or let MODEL=shipped read them"
    if "train" not in splits:
        lacks = "`train`, for the controls; leave some indenters and sensors seen"
    raise BadInput(f"{data.folder}: has splits {', '.join(splits) or 'none'}; an evaluation needs {lacks}")


def evaluate(data, trained, settings: EvaluateTable) -> tuple[dict, dict]:
    """Evaluate a model on every split of a dataset but the one it was fitted to (`judged_splits`).

    :param data: networks.data.Data. :param trained: networks.modelfile.Trained.
    Returns the figures, and per split its rows and predictions (k, 3, rows, cols) in N per cell. Figures are of the network
    alone; under "told" those of what `predict` makes of it, with light, tare and dots, where it reads pairs.
    """
    import torch

    from gelforge.networks.data import data_version
    from gelforge.networks.modelfile import require_fit
    from gelforge.networks.training import predict_rows

    require_fit(trained, data)
    torch.set_num_threads(settings.threads)
    version = data_version(data)
    splits = judged_splits(data, learnt=trained.about["data"]["version"] == version)
    rng = np.random.default_rng(settings.seed)
    train_totals = data.totals(data.splits["train"])
    force_range = train_totals.max(0) - train_totals.min(0)
    about = trained.about
    result = {
        "model": about["name"],
        "kind": about["model"]["kind"],
        "parameters": about["parameters"],
        "grid": list(data.grid),
        "dataset": about["data"],
        "judged_on": data.name,
        "best_epoch": about["best_epoch"],
        "force_range": dict(zip(CHANNELS, force_range.tolist())),
        "curve": about["curve"],
        "cost": about["cost"],
        "splits": {},
    }
    predictions, fitted = {}, fitted_rows(trained, data, version)
    for name, rows in splits.items():
        predictions[name] = (rows, predict_rows(trained.net, data, rows, about["normalisation"]))
        split = evaluate_split(data, *predictions[name], settings, force_range, rng)
        paired = trained.needs_untouched
        split["told"] = as_told(data, rows, trained, fitted, settings, force_range, rng) if paired else None
        result["splits"][name] = split
    result["tables"] = tables(result)
    return result, predictions


def keep_predictions(path, data, trained, predictions: dict) -> None:
    """Write what the network reads in every image, those it learnt from too, in the order of samples.csv.

    predictions: those already made, as `evaluate` returns them.
    """
    from gelforge.networks.training import predict_rows

    learnt = data.splits["train"]
    parts = list(predictions.values())
    if "train" not in predictions:
        parts.append((learnt, predict_rows(trained.net, data, learnt, trained.about["normalisation"])))
    forces = np.zeros((len(data.table), *parts[0][1].shape[1:]), np.float32)
    for rows, predicted in parts:
        forces[rows] = predicted
    write_predictions(path, data.names("sample_id"), forces)


def paper_table(result: dict) -> str:
    """The paper's table of one evaluation as text: total and per-cell MAE with deviation, N, per split."""
    lines = [f"{'split':22s} {'n':>5s}  " + "".join(f"{'total ' + a:>18s}{'cell ' + a:>20s}" for a in CHANNELS)]
    for name, split in result["splits"].items():
        line = f"{name:22s} {split['n']:5d}  "
        for axis in CHANNELS:
            total, cell = split["total"][axis], (split["cell"] or {}).get(axis)
            line += f"{total['mae']:8.3f} +- {total['std']:6.3f}"
            line += f"{cell['mae']:10.5f} +- {cell['std']:6.5f}" if cell else f"{'-':>20s}"
        lines.append(line)
    return "\n".join(lines)


@command(
    option("--dataset", type=Path, help="60_dataset/RES"),
    option("--model", type=Path, help="70_train/RES/MODEL.pt"),
    option("--params", type=Path),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    from gelforge.networks.data import open_data
    from gelforge.networks.modelfile import load_model

    data = open_data(args.dataset)
    trained = load_model(args.model)
    result, predictions = evaluate(data, trained, read_slice(args.params, ForEvaluate).evaluate)
    print(paper_table(result))
    with publish(beside(args.out, ".png")) as part:
        draw_predictions(part, data, predictions)
    keep_predictions(beside(args.out, ".predictions.npz"), data, trained, predictions)
    write_json(args.out, result)


if __name__ == "__main__":
    main.exit()
