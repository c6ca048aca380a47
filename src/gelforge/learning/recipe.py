"""From datasets to a model: its network is trained and exported, and its limits and intervals are set."""

import json
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from gelforge.errors import BadInput
from gelforge.flow.files import publish
from gelforge.flow.layout import beside
from gelforge.flow.params import plain
from gelforge.flow.tables import TrainingTable
from gelforge.learning.data import (
    ONE_CELL,
    Data,
    concatenate,
    data_version,
    press_keys,
    require_splits,
    scales,
    split_validation,
)
from gelforge.learning.export import export, save_weights
from gelforge.learning.fitting import set_intervals, set_limits, unaltered
from gelforge.learning.nets import parameter_count
from gelforge.learning.train import Training, device_of, fit, require_judges, scales_before
from gelforge.reading.model import ForceModel, model_of, save_model
from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import kind_of
from gelforge.records.samplefile import TRAINING, VALIDATION


@dataclass(frozen=True)
class Trained:
    """A trained network, and the model made from it."""

    net: nn.Module
    model: ForceModel

    @property
    def metadata(self) -> dict[str, Any]:
        """The model's metadata."""
        return self.model.metadata


@dataclass(frozen=True)
class Start:
    """The network that another one is fine-tuned from, and its metadata."""

    net: nn.Module
    metadata: dict[str, Any]


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


def learnt_from(data: Data, names: Sequence[str]) -> dict[str, Any]:
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


@dataclass(frozen=True)
class Recipe:
    """What is trained and how: a table of workflow/models.toml, its name, settings and VERSION of stages/train.py."""

    name: str
    model: dict[str, Any]
    settings: TrainingTable
    version: int


def describe(every: Sequence[Data], recipe: Recipe, start: Start | None) -> dict[str, Any]:
    """Provenance of a network for its model file.

    every: datasets that it learns from, the one that it is evaluated on first.
    """
    data, *others = every
    model, settings = recipe.model, recipe.settings
    device = device_of(settings.device)
    begun: dict[str, Any] = {}
    if start is not None:
        learnt = start.metadata["data"]
        begun = {key: start.metadata[key] for key in ("name", "sha256") if key in start.metadata}
        begun |= {"data": learnt["name"], "simulated": learnt["simulated"]}
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
        "sensors": names_in(every, "sensor_id", TRAINING),
        "indenters": names_in(every, "indenter", TRAINING),
        "threads_used": torch.get_num_threads(),
        "device": device,
        "start": begun,
        # a fine-tuned network keeps what its start learnt from mirrored images
        "tta": kind_of(model).pair and (settings.mirrored_share > 0 or (start is not None and start.metadata["tta"])),
        "data": learnt_from(data, list(data.splits)),
        "also": [learnt_from(other, (TRAINING, VALIDATION)) for other in others],
    }


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
    model, settings = recipe.model, recipe.settings
    for one in (data, *also):
        require_splits(one)
    learnt = concatenate(data, also)
    if settings.total_weight == 0 and learnt.grid != ONE_CELL and not learnt.maps.all():
        names = ", ".join(one.name for one in also if not one.maps.all())
        raise BadInput(
            f"[train] total_weight = 0: only totals are known of {names}, and with this weight they are ignored; set it to 1.0"
        )
    if kind_of(model).pair:
        # name a sensor without no-contact image before hours of training
        learnt.require_nocontact(range(len(learnt.table)))
    unaltered(learnt)  # raise now if all images are altered
    torch.set_num_threads(settings.threads)
    metadata = describe([data, *also], recipe, start)
    # select on half of validation only; the held-out half measures the errors of the network
    choosing = replace(learnt, splits=learnt.splits | {VALIDATION: split_validation(learnt)[0]})
    training = begin(choosing, model, settings, metadata, start)
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
    trained = judged(training.net.cpu(), metadata, learnt, data, start)
    seconds = training.cost["seconds"] + time.perf_counter() - began
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    cost = training.cost | {"seconds": seconds, "peak_gib": peak_gib}
    return replace(trained, model=replace(trained.model, metadata=trained.metadata | {"cost": cost}))


def judged(net: nn.Module, metadata: dict[str, Any], learnt: Data, own: Data, start: Start | None) -> Trained:
    """A network as a model: exported, with limits for its images and prediction intervals for its totals.

    learnt: all that it learnt from. own: the dataset among these that calibrates the intervals.
    """
    metadata = metadata | set_limits(metadata, learnt, None if start is None else start.metadata)
    model = model_of(metadata, export(net, metadata))
    return Trained(net, replace(model, metadata=model.metadata | set_intervals(model, own)))


def begin(
    data: Data, model: dict[str, Any], settings: TrainingTable, metadata: dict[str, Any], start: Start | None
) -> Training:
    """A new training, with the scales that its initial weights expect.

    Fine-tuning never ends with a larger validation error than it began with (`Training.finish`). Raises BadInput as
    `scales`, `scales_before` and `require_judges`.
    """
    norm = scales(data)
    if start is not None:
        norm = scales_before(start.metadata, model, data, norm)
        require_judges(start.metadata, data)
    training = Training(model, settings, norm, metadata["image"], metadata["grid"], metadata["device"])
    if start is not None:
        training.go_on_from(start.net.state_dict(), data)
    return training
