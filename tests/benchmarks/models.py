"""What was promised of the networks, measured.

Latency, memory, waiting, resuming and ONNX need no trained network and are measured on made-up presses.
Errors are read from a dataset's results; without them their figures are listed as not measured.
"""

import os
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, write_csv, write_json
from gelforge.flow.main import command, option
from gelforge.flow.params import load_params, plain, read_toml
from gelforge.flow.params.stages import ForTrain
from gelforge.flow.params.tables import TrainTable
from gelforge.records.axes import CHANNELS
from gelforge.records.image import read_image
from gelforge.records.log import read_presses
from tests.benchmarks.figures import Figure, publish_figures

if TYPE_CHECKING:
    from gelforge.networks.inference.predictor import Predictor

IMAGE, GRID = (240, 320), (24, 32)
BASELINE, LIGHT = "unet", "pair_24_mirrored"
SHIPS = "tuned"  # as the shipped network is built, which is deeper than LIGHT
PARTS = ("speed", "training", "resuming")
PROBED = 24  # presses of the made-up dataset: three batches an epoch
ABLATION = ("unet", "resnet34")
# The paper's shapes that its training never saw; all others that training does not see are of no catalogue.
PAPERS_UNSEEN = ("cuboid_12", "cylinder_8", "ellipse_15_10", "polygon_6_10", "triangle_11")
# Per cent of the force range: of the mean error, and of the upper end of its 95 % interval.
KNOWN_GOALS = {"grid_x": (0.4, 0.6), "grid_y": (0.4, 0.6), "grid_z": (1.0, 1.3)}
UNSEEN_UNIT_GOALS = {"grid_x": 1.0, "grid_y": 1.0, "grid_z": 1.8}
CELL_GOALS = {"grid_x": 0.0005, "grid_y": 0.0005, "grid_z": 0.0015}  # N, half of the paper's


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
    """How much faster the net that ships is than the U-net, with one and two threads."""
    from gelforge.networks.evaluation.predicted import time_predictors

    image = np.random.default_rng(0).integers(0, 256, (*IMAGE, 3), np.uint8)
    figures = []
    for threads in (1, 2):
        predictors = {name: untrained(models[name], threads) for name in (BASELINE, SHIPS)}
        timed = time_predictors(predictors, image, seconds)
        ms = {name: timed[name]["median_ms"] for name in timed}
        spread = {name: f"{timed[name]['p10_ms']:.1f} to {timed[name]['p90_ms']:.1f}" for name in timed}
        figures.append(
            Figure(f"one image through the U-net, {threads} thread(s)", ms[BASELINE], "", ms[BASELINE], "ms")
        )
        figures.append(
            Figure(
                f"latency of the U-net over that of `{SHIPS}`, {threads} thread(s)",
                ms[BASELINE] / ms[SHIPS],
                ">=",
                5.0,
                "times",
                f"{ms[BASELINE]:.1f} ms ({spread[BASELINE]}) against {ms[SHIPS]:.1f} ms ({spread[SHIPS]}), batch 1",
            )
        )
    return figures


def chain_figure(seconds: float) -> Figure:
    """All that `predict` does with a picture over its graph alone, on the demo's pairs, one thread.

    Both take turns, and the time of each is that which the fastest tenth of its runs stays below: longer runs are
    interrupted more often by other programs, which would count as theirs.
    """
    import cv2

    pairs = [(predictor, image, predictor.prepare(image)) for predictor, image in demo_pairs()]
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    whole, alone = [], []
    try:
        ends = time.perf_counter() + seconds
        while time.perf_counter() < ends:
            whole += [seconds_of(predictor.predict, image) for predictor, image, _ in pairs]
            alone += [seconds_of(predictor.raw, seen) for predictor, _, seen in pairs]
    finally:
        cv2.setNumThreads(threads)
    ms = [1e3 * float(np.quantile(times, 0.1)) for times in (whole, alone)]
    note = f"{ms[0]:.1f} ms against {ms[1]:.1f} ms"
    return Figure("all that predict does over its network alone, 1 thread", ms[0] / ms[1], "<=", 1.6, "times", note)


