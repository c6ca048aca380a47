"""Convert whole datasets between FEATS' folders and gelforge's."""

import hashlib
import math
import re
import shutil
from collections.abc import Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.flow.files import write_csv, write_json, write_text
from gelforge.formats.featsfile import (
    FORCE_FIELDS,
    POSE_FIELDS,
    TOTALS,
    LabelSample,
    Ranges,
    RawSample,
    exchanged,
    is_normalisation,
    read_normalisation,
    read_sample,
    write_label,
)
from gelforge.records.image import read_image, write_png
from gelforge.records.labelfile import write_labels
from gelforge.records.log import write_log
from gelforge.records.press import FORCES, POSE, LoggedPress, check_id, pull_fault, size_fault
from gelforge.records.rowfile import map_array
from gelforge.records.samplefile import SPLITS, TRAINING, UNSEEN_INDENTER, UNSEEN_SENSOR, VALIDATION, read_samples

FEATS_C10 = 0.0792  # MPa, the paper's fit, used for its labels
GEL_ID = "feats"  # for all presses, because FEATS' files name no gel
QUIETEST, FEWEST_QUIET = 64, 16  # most and fewest images of least force that a no-contact image is made from
# Columns of an image that came with a label only: its pose and measured force are unknown.
NO_PRESS = {**dict.fromkeys(POSE, math.nan), **dict.fromkeys(FORCES), "indenter": "", "time_utc": ""}
DATASET_TOML = """# Imported from files in FEATS' layout.
sensor = "{sensor}"
gel = "{gel}"
catalogue = "indenters.toml"
[params.plan]
shard_size = 500
"""
# Branches of the report need poses and force readings, which a dataset of labels only lacks.
LABELS_ALONE = "[params.report]\nbranches = []\n"


def refuse_existing(path: Path) -> None:
    """BadInput where the folder of a new dataset exists already."""
    if path.exists():
        raise BadInput(f"{path} exists already; remove it, or give another name (DATASET=...)")


