"""A model made of one dataset: its network trained, what is fitted beside it, and what its file says of both."""

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gelforge.flow.params import plain
from gelforge.flow.params.tables import TrainingTable
from gelforge.networks.data import Data, data_version, require_splits, scales
from gelforge.networks.fitting import beside_untouched, sights
from gelforge.networks.goingon import scales_before
from gelforge.networks.inputs import needs_untouched
from gelforge.networks.modelfile import Trained, tensor_digest, tensors_of
from gelforge.networks.models import parameter_count
from gelforge.networks.statistics import fit_to_images
from gelforge.networks.training import Training, fit, mixes_precision, peak_memory_gib
from gelforge.records.networkkind import kind_of
from gelforge.records.splits import TRAINING, VALIDATION


def identity(about: dict[str, Any]) -> str:
    """Text that is equal for two trainings exactly when they must give the same curve."""
    keys = ("name", "model", "train", "image", "grid", "data", "threads_used", "device", "mixed", "version", "start")
    return json.dumps({key: about[key] for key in keys}, sort_keys=True)


def describe(
    data: Data, name: str, model: dict[str, Any], settings: TrainingTable, version: int, start: Trained | None
) -> dict[str, Any]:
    """What a model file says about where its network comes from; version: of how networks are trained."""
    rows = data.splits[TRAINING]
    device = "cuda" if torch.cuda.is_available() else "cpu"
    begun: dict = {}
    if start is not None:
        learnt = start.about["data"]
        begun = {"name": start.about["name"], "sha256": tensor_digest(tensors_of(start.net))}
        begun |= {"data": learnt["name"], "simulated": learnt["simulated"]}
    return {
        "name": name,
        "model": model,
        "train": plain(settings),
        "version": version,
        "torch": torch.__version__,
        "image": list(data.image_size),
        "grid": [1, 1] if kind_of(model).totals_only else list(data.grid),
        "known_sensors": sorted(set(data.names("sensor_id").tolist())),
        "sensors": sorted(set(data.names("sensor_id")[rows].tolist())),
        "indenters": sorted(set(data.names("indenter")[rows].tolist())),
        "threads_used": torch.get_num_threads(),
        "device": device,
        "start": begun,
        "mixed": mixes_precision(settings, device),
        "data": {
            "name": data.name,
            "version": data_version(data),
            "simulated": bool(np.isfinite(data.column("true_fz_n")).any()),
            "samples": {key: len(value) for key, value in sorted(data.splits.items())},
            "presses": len(np.unique(data.presses(rows))),
            "units": len(set(data.names("sensor_id")[rows].tolist())),
        },
    }


def make_model(
    data: Data,
    name: str,
    model: dict[str, Any],
    settings: TrainingTable,
    version: int,
    checkpoint: Path | None = None,
    start: Trained | None = None,
) -> Trained:
    """Train the network of a table of workflow/models.toml; return it with its description, curve and cost inside.

    version: of how networks are trained, told in the description. checkpoint: file for resuming, or None. start: the
    network to go on from; None: from weights that `seed` draws. Raises BadInput for a dataset that no network can
    learn from, or that `start` cannot go on with.
    """
    require_splits(data)
    reads = model.get("reads", "image")
    if needs_untouched(reads):
        data.require_untouched(range(len(data.table)))  # one that lacks its picture is named before hours of training
    torch.set_num_threads(settings.threads)
    about = describe(data, name, model, settings, version, start)
    training = begin(data, model, settings, about, start)
    fit(training, data, checkpoint, identity(about))
    began = time.perf_counter()
    about |= {
        "normalisation": training.norm,
        "statistics": fit_to_images(sights(data, reads, settings), data.splits[TRAINING], data.splits[VALIDATION]),
        "curve": training.curve,
        "best_epoch": training.best["epoch"],
        "parameters": parameter_count(training.net),
    }
    trained = Trained(training.net.cpu(), about)
    if needs_untouched(reads):
        trained = beside_untouched(trained, data, settings, start)
    seconds = training.cost["seconds"] + time.perf_counter() - began
    cost = training.cost | {"seconds": seconds, "peak_gib": peak_memory_gib()}
    return replace(trained, about=trained.about | {"cost": cost})


def begin(
    data: Data, model: dict[str, Any], settings: TrainingTable, about: dict[str, Any], start: Trained | None
) -> Training:
    """A training at its beginning, which scales as its first weights expect.

    One that goes on from `start` has it as its best so far, so that it never ends worse on validation than it began.
    """
    norm = scales(data, kind_of(model).totals_only, model.get("reads", "image"))
    if start is not None:
        norm = scales_before(start.about, model, data, norm)
    training = Training(model, settings, norm, about["image"], about["grid"], about["device"])
    if start is not None:
        training.go_on_from(start.net.state_dict(), data)
    return training
