"""Latency of networks, and memory and waiting for data in training.

None of this needs a trained network; training is measured on synthetic presses.
"""

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

from gelforge.flow.cli import command, option
from gelforge.flow.files import write_csv, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import StageParameters, load_params, plain, read_toml
from gelforge.flow.tables import TrainTable
from gelforge.records.image import read_image
from gelforge.records.log import read_presses
from tests.support.figures import Figure, publish_figures

if TYPE_CHECKING:
    from gelforge.reading.model import ForceModel
    from gelforge.reading.reader import Reader

IMAGE, GRID = (240, 320), (24, 32)
BASELINE, LIGHT = "unet", "pair_24_mirrored"
SHIPS = "tuned"  # has the architecture of the shipped network, which is deeper than LIGHT
PARTS = ("speed", "training")
PROBED = 24  # training presses of the synthetic dataset: three batches per epoch


def write_made_up(folder: Path) -> Path:
    """Write a dataset of noise in the form of stage 60, which suffices for time and memory."""
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
    np.save(folder / "nocontact.npy", rng.integers(0, 256, (1, *IMAGE, 3), np.uint8))
    write_json(folder / "dataset.json", {"name": "made up", "grid": list(GRID), "nocontact": ["none"]})
    return folder


def load_workflow() -> tuple[dict, TrainTable]:
    """The model table and the [train] table of the working tree."""
    return read_toml("workflow/models.toml"), load_params("workflow").train


def speed_figures(models: dict, seconds: float) -> list[Figure]:
    """Speed-up of the shipped network over the U-net, with one and two threads."""
    from gelforge.learning.predictions import time_models

    image = np.random.default_rng(0).integers(0, 256, (*IMAGE, 3), np.uint8)
    figures = []
    for threads in (1, 2):
        timed = time_models({name: untrained(models[name], threads) for name in (BASELINE, SHIPS)}, image, seconds)
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
    """Time of `predict` over that of its graph alone, on the demo's pairs, one thread.

    Both take turns, and each time is the 10 % quantile of its runs: longer runs are interrupted more often by other
    programs, which would count as their own time.
    """
    import cv2

    pairs = [(predictor, image, predictor.compare(image)) for predictor, image in demo_pairs()]
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    whole, alone = [], []
    try:
        ends = time.perf_counter() + seconds
        while time.perf_counter() < ends:
            whole += [seconds_of(predictor, image) for predictor, image, _ in pairs]
            alone += [seconds_of(predictor.forces, seen) for predictor, _, seen in pairs]
    finally:
        cv2.setNumThreads(threads)
    ms = [1e3 * float(np.quantile(times, 0.1)) for times in (whole, alone)]
    note = f"{ms[0]:.1f} ms against {ms[1]:.1f} ms"
    return Figure("all that predict does over its network alone, 1 thread", ms[0] / ms[1], "<=", 1.6, "times", note)


def demo_pairs() -> list[tuple["Reader", np.ndarray]]:
    """The shipped predictor and the image (h, w, 3) uint8 of every press of the demo."""
    from gelforge.reading.model import load_model
    from gelforge.reading.reader import Reader

    model, folder = load_model(None), Path("data/demo")
    presses = read_presses(folder / "log.csv")
    beside = {
        name: Reader(read_image(folder / f"nocontact/{name}.png"), model=model)
        for name in {press.sensor_id for press in presses}
    }
    return [(beside[press.sensor_id], read_image(folder / press.image)) for press in presses]


def seconds_of(work: Callable[..., object], *given: object) -> float:
    """Wall time of a call, s."""
    started = time.perf_counter()
    work(*given)
    return time.perf_counter() - started


def untrained(model: dict, threads: int) -> "ForceModel":
    """A network with random weights and unit scales, for timing."""
    from gelforge.learning.export import export
    from gelforge.learning.nets import build
    from gelforge.reading.model import load_model, model_of, on_device

    norm = {"image_mean": [0.4] * 3, "image_std": [0.2] * 3, "label": [1.0] * 3}
    metadata = load_model(None).metadata | {"model": model, "normalisation": norm, "tta": False}
    graph = export(build(model, IMAGE, GRID).eval(), metadata)
    return on_device(model_of(metadata, graph), "cpu", threads)


def train_apart(dataset: Path, name: str, settings: TrainTable, folder: Path):
    """Train in a separate process, so that its peak memory is its own; return the model."""
    from gelforge.reading.model import load_model

    of = Layout(folder / "results/timed")
    write_json(of.parameters("train"), plain(StageParameters(version=1, train=settings)))
    write_json(of.parameters(f"models/{name}"), {name: read_toml("workflow/models.toml")[name]})
    if not of.dataset(dataset.name).exists():
        of.dataset(dataset.name).parent.mkdir(parents=True)
        of.dataset(dataset.name).symlink_to(dataset.absolute())
    command = [sys.executable, "-m", "gelforge.stages.train", str(of.root), dataset.name, name]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return load_model(of.network(dataset.name, name))


def training_figures(settings: TrainTable, folder: Path, dataset: Path) -> list[Figure]:
    """Peak memory and waiting for data, for the U-net and the light network; export compares graph and network."""
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


@command(
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
    publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