@contextmanager
def new_folder(path: Path):
    """Yield a temporary folder beside `path`, renamed to `path` if the block succeeds; BadInput if it exists."""
    refuse_existing(path)
    part = path.with_name(f".{path.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        yield part
        part.rename(path)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def split_of(folder: str) -> str:
    """The split that a folder's name stands for, in gelforge's or another spelling; empty where for none."""
    name = folder.lower().replace("-", "_")
    if name in SPLITS:
        return name
    if "unseen" in name or "unknown" in name:
        return UNSEEN_SENSOR if "sensor" in name else UNSEEN_INDENTER if "indenter" in name else ""
    return {"training": TRAINING, "validation": VALIDATION, "valid": VALIDATION}.get(name, "")


def import_folder(source: Path, data: Path, sensor, other=None, splits: Sequence[str] = ()) -> dict:
    """Turn the .npy files below `source` into the dataset folder `data`; return counts of presses, labels and files.

    Raw samples become rows of log.csv and images; label files become labels/ROWSxCOLS.npz. A raw sample and a label
    file with the same image are one press. `sensor` is the Sensor that took the images, `other` the one that took
    those of the unseen-sensor split, if known. splits: folders to take, all where none is named. Label files also
    give a no-contact image of each sensor (`write_nocontact`). An unusable file raises BadInput that names it, and
    nothing is left behind.
    """
    missing = [name for name in splits if not (source / name).is_dir()]
    if missing:
        there = ", ".join(sorted(path.name for path in source.iterdir() if path.is_dir())) or "no folders"
        raise BadInput(f"SPLIT={missing[0]}: {source} has no such folder; it has {there}")
    files = sorted(path for name in splits or ["."] for path in (source / name).rglob("*.npy"))
    if not files:
        raise BadInput(f"{source}: holds no .npy files; give FEATS' folder of samples or labels as FROM=...")
    with new_folder(data) as part:
        presses: dict[str, dict] = {}
        labels: dict[tuple[int, int], dict[str, np.ndarray]] = {}
        ranges = None
        for path in tqdm(files, "import"):
            if is_normalisation(path):
                ranges = read_normalisation(path)
                continue
            _take(path, read_sample(path), sensor, part, presses, labels)
        if not presses:
            raise BadInput(f"{source}: holds normalisation files only; give the folder that holds the samples too")
        splits_of = published_splits(source, presses)
        unseen = {row["sample_id"] for row in splits_of if other and row["split"] == UNSEEN_SENSOR}
        for press in presses.values():
            taken_by = other if press["row"]["sample_id"] in unseen else sensor
            press["row"] |= {"sensor_id": taken_by.name, "gel_id": GEL_ID}
        rows = [press["row"] for press in presses.values()]
        write_log(part / "log.csv", [LoggedPress(row=0, **{**NO_PRESS, **row}) for row in rows])
        for (height, width), members in labels.items():
            _write_grid(part / "labels" / f"{height}x{width}.npz", members, presses)
        if ranges:
            write_json(part / "feats_normalisation.json", ranges)
        if splits_of:
            write_csv(part / "splits.csv", ["sample_id", "split"], splits_of)
        write_nocontact(part, presses)
        known = any(press["raw"] for press in presses.values())
        text = DATASET_TOML.format(sensor=sensor.name, gel=sensor.gel) + ("" if known else LABELS_ALONE)
        write_text(part / "dataset.toml", text)
    grids = {f"{rows}x{cols}": len(members) for (rows, cols), members in labels.items()}
    return {"presses": len(presses), "labels": grids, "files": len(files)}


def published_splits(source: Path, presses: dict) -> list[dict]:
    """sample_id and split of every press where folders directly below `source` are named after splits, else none.

    FEATS' published dataset has train/, val/, test/ and three folders of unseen indenters and sensors. A press
    belongs to the split whose folder holds one of its files. BadInput where the files of a press lie in two splits,
    or where some presses lie in a split and others in none.
    """
    found, outside = [], []
    for press in presses.values():
        folders = {split_of(path.relative_to(source).parts[0]) for path in press["files"]}
        named = [name for name in SPLITS if name in folders]
        if len(named) > 1:
            name, others = press["row"]["sample_id"], " and ".join(named)
            raise BadInput(f"{source}: files with the image of {name} lie in {others}; leave them in one of these")
        if named:
            found.append({"sample_id": press["row"]["sample_id"], "split": named[0]})
        else:
            outside.append(press["files"][0])
    if found and outside:
        raise BadInput(
            f"{outside[0]}: is in none of the folders {', '.join(SPLITS)}, but other files are; move it into one"
        )
    return found


def refuse_beyond_limits(path: Path, sample: LabelSample | RawSample) -> None:
    """BadInput where a sample has numbers beyond the limits of a log, as in another unit, or a label that pulls."""
    if isinstance(sample, RawSample):
        numbers = {field: (column, sample.values[column]) for field, column in (POSE_FIELDS | FORCE_FIELDS).items()}
    else:
        totals = exchanged(sample.label).sum((1, 2)).tolist()
        numbers = {field: (FORCE_FIELDS[field], total) for field, total in zip(TOTALS, totals, strict=True)}
    for field, (column, value) in numbers.items():
        fault = size_fault(column, value)
        if isinstance(sample, LabelSample) and column == "fz_n":
            fault = fault or pull_fault(value)
        if fault:
            raise BadInput(f"{path}: field {field} is {value:g}, {fault[0]}; {fault[1]}")


def _take(path, sample, sensor, part, presses, labels) -> None:
    height, width = sample.image.shape[:2]
    if (width, height) != tuple(sensor.image):
        raise BadInput(
            f"{path}: field gs_img is {width} x {height} pixels, sensor {sensor.name} has"
            f" {sensor.image[0]} x {sensor.image[1]}; import it with its own SENSOR, or resize it"
        )
    refuse_beyond_limits(path, sample)
    key = hashlib.sha256(np.ascontiguousarray(sample.image).tobytes()).hexdigest()
    if key not in presses:
        name = re.sub(r"[^A-Za-z0-9_-]", "_", path.stem)[:100].lstrip("_-") or "sample"
        if split_of(path.parent.name) and (part / "images" / f"{name}.png").exists():
            name = f"{path.parent.name}-{name}"[:100]  # files of different splits may share a name
        presses[key] = {"files": [], "row": {"sample_id": name, "image": f"images/{name}.png"}, "raw": False}
        target = part / "images" / f"{name}.png"
        target.parent.mkdir(exist_ok=True)
        if target.exists():
            raise BadInput(
                f"{path}: another file of that name was imported; names become sample_id, so make them differ"
            )
        write_png(target, sample.image)
    press = presses[key]
    press["files"].append(path)
    if isinstance(sample, LabelSample):
        grid = labels.setdefault(sample.label.shape[1:], {})
        if key in grid:
            raise BadInput(
                f"{path}: has the same image as a label file read before ({press['files'][0]}); remove one of them"
            )
        grid[key] = sample.label.astype(np.float32)
        press["pressed_n"] = float(np.abs(sample.label).sum())
    else:
        _take_raw(path, sample, press)


def write_nocontact(part: Path, presses: dict) -> None:
    """Write nocontact/SENSOR.png of each sensor with enough labelled images.

    It is the pixel-wise median of the images whose label is zero everywhere, else of those with the least force,
    where each pixel is in contact in few of them.
    """
    by_sensor: dict[str, list] = {}
    for press in presses.values():
        if "pressed_n" in press:
            by_sensor.setdefault(press["row"]["sensor_id"], []).append((press["pressed_n"], press["row"]["image"]))
    for name, found in by_sensor.items():
        least = sorted(found)[:QUIETEST]
        still = [image for pressed, image in least if pressed == 0.0]
        if not still and len(least) < FEWEST_QUIET:
            continue
        pictures = [read_image(part / image) for image in still or [image for _, image in least]]
        (part / "nocontact").mkdir(exist_ok=True)
        write_png(part / "nocontact" / f"{name}.png", np.median(pictures, axis=0).astype(np.uint8))


def _take_raw(path, sample: RawSample, press) -> None:
    if press["raw"]:
        raise BadInput(f"{path}: has the same image as {press['files'][0]}; remove one of them")
    press["row"].update(sample.values, time_utc=_time(path.stem))
    press["raw"] = True


def _time(stem: str) -> str:
    """The recording time in a file name of FEATS, which has no time zone, taken as UTC; empty for other names."""
    try:
        return datetime.strptime(stem, "%Y%m%d-%H%M%S").strftime("%Y-%m-%dT%H:%M:%SZ")
    except ValueError:
        return ""


def _write_grid(path, members, presses) -> None:
    order = sorted(members, key=lambda key: presses[key]["row"]["sample_id"])
    arrays = {
        "sample_id": np.array([presses[key]["row"]["sample_id"] for key in order]),
        "status": np.array(["OK"] * len(order)),
        "outside": np.full((len(order), 3), np.nan),  # FEATS does not say what it left out
        "c10": np.float64(FEATS_C10),
    }
    shape = (len(order), *members[order[0]].shape)
    write_labels(path, (members[key][None] for key in order), shape, arrays)


def export_dataset(dataset: Path, out: Path) -> dict:
    """Write a dataset of stage 60 as FEATS' label folders: out/SPLIT/ID.npy; return the training ranges.

    Ranges cover the training split, as in FEATS' normalize.py. Label files of an earlier export that this one does
    not write are deleted, or a sample whose split changed would be both in training and test. BadInput where the
    dataset has no training samples.
    """
    samples = read_samples(dataset / "samples.csv")
    images, labels = (map_array(dataset / f"{name}.npy") for name in ("images", "labels"))
    ranges, written = Ranges(), set()
    for at, each in tqdm(list(enumerate(samples)), "export"):
        sample = LabelSample(np.asarray(images[at]), np.asarray(labels[at], np.float64))
        if each.split == TRAINING:
            ranges.add(sample)
        path = out / check_id(each.split) / f"{each.press.sample_id}.npy"
        write_label(path, sample)
        written.add(path)
    ours, splits = {each.press.sample_id for each in samples}, {*SPLITS, *(each.split for each in samples)}
    for path in set(out.glob("*/*.npy")) - written:
        if path.parent.name in splits or path.stem in ours:  # the split it had then may no longer exist
            path.unlink()
    if not ranges.found:
        raise BadInput(f"{dataset}: has no training samples, so there is nothing to normalise by; add presses")
    return ranges.found