def demo_pairs() -> list[tuple["Predictor", np.ndarray]]:
    """The predictor that ships and the picture (h, w, 3) uint8 of every press of the demo."""
    from gelforge.networks.inference.predictor import Predictor, load_for_use

    model, folder = load_for_use(None), Path("data/demo")
    presses = read_presses(folder / "log.csv")
    beside = {
        name: Predictor(model, read_image(folder / f"nocontact/{name}.png"))
        for name in {press.sensor_id for press in presses}
    }
    return [(beside[press.sensor_id], read_image(folder / press.image)) for press in presses]


def seconds_of(work: Callable[..., object], *given: object) -> float:
    """How long a call takes."""
    started = time.perf_counter()
    work(*given)
    return time.perf_counter() - started


def untrained(model: dict, threads: int) -> "Predictor":
    """A network with fresh weights and unit scales, for timing."""
    from gelforge.networks.checkpoint.modelfile import ForceModel
    from gelforge.networks.checkpoint.onnxexport import export
    from gelforge.networks.inference.predictor import Predictor, load_for_use
    from gelforge.networks.models.registry import build

    norm = {"image_mean": [0.4] * 3, "image_std": [0.2] * 3, "label": [1.0] * 3, "reads": model.get("reads", "image")}
    metadata = load_for_use(None).metadata | {"normalisation": norm, "tta": False}
    graph = export(build(model, IMAGE, GRID).eval(), metadata)
    return Predictor(ForceModel(metadata, graph), np.zeros((*IMAGE, 3), np.uint8), threads=threads)


def train_apart(dataset: Path, name: str, settings: TrainTable, folder: Path):
    """Train in a process of its own, so that its peak memory is its own; return the model."""
    from gelforge.networks.checkpoint.modelfile import load_model

    params = folder / f"{name}.json"
    write_json(params, plain(ForTrain(version=1, train=settings)))
    out = folder / f"{name}.onnx"
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
    """Peak memory and waiting for data, for the U-net and the light net; the export itself compares graph and network."""
    figures = []
    for name, epochs in ((BASELINE, 1), (LIGHT, 6)):
        trained = train_apart(dataset, name, replace(settings, epochs=epochs), folder)
        cost = trained.metadata["cost"]
        figures.append(
            Figure(f"peak memory of training `{name}`, batch {settings.batch}", cost["peak_gib"], "<=", 4.0, "GiB")
        )
        figures.append(
            Figure(
                f"waiting for data, `{name}`",
                100 * cost["wait_seconds"] / cost["step_seconds"],
                "<=",
                10.0,
                "% of a step",
                f"{1e3 * cost['seconds'] / cost['steps']:.0f} ms a step",
            )
        )
    return figures


def resume_figure(models: dict, settings: TrainTable, folder: Path, dataset: Path) -> Figure:
    """Difference between the validation curves of a whole training and one that stopped and went on."""
    import torch

    from gelforge.networks.data.arrays import open_data, scales
    from gelforge.networks.training.loop import Training, fit
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


def chart_figures(chart: dict) -> list[Figure]:
    """The network of the chart that is to be used against every row of the paper's ablation."""
    by_name = {row["model"]: row for row in chart["models"]}
    if LIGHT not in by_name:
        raise BadInput(f"{LIGHT!r} is not on the chart of networks; make pareto-models CHARTED with it")
    ours, figures = by_name[LIGHT], []
    for row in (by_name[name] for name in ABLATION if name in by_name):
        name, note = row["model"], f"after {row['epochs']} epochs, {row['train_seconds'] / 3600:.2f} h"
        ratio = row["cpu1_median_ms"] / ours["cpu1_median_ms"]
        if name == BASELINE:
            figures.append(Figure(f"latency of `{name}` over `{LIGHT}`'s, 1 thread", ratio, ">=", 5.0, "times"))
        for key in [f"{what}_{axis}" for what in ("total", "cell") for axis in CHANNELS if row[f"{what}_{axis}"]]:
            figures.append(
                Figure(f"{key.replace('_', ' ')} over `{name}`'s", ours[key] / row[key], "<=", 1.0, "", note)
            )
    return figures


