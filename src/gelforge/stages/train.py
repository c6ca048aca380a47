"""Stage 70: train one network of workflow/models.toml on one dataset.

The curve lies inside the model file and, as a table, beside it.
"""

import copy
import json
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish, read_json, write_csv
from gelforge.flow.layout import beside
from gelforge.flow.main import command, option
from gelforge.flow.params import laid_over, plain
from gelforge.flow.params.schema import Place, parse
from gelforge.flow.params.slices import ForTrain, read_slice
from gelforge.flow.params.tables import TrainingTable, TrainTable

VERSION = 11
SHIPPED = "shipped"  # `start` of a network that goes on from the one that ships
# A network that learnt from more sensors is for those that it never saw: their users have untouched pictures of their own.
MOST_PICTURES = 8


def read_models(path) -> dict:
    """Read the model table, TOML as written or JSON as stage 00 leaves it."""
    from gelforge.flow.params import read_toml

    return read_json(path) if Path(path).suffix == ".json" else read_toml(path)


def resolve(models: dict, name: str, train: TrainTable) -> tuple[dict, TrainingTable]:
    """Return the table of model `name` and the training settings with those of its kind and its own laid over them."""
    if name not in models:
        raise BadInput(f"MODEL={name}: no such model in workflow/models.toml; known: {', '.join(sorted(models))}")
    model = dict(models[name])
    if model.get("start", SHIPPED) != SHIPPED:
        raise BadInput(
            f"workflow/models.toml, [{name}]: start = {model['start']!r}: only {SHIPPED!r} can be gone on from"
        )
    own = model.pop("train", {})
    values = plain(train)
    of_kind = values.pop("epochs_of").get(model.get("kind"), 0)
    values["epochs"] = of_kind or train.epochs
    model.pop("note", None)
    place = Place("workflow/models.toml", (name, "train"))
    return model, parse(TrainingTable, laid_over(values, own), place)


def identity(about: dict) -> str:
    """Text that is equal for two trainings exactly when they must give the same curve."""
    keys = ("name", "model", "train", "image", "grid", "data", "threads_used", "device", "mixed", "version", "start")
    return json.dumps({key: about[key] for key in keys}, sort_keys=True)


def describe(data, name: str, model: dict, settings: TrainingTable, start) -> dict:
    """What a model file says about where its network comes from."""
    import torch

    from gelforge.networks.data import data_version
    from gelforge.networks.modelfile import tensor_digest, tensors_of
    from gelforge.networks.training import mixes_precision

    rows = data.splits["train"]
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
        "version": VERSION,
        "torch": torch.__version__,
        "image": list(data.image_size),
        "grid": [1, 1] if model["kind"] == "resnet" else list(data.grid),
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


