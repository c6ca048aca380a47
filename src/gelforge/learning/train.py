"""Training of a network, from datasets to its ONNX file.

`make_model` is the whole way. Training is seeded, and a resumed training gives the same curve. `training_epochs` is the
loop, `phase_of` its schedule, and `Training.finish` the choice of the weights. Presses that choose the epoch, presses that
calibrate intervals and presses of the tests are three groups without a common press (`learning.data.groups_of`).
"""

import copy
import io
import json
import resource
import time
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F
from torch.optim.swa_utils import AveragedModel
from tqdm import tqdm

from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.files import publish
from gelforge.flow.layout import beside
from gelforge.flow.params import plain
from gelforge.flow.tables import TrainingTable
from gelforge.learning.batches import batches_from, epoch_steps, generator, prefetched
from gelforge.learning.data import (
    ONE_CELL,
    Data,
    concatenate,
    data_version,
    groups_of,
    press_keys,
    require_splits,
    scales,
)
from gelforge.learning.export import Exported, export, save_weights
from gelforge.learning.nets import begin_as, build, parameter_count
from gelforge.learning.predictions import intervals_of, learnt_names
from gelforge.learning.start import Start, require_judges, scales_before
from gelforge.reading.frame import Learnt, learnt_from
from gelforge.reading.model import ForceModel, model_of, save_model
from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import kind_of
from gelforge.records.samplefile import TRAINING, VALIDATION

# Fine-tuning: interpolations between initial weights (0) and learnt weights (1) that validation compares with both.
FRACTIONS = (0.25, 0.5, 0.75)


# From data to a model.


@dataclass(frozen=True)
class Recipe:
    """What is trained and how: a table of workflow/models.toml, its name, settings and VERSION of stages/train.py."""

    name: str
    model: dict[str, Any]
    settings: TrainingTable
    version: int


@dataclass(frozen=True)
class Trained:
    """A trained network, and the model made from it."""

    net: nn.Module
    model: ForceModel

    @property
    def metadata(self) -> dict[str, Any]:
        """The model's metadata."""
        return self.model.metadata


def make_model(
    data: Data,
    recipe: Recipe,
    checkpoint: Path | None = None,
    start: Start | None = None,
    also: Sequence[Data] = (),
) -> Trained:
    """Train the network of a recipe; return it with its metadata, curve and cost inside.

    checkpoint: file for resuming, or None. start: the network to fine-tune; None: weights drawn from `seed`. also:
    other datasets whose training and validation presses it learns from as well; intervals are set on `data` alone.
    Raises BadInput for a dataset that no network can learn from, that `start` cannot be fine-tuned on, or that does
    not match the others.
    """
    learnt = joined(data, also, recipe)
    groups = groups_of(data, learnt)
    torch.set_num_threads(recipe.settings.threads)
    metadata = describe([data, *also], learnt, recipe, start)
    choosing = replace(learnt, splits=learnt.splits | {VALIDATION: groups.choose})
    training = begin(choosing, recipe, metadata, start)
    fit(training, choosing, checkpoint, identity(metadata))
    began = time.perf_counter()
    metadata |= {
        "normalisation": training.norm,
        "curve": training.curve,
        "best_epoch": training.best_epoch,
        "parameters": parameter_count(training.net),
    }
    if start is not None:
        metadata |= {"start": metadata["start"] | {"fraction": training.fraction}}
    net = training.net.cpu()
    model = model_of(metadata, export(net, metadata))
    intervals = intervals_of(model, data, groups, start.metadata if start else None)
    seconds = training.cost["seconds"] + time.perf_counter() - began
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    cost = {"cost": training.cost | {"seconds": seconds, "peak_gib": peak_gib}}
    return Trained(net, replace(model, metadata=model.metadata | intervals | cost))


def joined(data: Data, also: Sequence[Data], recipe: Recipe) -> Data:
    """All that a network learns from as one dataset; BadInput for what it cannot learn from."""
    for one in (data, *also):
        require_splits(one)
    learnt = concatenate(data, also)
    if recipe.settings.total_weight == 0 and learnt.grid != ONE_CELL and not learnt.maps.all():
        names = ", ".join(one.name for one in also if not one.maps.all())
        raise BadInput(
            f"[train] total_weight = 0: only totals are known of {names}, and with this weight they are ignored; set it to 1.0"
        )
    if kind_of(recipe.model).pair:
        # name a sensor without no-contact image before hours of training
        learnt.require_nocontact(range(len(learnt.table)))
    return learnt


