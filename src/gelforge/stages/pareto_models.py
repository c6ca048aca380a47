"""Branch pareto-models: error of every trained network against its time per image.

Writes JSON and, beside it, the same values as CSV and as a chart.
"""

from argparse import Namespace

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import stage
from gelforge.flow.files import publish, read_json, write_csv, write_json
from gelforge.flow.layout import Layout, beside
from gelforge.records.axes import CHANNELS
from gelforge.records.samplefile import TEST
from gelforge.reporting.networkcharts import PANELS, draw_networks
from gelforge.sweeps.deviation import frontier

VERSION = 4
SECONDS = 3.0  # of timed runs per network and device
BASELINE = "unet"
FASTER = 5.0  # smallest ratio of the baseline's time to that of the chosen network, on one CPU thread


def row_of(evaluation: dict, latencies: dict[str, dict]) -> dict:
    """One network's row: errors on the test split, and latency per device (`cpu1`, `cpu2`, `cuda`).

    BadInput if there is no test split, or if all training presses have the same force.
    """
    if TEST not in evaluation["splits"]:
        raise BadInput(
            f"evaluation of {evaluation['model']}: has no split {TEST!r} but {', '.join(evaluation['splits'])}; the chart"
            " needs it, so raise [dataset] test"
        )
    errors = evaluation["splits"][TEST]
    row = {
        "model": evaluation["model"],
        "kind": evaluation["kind"],
        "parameters": evaluation["parameters"],
        "best_epoch": evaluation["best_epoch"],
        "epochs": len(evaluation["curve"]),
        "train_seconds": evaluation["cost"]["seconds"],
    }
    for axis in CHANNELS:
        row[f"total_{axis}"] = errors["total"][axis]["mae"]
        row[f"percent_{axis}"] = errors["total"][axis]["mae_percent_of_range"]
        row[f"cell_{axis}"] = errors["cell"][axis]["mae"] if errors["cell"] else None
    fractions = [row[f"percent_{axis}"] for axis in CHANNELS]
    if None in fractions:
        raise BadInput(
            f"{row['model']}: its training presses all have the same force, so errors are no fraction of a range"
        )
    row["percent"] = float(np.mean(fractions))
    for run, figures in latencies.items():
        row |= {f"{run}_{key}": value for key, value in figures.items()}
    return row


def choose(rows: list[dict]) -> dict | None:
    """The most accurate network `FASTER` times faster than the U-net and no worse on any component, total and per cell.

    None if the U-net is not among them or nothing else is as good.
    """
    base = next((row for row in rows if row["model"] == BASELINE), None)
    if base is None:
        return None
    keys = [f"{what}_{axis}" for what in ("total", "cell") for axis in CHANNELS]
    good = [
        row
        for row in rows
        if row["cell_fz"] is not None
        and FASTER * row["cpu1_median_ms"] <= base["cpu1_median_ms"]
        and all(row[key] <= base[key] for key in keys)
    ]
    return min(good, key=lambda row: row["percent"], default=None)


def measure(models: dict, image, seconds: float) -> dict[str, dict[str, dict]]:
    """Latency of models by name (reading.model.ForceModel), with one and two CPU threads, and on CUDA if present.

    image: (h, w, 3) uint8, also used as the no-contact image, whose content does not affect the time.
    """
    from gelforge.learning.predictions import time_models
    from gelforge.reading.model import on_device, onnxruntime

    runs = {"cpu1": ("cpu", 1), "cpu2": ("cpu", 2)}
    if "CUDAExecutionProvider" in onnxruntime().get_available_providers():
        runs["cuda"] = ("cuda", 1)
    timed = {
        run: time_models({name: on_device(model, *how) for name, model in models.items()}, image, seconds)
        for run, how in runs.items()
    }
    return {name: {run: timed[run][name] for run in runs} for name in models}


def fronts_of(rows: list[dict]) -> dict[str, set[str]]:
    """Names of the networks on the Pareto front of latency and error, for each error of the chart."""
    found = {}
    for key in PANELS:
        shown = [row for row in rows if row[key] is not None]
        best = frontier([(row["cpu1_median_ms"], row[key]) for row in shown])
        found[key] = {row["model"] for row, good in zip(shown, best) if good}
    return found


@stage(Layout.network_chart)
def main(args: Namespace) -> None:
    from gelforge.learning.data import open_data
    from gelforge.reading.model import load_model

    of, resolution = args.of, args.resolution
    names = read_json(of.parameters("networks"))
    evaluations = {name: read_json(of.evaluation(resolution, name)) for name in names}
    for name, found in evaluations.items():
        if "failed" in found:
            raise BadInput(f"{name}: {found['failed']}")
    models = {name: load_model(of.network(resolution, name)) for name in names}
    image = np.asarray(open_data(of.dataset(resolution)).images[0])
    latencies = measure(models, image, SECONDS)
    rows = [row_of(evaluations[name], latencies[name]) for name in sorted(models)]
    fronts = fronts_of(rows)
    for row in rows:
        row["front"] = row["model"] in fronts["percent"]
    chosen = (choose(rows) or {}).get("model")
    write_csv(beside(args.out, ".csv"), list(rows[0]), rows)
    with publish(beside(args.out, ".png")) as part:
        draw_networks(part, rows, fronts, TEST, chosen)
    write_json(args.out, {"split": TEST, "chosen": chosen, "baseline": BASELINE, "models": rows})
    for row in sorted(rows, key=lambda r: r["cpu1_median_ms"]):
        print(
            f"{row['model']:14s} {row['cpu1_median_ms']:8.2f} ms  {row['cpu2_median_ms']:8.2f} ms  "
            f"{row['percent']:6.2f} % {'front' if row['front'] else ''}{' chosen' if row['model'] == chosen else ''}"
        )


if __name__ == "__main__":
    main.exit()
