"""What was promised of the networks, measured.

Latency, memory, waiting, resuming and ONNX need no trained network and are measured on made-up presses.
Errors are read from a dataset's results; without them their figures are listed as not measured.
"""

import os
import subprocess
import sys
import tempfile
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, write_csv, write_json
from gelforge.flow.main import command, option
from gelforge.flow.params import load_params, plain, read_toml
from gelforge.flow.params.slices import ForTrain
from gelforge.flow.params.tables import TrainTable
from gelforge.records.axes import CHANNELS
from tests.benchmarks.figures import Figure, publish_figures

IMAGE, GRID = (240, 320), (24, 32)
BASELINE, LIGHT = "unet", "pair_24_mirrored"
PROBED = 24  # presses of the made-up dataset: three batches an epoch
# Per cent of the force range, from the paper: 0.80 N of 40 N in z, about 0.26 N of 10 N in x and y.
PERCENT_GOALS = {"grid_x": 2.0, "grid_y": 2.0, "grid_z": 1.5}


def write_made_up(folder: Path) -> Path:
    """A dataset of noise in the form of stage 60: enough for time and memory, nothing to learn."""
    rng = np.random.default_rng(0)
    folder.mkdir(parents=True)
    count = PROBED + 8
    np.save(folder / "images.npy", rng.integers(0, 256, (count, *IMAGE, 3), np.uint8))
    np.save(folder / "labels.npy", rng.normal(size=(count, 3, *GRID)).astype(np.float32))
    rows = [
        {"sample_id": f"p{i}", "indenter": "none", "sensor_id": "none", "split": "train" if i < PROBED else "val"}
        for i in range(count)
    ]
    write_csv(folder / "samples.csv", list(rows[0]), rows)
    write_json(folder / "normalisation.json", {})
    np.save(folder / "nocontact.npy", rng.integers(0, 256, (1, *IMAGE, 3), np.uint8))
    write_json(folder / "dataset.json", {"name": "made up", "grid": list(GRID), "nocontact": ["none"]})
    return folder


def load_workflow() -> tuple[dict, TrainTable]:
    """The model table and the [train] table of the working tree."""
    return read_toml("workflow/models.toml"), load_params("workflow").train


def speed_figures(models: dict, seconds: float) -> list[Figure]:
    """How much faster the light net is than the U-net, with one and two threads."""
    from gelforge.networks.latency import time_models

    readers = {name: untrained_reader(models[name]) for name in (BASELINE, LIGHT)}
    image = np.random.default_rng(0).integers(0, 256, (*IMAGE, 3), np.uint8)
    figures = []
    for threads in (1, 2):
        timed = time_models(readers, image, threads, seconds)
        ms = {name: timed[name]["median_ms"] for name in timed}
        spread = {name: f"{timed[name]['p10_ms']:.1f} to {timed[name]['p90_ms']:.1f}" for name in timed}
        figures.append(
            Figure(
                f"latency of the U-net over that of `{LIGHT}`, {threads} thread(s)",
                ms[BASELINE] / ms[LIGHT],
                ">=",
                5.0,
                "times",
                f"{ms[BASELINE]:.1f} ms ({spread[BASELINE]}) against {ms[LIGHT]:.1f} ms ({spread[LIGHT]}), batch 1",
            )
        )
    return figures


def untrained_reader(model: dict):
    """A network with fresh weights and unit scales, for timing."""
    from gelforge.networks.modelfile import SensorNet, Trained
    from gelforge.networks.models import build

    norm = dict.fromkeys(("image_mean", "image_std", "label"), [1.0, 1.0, 1.0]) | {
        "reads": model.get("reads", "image")
    }
    trained = Trained(build(model, IMAGE, GRID).eval(), {"normalisation": norm, "image": IMAGE})
    return SensorNet(trained, np.zeros((*IMAGE, 3), np.uint8))