def describe(every: Sequence[Data], learnt: Data, recipe: Recipe, start: Start | None) -> dict[str, Any]:
    """Provenance of a network for its model file, and how its cameras see the gel (`frame`).

    every: datasets that it learns from, the one that it is evaluated on first; learnt: all of them as one.
    """
    data, *others = every
    model, settings = recipe.model, recipe.settings
    pair = kind_of(model).pair
    before = None if start is None else start.metadata
    return {
        "name": recipe.name,
        "model": model,
        "train": plain(settings),
        "version": recipe.version,
        "torch": torch.__version__,
        "image": list(data.image_size),
        "grid": list(data.grid),
        "channels": list(CHANNELS),
        "known_sensors": names_in(every, "sensor_id"),
        "sensors": sorted({*names_in(every, "sensor_id", TRAINING), *(before["sensors"] if before else ())}),
        "indenters": names_in(every, "indenter", TRAINING),
        "threads_used": torch.get_num_threads(),
        "device": device_of(settings.device),
        "start": start.table() if start else {},
        # a fine-tuned network keeps what its start learnt from mirrored images
        "tta": pair and (settings.mirrored_share > 0 or bool(before and before["tta"])),
        "data": taken_from(data, list(data.splits)),
        "also": [taken_from(other, (TRAINING, VALIDATION)) for other in others],
    } | ({"frame": frame_of(learnt, before).table()} if pair else {})


def frame_of(learnt: Data, before: dict[str, Any] | None) -> Learnt:
    """How the cameras of the training rows show the gel, together with those that a start's metadata know."""
    pictures = (learnt.nocontact[name] for name in learnt_names(learnt))
    return learnt_from(pictures, None if before is None else Learnt.of(before["frame"]))


def save_trained(path: Path, trained: Trained) -> None:
    """Write weights for fine-tuning beside `path`, then the model to exactly `path`, which the caller publishes."""
    with publish(beside(path, ".safetensors")) as part:
        save_weights(part, trained.net, trained.metadata)
    save_model(path, trained.model)


def identity(metadata: dict[str, Any]) -> str:
    """Text that is equal for two trainings if and only if they must give the same curve."""
    keys = (
        "name", "model", "train", "image", "grid", "data", "also", "threads_used", "device", "version", "torch",
        "start",
    )  # fmt: skip
    return json.dumps({key: metadata[key] for key in keys}, sort_keys=True)


def taken_from(data: Data, names: Sequence[str]) -> dict[str, Any]:
    """What a model file states about a dataset that it learnt from; names: the splits it was given."""
    rows = data.splits[TRAINING]
    return {
        "name": data.name,
        "version": data_version(data),
        "simulated": bool(np.isfinite(data.column("true_fz_n")).any()),
        "samples": {name: len(data.splits[name]) for name in sorted(names) if name in data.splits},
        "presses": len(np.unique(data.presses(rows))),
        "units": len(set(data.names("sensor_id")[rows].tolist())),
        "pressed": sorted(set(press_keys(data, rows).tolist())),
    }


def names_in(every: Sequence[Data], column: str, split: str = "") -> list[str]:
    """Distinct texts in a column of samples.csv over some datasets, sorted; split: only of samples in this split."""
    rows = [one.splits[split] if split else slice(None) for one in every]
    return sorted({name for one, mine in zip(every, rows, strict=True) for name in one.names(column)[mine].tolist()})


def begin(data: Data, recipe: Recipe, metadata: dict[str, Any], start: Start | None) -> "Training":
    """A new training, with the scales that its initial weights expect.

    Fine-tuning never ends with a larger validation error than it began with (`Training.finish`). Raises BadInput as
    `scales`, `scales_before` and `require_judges`.
    """
    norm = scales(data)
    if start is not None:
        norm = scales_before(start.metadata, recipe.model, data, norm)
        require_judges(start.metadata, data)
    how = metadata["image"], metadata["grid"], metadata["device"], metadata["tta"]
    training = Training(recipe.model, recipe.settings, norm, *how)
    if start is not None:
        training.go_on_from(start.net.state_dict(), data)
    return training


