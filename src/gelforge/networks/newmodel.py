"""A model made of one dataset: its network trained, what is fitted beside it, and what its file says of both."""

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gelforge.errors import BadInput
from gelforge.flow.params import plain
from gelforge.flow.params.tables import TrainingTable
from gelforge.networks.data import Data, data_version, require_splits, scales
from gelforge.networks.fitting import beside_untouched, held, sights
from gelforge.networks.goingon import require_alike, require_judges, scales_before
from gelforge.networks.inputs import needs_untouched
from gelforge.networks.joined import join
from gelforge.networks.modelfile import Trained, datasets_of, tensor_digest, tensors_of
from gelforge.networks.models import parameter_count
from gelforge.networks.stackfit import fit_stacking
from gelforge.networks.statistics import fit_to_images
from gelforge.networks.training import Training, fit, mixes_precision, peak_memory_gib
from gelforge.records.networkkind import kind_of
from gelforge.records.splits import TRAINING, VALIDATION


def identity(about: dict[str, Any]) -> str:
    """Text that is equal for two trainings exactly when they must give the same curve."""
    keys = (
        "name", "model", "train", "image", "grid", "data", "also", "threads_used", "device", "mixed", "version", "torch",
        "start",
    )  # fmt: skip
    return json.dumps({key: about[key] for key in keys}, sort_keys=True)


def learnt_from(data: Data, names: Sequence[str]) -> dict[str, Any]:
    """What a model file says of a dataset that it learnt from; names: splits that it was given."""
    rows = data.splits[TRAINING]
    return {
        "name": data.name,
        "version": data_version(data),
        "simulated": bool(np.isfinite(data.column("true_fz_n")).any()),
        "samples": {name: len(data.splits[name]) for name in sorted(names) if name in data.splits},
        "presses": len(np.unique(data.presses(rows))),
        "units": len(set(data.names("sensor_id")[rows].tolist())),
    }


def names_in(every: Sequence[Data], column: str, split: str = "") -> list[str]:
    """What a column of samples.csv names in some datasets, sorted; split: only where samples are of it."""
    rows = [one.splits[split] if split else slice(None) for one in every]
    return sorted({name for one, mine in zip(every, rows, strict=True) for name in one.names(column)[mine].tolist()})


def describe(
    every: Sequence[Data],
    name: str,
    model: dict[str, Any],
    settings: TrainingTable,
    version: int,
    start: Trained | None,
) -> dict[str, Any]:
    """What a model file says about where its network comes from.

    every: datasets that it learns from, the one that it is judged on first. version: of how networks are trained.
    """
    data, *others = every
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
        "known_sensors": names_in(every, "sensor_id"),
        "sensors": names_in(every, "sensor_id", TRAINING),
        "indenters": names_in(every, "indenter", TRAINING),
        "threads_used": torch.get_num_threads(),
        "device": device,
        "start": begun,
        # one that goes on keeps what light of any direction taught the other
        "both_ways": needs_untouched(model.get("reads", "image"))
        and (settings.mirrored_share > 0 or (start is not None and start.about.get("both_ways", False))),
        "mixed": mixes_precision(settings, device),
        "data": learnt_from(data, list(data.splits)),
        "also": [learnt_from(other, (TRAINING, VALIDATION)) for other in others],
    }


def make_model(
    data: Data,
    name: str,
    model: dict[str, Any],
    settings: TrainingTable,
    version: int,
    checkpoint: Path | None = None,
    start: Trained | None = None,
    also: Sequence[Data] = (),
) -> Trained:
    """Train the network of a table of workflow/models.toml; return it with its description, curve and cost inside.

    version: of how networks are trained, told in the description. checkpoint: file for resuming, or None. start: the
    network to go on from; None: from weights that `seed` draws. also: other datasets, whose presses to train on and to
    validate with it learns from as well; its intervals are of `data` alone. Raises BadInput for a dataset that no network
    can learn from, that `start` cannot go on with, or that cannot be learnt from beside the others.
    """
    for one in (data, *also):
        require_splits(one)
    learnt = join(data, also)
    reads = model.get("reads", "image")
    if needs_untouched(reads):
        # one that lacks its picture is named before hours of training
        learnt.require_untouched(range(len(learnt.table)))
    torch.set_num_threads(settings.threads)
    about = describe([data, *also], name, model, settings, version, start)
    training = begin(learnt, model, settings, about, start)
    fit(training, learnt, checkpoint, identity(about))
    began = time.perf_counter()
    about |= {
        "normalisation": training.norm,
        "statistics": fit_to_images(
            sights(learnt, reads, settings), learnt.splits[TRAINING], learnt.splits[VALIDATION]
        ),
        "curve": training.curve,
        "best_epoch": training.best_epoch,
        "parameters": parameter_count(training.net),
    }
    if start is not None:
        about |= {"start": about["start"] | {"share": training.share}}
    trained = Trained(training.net.cpu(), about)
    if needs_untouched(reads):
        trained = beside_untouched(trained, learnt, data, settings, start)
    seconds = training.cost["seconds"] + time.perf_counter() - began
    cost = training.cost | {"seconds": seconds, "peak_gib": peak_memory_gib()}
    return replace(trained, about=trained.about | {"cost": cost})


def make_stacked(
    data: Data,
    name: str,
    model: dict[str, Any],
    settings: TrainingTable,
    start: Trained,
    also: Sequence[Data] = (),
) -> Trained:
    """`start` with a network above both its readers, learnt from the training presses of datasets of which one is new to it.

    Network and readers stay as they are and meet as they did, and so does what the file says of how they learnt; how far
    totals may be off is set anew, on the other presses of `data`. also: other datasets to learn from. Either may be known to
    `start`: with three times as many known presses beside new ones it erred 7 % less on others than with the new ones alone.
    Raises BadInput where no dataset is new to `start`, for one that it cannot read, and for too few new presses.
    """
    every = (data, *also)
    for one in every:
        require_splits(one)
    learnt = join(data, also)
    learnt.require_untouched(range(len(learnt.table)))
    require_alike(start.about, model, learnt)
    known = [one["version"] for one in datasets_of(start.about)]
    lessons = [learnt_from(one, (TRAINING,)) for one in every]
    own, *others = (lesson | {"new": lesson["version"] not in known} for lesson in lessons)
    new = [one for one, lesson in zip(every, (own, *others), strict=True) if lesson["new"]]
    if not new:
        raise BadInput(
            f"{data.folder}: {start.about['name']} learnt from these presses, and errs less on them than on others: how it"
            " errs is learnt from presses that are new to it; choose another DATASET, or name one in [train] also"
        )
    torch.set_num_threads(settings.threads)
    trained = replace(start, about=start.about | {"name": name}, stacking=None)
    stacking = fit_stacking(trained, new, learnt, settings)
    told = own | {"also": others, "epochs": settings.stacking_epochs}
    trained = replace(trained, about=trained.about | {"stacking": told}, stacking=stacking)
    return replace(trained, about=trained.about | held(trained, data))


def begin(
    data: Data, model: dict[str, Any], settings: TrainingTable, about: dict[str, Any], start: Trained | None
) -> Training:
    """A training at its beginning, which scales as its first weights expect.

    One that goes on from `start` never ends worse on validation than it began: what it learns counts as far as that helps.
    """
    norm = scales(data, kind_of(model).totals_only, model.get("reads", "image"))
    if start is not None:
        norm = scales_before(start.about, model, data, norm)
        require_judges(start.about, data)
    training = Training(model, settings, norm, about["image"], about["grid"], about["device"])
    if start is not None:
        training.go_on_from(start.net.state_dict(), data)
    return training