def accuracy_figures(result: dict) -> list[Figure]:
    """Errors of what `predict` reports: known and unseen units and shapes, cells, single contacts, and the labels themselves."""
    splits, span = result["splits"], result["force_range"]
    test = splits["test"]
    figures = []
    for axis, (mean, most) in KNOWN_GOALS.items():
        error, known = test["total"][axis], f"known units and shapes, total {axis}"
        highest, note = 100 * error["mae_high"] / span[axis], f"{error['mae']:.3f} N"
        figures.append(Figure(known, error["mae_percent_of_range"], "<=", mean, "% of range", note))
        figures.append(Figure(f"{known}, upper end of its 95 % interval", highest, "<=", most, "% of range"))
        for control, values in splits["test"]["controls"].items():
            times = f"total {axis}, {control.replace('_', ' ')} over the network"
            figures.append(Figure(times, values[axis] / error["mae"], ">=", 3.0, "times"))
    for axis, goal in CELL_GOALS.items() if test["cell"] else ():
        figures.append(Figure(f"known units and shapes, cell {axis}", test["cell"][axis]["mae"], "<=", goal, "N"))
    if units := splits.get("test_unseen_sensor"):
        figures += [
            Figure(
                f"unseen units, total {axis}",
                units["total"][axis]["mae_percent_of_range"],
                "<=",
                goal,
                "% of range",
            )
            for axis, goal in UNSEEN_UNIT_GOALS.items()
        ]
    if shapes := splits.get("test_unseen_indenter"):
        figures += shape_figures(shapes["per_indenter"], test["total"])
    for name, split in splits.items():
        if split["contacts"]["n"]:
            several = split["contacts"]
            note = f"{several['n']} contacts, {several['mae']:.2f} N"
            figures.append(
                Figure(f"each of several contacts at once, {name}", several["percent"], "<=", 5.0, "%", note)
            )
    if truth := splits["test"]["against"].get("truth"):
        off = 100 * abs(truth["labels_over"]["grid_z"] - 1)
        figures.append(
            Figure("labels against the hidden normal force", off, "<=", 1.0, "%", "least squares through zero")
        )
    return figures


def shape_figures(per_indenter: dict, known: dict) -> list[Figure]:
    """Normal force on the paper's unseen shapes and on those of no catalogue, over that on known ones."""
    figures = []
    for name, goal, chosen in (
        ("the paper's unseen shapes", 1.1, [one for one in per_indenter if one in PAPERS_UNSEEN]),
        ("shapes of no catalogue", 1.5, [one for one in per_indenter if one not in PAPERS_UNSEEN]),
    ):
        pictures = sum(per_indenter[one]["n"] for one in chosen)
        for axis in CHANNELS if chosen else ():
            error = sum(per_indenter[one]["n"] * per_indenter[one][axis]["mae"] for one in chosen) / pictures
            note = f"{error:.3f} N; {pictures} pictures of {len(chosen)} shapes"
            figures.append(
                Figure(f"{name} over known ones, total {axis}", error / known[axis]["mae"], "<=", goal, "", note)
            )
    return figures


def training_cost_figures(result: dict) -> list[Figure]:
    """What the training of the evaluated network took."""
    cost = result["cost"]
    note = f"{len(result['curve'])} epochs"
    return [
        Figure(f"training of `{result['model']}`", cost["seconds"] / 3600, "<=", 3.0, "h", note),
        Figure(f"its peak memory, {note}", cost["peak_gib"], "<=", 4.0, "GiB"),
        Figure("its waiting for data", 100 * cost["wait_seconds"] / cost["step_seconds"], "<=", 10.0, "% of a step"),
    ]


@command(
    option("--results", type=Path, default=Path("results") / os.environ.get("DATASET", "train")),
    option("--resolution", default=os.environ.get("RES", "24x32").split()[0]),
    option("--seconds", type=float, default=4.0, help="of timed runs per network and thread count"),
    option("--parts", nargs="+", choices=PARTS, default=PARTS, help="fewer only to try it out"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    models, settings = load_workflow()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        dataset, figures = write_made_up(folder / "dataset"), []
        if "speed" in args.parts:
            figures += [*speed_figures(models, args.seconds), chain_figure(args.seconds)]
        if "training" in args.parts:
            figures += training_figures(settings, folder, dataset)
        if "resuming" in args.parts:
            figures.append(resume_figure(models, settings, folder, dataset))
    chart = args.results / "pareto_models" / f"{args.resolution}.json"
    evaluation = args.results / "80_evaluate" / args.resolution / f"{LIGHT}.json"
    if chart.exists():
        figures += chart_figures(read_json(chart))
    if evaluation.exists():
        result = read_json(evaluation)
        figures += accuracy_figures(result) + training_cost_figures(result)
    for missing in (path for path in (chart, evaluation) if not path.exists()):
        print(f"not measured, because {missing} is missing: make DATASET={args.results.name} pareto-models")
    publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