# Loss, errors and schedule.


def loss_of(output, target, maps, scale, total_scale, settings: TrainingTable):
    """Mean square error per cell, plus `total_weight` times that of total force, both in units of their own scale.

    Where `maps` (n,) bool is False, only the total is known, and only the sum of the output is compared with it; the
    presses with maps teach its shape. An error of total force beyond `total_huber` scales counts linearly (smooth L1:
    Girshick 2015, equation 3, with its corner at `total_huber`); with `total_huber` 0 all errors count squared.
    output, target: (n, 3, rows, cols) in training units; scale, total_scale: (3,) N.
    """
    square = F.mse_loss(output, target, reduction="none").mean((1, 2, 3))
    loss = square.mean() if output.shape[2:] == ONE_CELL else (square * maps).mean()
    if settings.total_weight > 0 and output.shape[2:] != ONE_CELL:
        error = (output - target).sum((2, 3)) * (scale / total_scale)
        corner = settings.total_huber
        total = F.smooth_l1_loss(error, torch.zeros_like(error), beta=corner) if corner > 0 else (error**2).mean()
        loss = loss + settings.total_weight * total
    return loss


def read_totals(exported: Exported, data: Data, rows: np.ndarray, batch: int, device: str) -> np.ndarray:
    """Total forces (k, 3) N of some rows, by the module that becomes the graph, with tare, as a reader predicts them."""

    def totals(pictures: Sequence[np.ndarray]) -> np.ndarray:
        given = (torch.from_numpy(np.ascontiguousarray(one)).to(device) for one in pictures)
        return np.asarray(exported(*given).cpu().numpy().sum((2, 3), dtype=np.float64))

    parts, exported = [np.zeros((0, 3))], exported.eval()
    pair, rests = exported.net.pair, data.beside[rows]
    at_rest: dict[int, np.ndarray] = {}
    with torch.inference_mode():
        for number in np.unique(rests).tolist() if pair else ():
            at_rest[number] = totals([data.rests[[number]]] * 2)[0]
        for start in range(0, len(rows), batch):
            some = np.s_[start : start + batch]
            if not pair:
                parts.append(totals([data.images[rows[some]]]))
                continue
            tare = np.stack([at_rest[number] for number in rests[some].tolist()])
            parts.append(totals([data.pairs[rows[some]], data.rests[rests[some]]]) - tare)
    return np.concatenate(parts)


def validate(exported: Exported, data: Data, batch: int, device: str) -> dict[str, float]:
    """Validation errors of an epoch: mean absolute error of total force by component, their sum, N, and val_score.

    val_score selects the epoch: the mean of the three errors, each over the scale of its component's total, so that
    shear counts as much as normal force.
    """
    rows = data.splits[VALIDATION]
    mae = np.abs(read_totals(exported, data, rows, batch, device) - data.totals(rows)).mean(0)
    return {f"val_{name}": float(value) for name, value in zip(CHANNELS, mae, strict=True)} | {
        "val_total": float(mae.sum()),
        "val_score": float((mae / exported.norm["total"]).mean()),
    }


class Phase(NamedTuple):
    """What an epoch does: whether batch normalisation keeps its statistics, and whether weights are averaged."""

    frozen: bool
    averaged: bool


def phase_of(epoch: int, settings: TrainingTable) -> Phase:
    """The phase of an epoch (from 0).

    In the last `frozen_share` of the epochs batch normalisation keeps its statistics. In the last `averaged_share`
    the weights are averaged over the steps (Izmailov et al. 2018), and their mean is validated. Images are mirrored in
    the first `mirrored_share` (`learning.batches`), and the learning rate decays to zero along half a cosine.
    """
    frozen, averaged = (
        epoch >= (1 - share) * settings.epochs for share in (settings.frozen_share, settings.averaged_share)
    )
    return Phase(frozen, averaged)


def device_of(asked: str) -> str:
    """torch's device for [train] device; "auto" takes a GPU if there is one. BadInput if the device is not there."""
    there = torch.cuda.is_available()
    if asked == "cuda" and not there:
        raise BadInput(
            '[train] device = "cuda": torch finds no graphics card here; set "auto" or "cpu", or install torch for yours'
        )
    return "cuda" if asked == "cuda" or (asked == "auto" and there) else "cpu"