def train(data, name: str, model: dict, settings: TrainingTable, checkpoint=None, start=None):
    """Train a network; return it with its description, curve and cost inside.

    :param data: networks.data.Data. :param checkpoint: file for resuming, or None.
    :param start: the network to go on from, networks.modelfile.Trained; None: from weights that `seed` draws.
    """
    import torch

    from gelforge.networks.data import require_splits
    from gelforge.networks.inputs import needs_untouched
    from gelforge.networks.modelfile import Trained
    from gelforge.networks.models import parameter_count
    from gelforge.networks.statistics import fit_to_images
    from gelforge.networks.training import fit, peak_memory_gib

    require_splits(data)
    reads = model.get("reads", "image")
    if needs_untouched(reads):
        data.require_untouched(range(len(data.table)))  # one that lacks its picture is named before hours of training
    torch.set_num_threads(settings.threads)
    about = describe(data, name, model, settings, start)
    training = begin(data, model, settings, about, start)
    fit(training, data, checkpoint, identity(about))
    began = time.perf_counter()
    about |= {
        "normalisation": training.norm,
        "statistics": fit_to_images(sights(data, reads, settings), data.splits["train"], data.splits["val"]),
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


def begin(data, model: dict, settings: TrainingTable, about: dict, start):
    """A training at its beginning (networks.training.Training), which scales as its first weights expect.

    One that goes on from `start` has it as its best so far, so that it never ends worse on validation than it began.
    """
    from gelforge.networks.data import scales
    from gelforge.networks.goingon import scales_before
    from gelforge.networks.training import Training

    norm = scales(data, model["kind"] == "resnet", model.get("reads", "image"))
    if start is not None:
        norm = scales_before(start.about, model, data, norm)
    training = Training(model, settings, norm, about["image"], about["grid"], about["device"])
    if start is not None:
        training.go_on_from(start.net.state_dict(), data)
    return training


def beside_untouched(trained, data, settings: TrainingTable, start):
    """A network that reads pictures beside untouched ones with what only such a one has: limits, dots, untouched sensors."""
    from gelforge.networks.data import rows_to_judge_by
    from gelforge.networks.goingon import known_before
    from gelforge.networks.intervals import LEAST_PICTURES

    pictures = data.nocontact if len(data.nocontact) <= MOST_PICTURES else {}
    about = trained.about | learnt_pitch(data, start)
    if start is not None and len(rows_to_judge_by(data)) < LEAST_PICTURES:
        rows = np.concatenate([data.splits["train"], data.splits["val"]])
        images = (np.ascontiguousarray(data.images[row]) for row in rows)
        about |= known_before(start.about, images, good_pairs(data, rows))
        return replace(trained, about=about, untouched=pictures, **readers_of(start))
    about |= {"statistics": about["statistics"] | good_pairs(data, data.splits["val"])}
    by_dots, places = readers_of_dots(data, settings)
    if places:
        about |= {"places": {"data": about["data"]["name"], "pictures": len(data.splits["train"])}}
    if start is not None:
        before = readers_of(start)
        by_dots, places = by_dots or before["dots"], places or before["places"]
        about = {"places": start.about.get("places")} | about
    trained = replace(trained, untouched=pictures, places=places)
    about |= judged(replace(trained, about=about, dots=by_dots), data)
    # one that could not be judged has no say
    return replace(trained, about=about, dots=by_dots if "dots" in about else None)


def readers_of(start) -> dict:
    """The readers of dots beside a network that is gone on from, as a file of them will keep them."""
    from gelforge.networks.halves import rounded
    from gelforge.networks.modelfile import READERS

    found = {name: getattr(start, name) for name in READERS}
    return {name: None if reader is None else rounded(copy.deepcopy(reader)) for name, reader in found.items()}


def sights(data, reads: str, settings: TrainingTable) -> Callable[[int], np.ndarray]:
    """What a picture that the network reads may look like, by row, (h, w, 3) uint8: every other one of a narrow view."""
    from gelforge.networks.augment import narrow_views
    from gelforge.networks.batches import generator
    from gelforge.networks.inputs import needs_untouched

    narrow = replace(settings.augment, narrowed_share=0.5 if settings.augment.narrowed_share else 0.0)

    def see(row: int) -> np.ndarray:
        pair = data.seen([row], reads)
        if needs_untouched(reads):
            pair, _, _ = narrow_views(pair, data.labels[[row]], narrow, generator(settings.seed, "view", 0, row))
        return pair[0, ..., :3]

    return see


def good_pairs(data, rows) -> dict[str, float]:
    """Limits of what the pairs of some rows are like (networks.statistics)."""
    from gelforge.networks.dots import PrintedDots
    from gelforge.networks.statistics import RELIEF_MARGIN, pair_evidence, pair_limits, relief

    names = data.names("sensor_id")[rows]
    dots = {name: PrintedDots(data.nocontact[name]) for name in sorted(set(names.tolist()))}
    pairs = [
        pair_evidence(np.ascontiguousarray(data.images[row]), data.nocontact[name], dots[name])
        for row, name in zip(rows, names, strict=True)
    ]
    return pair_limits(pairs) | {"largest_relief": RELIEF_MARGIN * max(relief(data.nocontact[name]) for name in dots)}


def readers_of_dots(data, settings: TrainingTable):
    """Readers of force and of place from printed dots (networks.dotreader, .placereader).

    None for one that is not asked for, or where a sensor shows no print.
    """
    from gelforge.networks.dotreader import dot_presses, motions, train_dot_reader
    from gelforge.networks.dots import PrintedDots
    from gelforge.networks.placereader import train_place_reader

    if not settings.dot_epochs and not settings.place_epochs:
        return None, None
    dots = {name: PrintedDots(picture) for name, picture in data.nocontact.items()}
    if not all(one.known for one in dots.values()):
        return None, None
    rows, by_dots, places = data.splits["train"], None, None
    motion = motions(data, rows, dots)
    if settings.dot_epochs:
        presses = dot_presses(data, rows, dots, motion)
        by_dots = train_dot_reader(presses, settings.dot_epochs, settings.seed, settings.augment)
    if settings.place_epochs:
        places = train_place_reader(motion, settings.place_epochs, settings.seed)
    return by_dots, places


def judged(trained, data) -> dict:
    """What a model's description says of how its two readers meet, and how far what `predict` tells is off.

    Both are set on what `predict` makes of pictures that training did not see, with light, tare and placement. Empty where
    the network only knows totals.
    """
    from gelforge.networks.agreement import APART_NOTHING, meet, settle
    from gelforge.networks.data import data_version, rows_to_judge_by
    from gelforge.networks.intervals import fit_intervals
    from gelforge.networks.use import tell_rows

    rows = rows_to_judge_by(data)
    if not len(rows):
        return {}
    alone = trained if trained.dots is None else replace(trained, about=trained.about | {"dots": APART_NOTHING})
    told = tell_rows(alone, data, rows)
    forces, labels = told.forces, data.labels[rows]
    if forces.shape[2:] != labels.shape[2:]:
        return {}
    found = {}
    if told.by_dots is not None:
        found["dots"] = meet(forces.sum((2, 3), dtype=float), told.by_dots, labels.sum((2, 3), dtype=float))
        pairs = zip(forces, told.by_dots, strict=True)
        forces = np.stack([settle(one, by_dots, found["dots"]["weight"]) for one, by_dots in pairs])
    sensors = sorted(set(data.names("sensor_id")[rows].tolist()))
    intervals = fit_intervals(forces, labels)
    if not told.in_place:
        intervals.pop("cell", None)  # cells of pictures that were scaled are not the labels'
    return found | {"intervals": intervals | {"sensors": sensors, "data": data.name, "version": data_version(data)}}


def learnt_pitch(data, start=None) -> dict[str, list[float]]:
    """Least and largest distance in px of the dots on the untouched sensors that training saw, and that `start` knew.

    Nothing where none has dots.
    """
    from gelforge.records.markers import pitch_of

    names = set(data.names("sensor_id")[data.splits["train"]].tolist())
    pitches = [pitch for pitch in (pitch_of(data.nocontact[name]) for name in sorted(names)) if pitch]
    pitches += start.about.get("pitch_px", []) if start is not None else []
    return {"pitch_px": [min(pitches), max(pitches)]} if pitches else {}


@command(
    option("--dataset", type=Path, help="60_dataset/RES"),
    option("--model", help="name of a table in --models"),
    option("--models", type=Path, default=Path("workflow/models.toml")),
    option("--params", type=Path),
    option("--part", default="", help="presses_N or units_N: learn from so many of them only (default: all)"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    from gelforge.networks import use
    from gelforge.networks.data import open_data
    from gelforge.networks.modelfile import load_model, save_model
    from gelforge.networks.part import parse_part, take_part
    from gelforge.reporting.networkcharts import draw_curve

    model, settings = resolve(read_models(args.models), args.model, read_slice(args.params, ForTrain).train)
    checkpoint = beside(args.out, ".checkpoint.pt")
    data = open_data(args.dataset)
    if args.part:
        data = take_part(data, parse_part(args.part), settings.seed)
    start = load_model(use.SHIPPED) if model.pop("start", None) else None
    trained = train(data, args.model, model, settings, checkpoint, start)
    curve = trained.about["curve"]
    write_csv(beside(args.out, ".curve.csv"), list(curve[0]), curve)
    with publish(beside(args.out, ".curve.png")) as part:
        draw_curve(part, curve, trained.about["best_epoch"], args.model)
    save_model(args.out, trained)
    checkpoint.unlink(missing_ok=True)
    cost = trained.about["cost"]
    print(
        f"best epoch {trained.about['best_epoch']}, {cost['seconds']:.0f} s in {cost['steps']} steps, waited "
        f"{100 * cost['wait_seconds'] / max(cost['step_seconds'], 1e-9):.1f} % of a step for data, peak {cost['peak_gib']:.2f} GiB"
    )


if __name__ == "__main__":
    main.exit()