def train_apart(dataset: Path, name: str, settings: TrainTable, folder: Path):
    """Train in a process of its own, so that its peak memory is its own; return the model."""
    from gelforge.networks.modelfile import load_model

    params = folder / f"{name}.json"
    write_json(params, plain(ForTrain(version=1, train=settings)))
    out = folder / f"{name}.pt"
    subprocess.run(
        [
            sys.executable,
            "-m",
            "gelforge.stages.train",
            "--dataset",
            dataset,
            "--model",
            name,
            "--params",
            params,
            "--out",
            out,
        ],
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    return load_model(out)


def training_figures(settings: TrainTable, folder: Path, dataset: Path) -> list[Figure]:
    """Peak memory, waiting for data and the ONNX form, for the U-net and the light net."""
    from gelforge.networks.onnxgraph import export, largest_difference

    images = np.load(dataset / "images.npy")[:2]
    figures = []
    for name, epochs in ((BASELINE, 1), (LIGHT, 6)):
        trained = train_apart(dataset, name, replace(settings, epochs=epochs), folder)
        cost = trained.about["cost"]
        figures.append(
            Figure(f"peak memory of training `{name}`, batch {settings.batch}", cost["peak_gib"], "<=", 4.0, "GiB")
        )
        figures.append(
            Figure(
                f"waiting for data, `{name}`",
                100 * cost["wait_seconds"] / cost["seconds"],
                "<=",
                10.0,
                "% of a step",
                f"{1e3 * cost['seconds'] / cost['steps']:.0f} ms a step",
            )
        )
        export(trained, folder / f"{name}.onnx")
        for engine, value in largest_difference(trained, folder / f"{name}.onnx", images).items():
            figures.append(Figure(f"ONNX of `{name}` in {engine} against torch", value, "<=", 1e-5, "of the range"))
    return figures


def resume_figure(models: dict, settings: TrainTable, folder: Path, dataset: Path) -> Figure:
    """Difference between the validation curves of a whole training and one that stopped and went on."""
    import torch

    from gelforge.networks.data import open_data, scales
    from gelforge.networks.training import Training, fit
    from gelforge.stages.train import resolve

    torch.set_num_threads(settings.threads)
    data = open_data(dataset)
    model, settings = resolve(models, LIGHT, replace(settings, epochs=4, checkpoint_seconds=0.0))
    norm = scales(data, False, model["reads"])
    whole, cut, rest = (Training(model, settings, norm, IMAGE, GRID, "cpu") for _ in range(3))
    fit(whole, data)
    fit(cut, data, folder / "cut.checkpoint.pt", "one", epochs=2)
    fit(rest, data, folder / "cut.checkpoint.pt", "one")
    worst = max(abs(a[key] - b[key]) for a, b in zip(whole.curve, rest.curve, strict=True) for key in a)
    return Figure(
        "validation curve, interrupted and resumed against whole",
        worst,
        "==",
        0.0,
        "N",
        f"{rest.cost['resumed']} resumption at epoch 2 of 4",
    )


def error_figures(results: Path, resolution: str) -> list[Figure]:
    """Errors of the chosen network against the U-net, the force range, unseen indenters and controls."""
    chart = read_json(results / "pareto_models" / f"{resolution}.json")
    by_name = {row["model"]: row for row in chart["models"]}
    chosen = chart["chosen"] or LIGHT
    if chosen not in by_name:
        raise BadInput(f"{results}: network {chosen!r} is not on the chart; make pareto-models CHARTED with it")
    note = f"network `{chosen}`"
    if not chart["chosen"]:
        note += ", none is so much faster and as good as the U-net everywhere"
    figures = []
    if BASELINE in by_name:
        row, base = by_name[chosen], by_name[BASELINE]
        for threads in (1, 2):
            key = f"cpu{threads}_median_ms"
            figures.append(
                Figure(
                    f"latency of the U-net over the chosen network's, {threads} thread(s)",
                    base[key] / row[key],
                    ">=",
                    5.0,
                    "times",
                    note,
                )
            )
        for key in [f"{what}_{axis}" for what in ("total", "cell") for axis in CHANNELS]:
            figures.append(
                Figure(f"error over the U-net's, {key.replace('_', ' ')}", row[key] / base[key], "<=", 1.0, "", note)
            )
    splits = read_json(results / "80_evaluate" / resolution / f"{chosen}.json")["splits"]
    return figures + split_figures(splits, note)


def split_figures(splits: dict, note: str) -> list[Figure]:
    """Errors on seen and unseen indenters, and against what knows less."""
    test, unseen = splits["test"], splits.get("test_unseen_indenter")
    figures = []
    for axis, goal in PERCENT_GOALS.items():
        seen = test["total"][axis]
        figures.append(
            Figure(f"total {axis}, seen indenters", seen["mae_percent_of_range"], "<=", goal, "% of range", note)
        )
        if unseen:
            figures.append(
                Figure(
                    f"total {axis}, unseen over seen indenters",
                    unseen["total"][axis]["mae"] / seen["mae"],
                    "<=",
                    1.5,
                    "",
                    note,
                )
            )
        for control, values in test["controls"].items():
            figures.append(
                Figure(
                    f"total {axis}, {control.replace('_', ' ')} over the network",
                    values[axis] / seen["mae"],
                    ">=",
                    3.0,
                    "times",
                    note,
                )
            )
    return figures


@command(
    option("--results", type=Path, default=Path("results") / os.environ.get("DATASET", "train")),
    option("--resolution", default=os.environ.get("RES", "24x32").split()[0]),
    option("--seconds", type=float, default=4.0, help="of timed runs per network and thread count"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    models, settings = load_workflow()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        dataset = write_made_up(folder / "dataset")
        figures = speed_figures(models, args.seconds)
        figures += training_figures(settings, folder, dataset)
        figures.append(resume_figure(models, settings, folder, dataset))
    if (args.results / "pareto_models" / f"{args.resolution}.json").exists():
        figures += error_figures(args.results, args.resolution)
    else:
        print(f"not measured: errors of trained networks; first make DATASET={args.results.name} pareto-models")
    publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