def normalisations(net) -> list[torch.nn.BatchNorm2d]:
    """The layers of a network that normalise by the statistics of a batch."""
    return [layer for layer in net.modules() if isinstance(layer, torch.nn.BatchNorm2d)]


def between(first: dict, last: dict, fraction: float) -> dict:
    """Weights of one kind of network that lie `fraction` of the way from the first to the last; whole numbers are the first's."""
    return {
        name: torch.lerp(value, last[name], fraction) if value.is_floating_point() else value
        for name, value in first.items()
    }


def initial_net(model: dict, image, grid, seed: int):
    """Build a network whose weights depend on `seed` alone; torch's own generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(generator(seed, "weights").initial_seed())
        return build(model, image, grid)


class Training:
    """A network with all state that is needed to resume its training."""

    def __init__(self, model: dict, settings: TrainingTable, norm: dict, image, grid, device: str, tta: bool = False):
        self.settings, self.norm, self.device, self.tta = settings, norm, device, tta
        # with channels last in memory, convolutions on a CPU are a third faster
        self.net = initial_net(model, image, grid, settings.seed).to(device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=settings.learning_rate)
        # decays to zero along half a cosine (Loshchilov and Hutter 2017)
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimiser, settings.epochs)
        self.mean: AveragedModel | None = None  # mean of the weights, once averaging has begun
        self.curve: list[dict] = []
        self.best: dict[str, Any] = {"epoch": 0, "val_score": float("inf"), "weights": None}
        self.start: dict[str, Any] | None = None  # initial weights of fine-tuning, and their validation errors
        self.fraction = 1.0  # position of the final weights between the initial (0) and the best ones (1)
        # seconds: of all training, step_seconds: of its steps, wait_seconds: part of these spent waiting for batches
        self.cost: dict[str, Any] = {
            "seconds": 0.0, "step_seconds": 0.0, "wait_seconds": 0.0, "steps": 0, "resumed": 0,
        }  # fmt: skip

    def go_on_from(self, weights: dict, data) -> None:
        """Fine-tune from the weights of another network of the same kind; validates them."""
        begin_as(self.net, weights)
        self.start = self.validated(self.net, data) | {"weights": copy.deepcopy(self.net.state_dict())}

    def validated(self, net, data) -> dict:
        """Validation errors of a network that uses the scales of this one."""
        exported = Exported(net, {"normalisation": self.norm, "tta": self.tta}).to(self.device)
        return validate(exported, data, self.settings.batch, self.device)

    def finish(self, data) -> None:
        """Load the best epoch's weights; after fine-tuning, an interpolation between these and the initial weights.

        Interpolated weights have smaller errors on images of the old dataset, the new one and others (Wortsman et al.
        2022, Robust fine-tuning of zero-shot models, CVPR, section 3.2). Validation selects the interpolation.
        """
        best = self.best["weights"]
        if self.start is not None:
            judged = {0.0: self.start["val_score"], 1.0: self.best["val_score"]}
            for fraction in FRACTIONS:
                self.net.load_state_dict(between(self.start["weights"], best, fraction))
                judged[fraction] = self.validated(self.net, data)["val_score"]
            self.fraction = min(judged, key=lambda fraction: judged[fraction])
            best = between(self.start["weights"], best, self.fraction)
        self.net.load_state_dict(best)
        self.net.to(memory_format=torch.contiguous_format).eval()

    @property
    def best_epoch(self) -> int:
        """The best epoch, from 1; 0 if validation kept the initial weights of fine-tuning."""
        return self.best["epoch"] if self.fraction else 0

    @property
    def judged(self) -> torch.nn.Module:
        """The network that is validated: the one with mean weights once averaging has begun."""
        return self.net if self.mean is None else self.mean.module

    def save(self, path, identity: str) -> None:
        """Write a checkpoint, tensors and plain values only, whole or not at all; OSError if the disk is full."""
        content = io.BytesIO()  # torch would raise an error of its own, not OSError, on a full disk
        torch.save({
            "identity": identity, "net": self.net.state_dict(), "mean": None if self.mean is None else self.mean.state_dict(),
            "optimiser": self.optimiser.state_dict(), "schedule": self.schedule.state_dict(),
            "curve": self.curve, "best": self.best, "cost": self.cost,
        }, content)  # fmt: skip
        with publish(path) as part:
            part.write_bytes(content.getvalue())

    def resume(self, path, identity: str) -> bool:
        """Resume from a checkpoint of the same training; return whether it did. Prints why a file is not used."""
        if path is None or not Path(path).exists():
            return False
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # for a corrupt file torch raises a dozen types, none of them documented
            print(f"{path}: cannot be read ({type(error).__name__}), starting over", flush=True)
            return False
        if not isinstance(state, dict) or state.get("identity") != identity:
            print(f"{path}: of another configuration or dataset, starting over", flush=True)
            return False
        self.net.load_state_dict(state["net"])
        if state["mean"] is not None:
            self.mean = AveragedModel(self.net)
            self.mean.load_state_dict(state["mean"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.schedule.load_state_dict(state["schedule"])
        self.curve, self.best, self.cost = state["curve"], state["best"], state["cost"]
        self.cost["resumed"] += 1
        print(f"{path}: going on after epoch {len(self.curve)}", flush=True)
        return True


def training_epochs(training: Training, data: Data) -> Generator[dict[str, Any]]:
    """Train through the remaining epochs; yield the curve's new row after each."""
    settings, norm, net, cost, device = training.settings, training.norm, training.net, training.cost, training.device
    scale, total = (torch.tensor(norm[key], device=device).float() for key in ("label", "total"))
    first = len(training.curve)
    with closing(prefetched(batches_from(data, norm, settings, first, net.pair))) as batches:
        for epoch in range(first, settings.epochs):
            started, phase = time.perf_counter(), phase_of(epoch, settings)
            net.train()
            for layer in normalisations(net) if phase.frozen else ():
                layer.eval()

            losses: list[float] = []
            for _ in range(epoch_steps(data, settings)):
                asked = time.perf_counter()
                images, target, maps = (one.to(device) for one in next(batches))
                cost["wait_seconds"] += time.perf_counter() - asked
                training.optimiser.zero_grad(set_to_none=True)
                loss = loss_of(net(images), target, maps, scale, total, settings)
                loss.backward()
                training.optimiser.step()
                if phase.averaged:
                    training.mean = training.mean or AveragedModel(net)
                    training.mean.update_parameters(net)
                losses.append(loss.item())
            cost["step_seconds"] += time.perf_counter() - started
            cost["steps"] += len(losses)
            if not np.isfinite(losses).all():
                raise GelforgeError(
                    f"training diverged in epoch {epoch + 1}: a loss is not finite; lower [train] learning_rate, now"
                    f" {settings.learning_rate:g} at its start"
                )

            rate = training.optimiser.param_groups[0]["lr"]
            row = {"epoch": epoch + 1, "learning_rate": rate, "loss": float(np.mean(losses))}
            row |= training.validated(training.judged, data)
            training.schedule.step()
            training.curve.append(row)
            if row["val_score"] < training.best["val_score"]:
                weights = copy.deepcopy(training.judged.state_dict())
                training.best = {"epoch": row["epoch"], "val_score": row["val_score"], "weights": weights}
            cost["seconds"] += time.perf_counter() - started
            yield row


def fit(training: Training, data, checkpoint=None, identity: str = "", epochs: int | None = None) -> None:
    """Train up to `epochs` (all if None), then select the network's weights by validation (`Training.finish`).

    :param checkpoint: file to resume from and to write every `checkpoint_seconds`; None for neither.
    :param identity: text that identifies one training; a checkpoint of another one is not used.
    """
    training.resume(checkpoint, identity)
    planned, saved = training.settings.epochs, time.monotonic()
    last = planned if epochs is None else epochs
    with closing(training_epochs(training, data)) as rows:
        for number in tqdm(range(len(training.curve), last), f"epochs of {planned}"):
            row = next(rows)
            if number % max(1, planned // 20) == 0 or number == planned - 1:
                errors = ", ".join(f"{name} {row[f'val_{name}']:.3f}" for name in CHANNELS)
                print(
                    f"epoch {row['epoch']}: loss {row['loss']:.4g}, validation {errors} N, rate {row['learning_rate']:.2g}",
                    flush=True,
                )
            if checkpoint and time.monotonic() - saved >= training.settings.checkpoint_seconds:
                training.save(checkpoint, identity)
                saved = time.monotonic()
    training.finish(data)
