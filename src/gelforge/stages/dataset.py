"""Stage 60: images and labels as arrays for training, with splits without leaks."""

import hashlib
import shutil
import sys
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.evidence.forces import LogForces
from gelforge.evidence.images import row_list
from gelforge.evidence.labels import of_labels, refuse_unseen
from gelforge.evidence.leaning import tilt_notes
from gelforge.evidence.logimages import LogImages
from gelforge.flow.cli import stage
from gelforge.flow.files import alone, digest_of, link_or_copy, listed, publish, read_json, write_csv, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import read_parameters
from gelforge.flow.tables import DatasetTable
from gelforge.geometry.indenters import fold
from gelforge.labelling.grid import Grid
from gelforge.labelling.moment import Arms
from gelforge.labelling.sensor import Sensor, find_sensor, load_sensors
from gelforge.learning.pictures import PICTURES, write_pairs
from gelforge.learning.split import split_presses
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.records.image import read_logged_image
from gelforge.records.labelfile import FIELDS, open_labels, read_labels
from gelforge.records.log import read_poses, read_shard, without_duplicates
from gelforge.records.press import FORCE, ID_RULE, N_M, PressRecord, describe_repeats, names_files, parse, repeats
from gelforge.records.rowfile import RowFile, array_on_disk, write_rows
from gelforge.records.samplefile import SPLITS, DatasetSample, write_samples
from gelforge.records.status import Status
from gelforge.records.table import TableRows, letters, read_table

VERSION = 13
NO_IMAGE = "no image in the log"
WRONG_IMAGE = "its image is not of this press"


# Moment (3,) N mm of a label (3, rows, cols) N of the sensor of that name, on a gel of a material.
MomentOf = Callable[[str, np.ndarray, Mapping[str, Any]], np.ndarray]


def collect(
    shards: list[tuple[Path, list]], truth: dict, wrong_images: Mapping[str, str], moment_of: MomentOf
) -> tuple[list[DatasetSample], list, dict, dict]:
    """Samples with label and image, the places of their labels, counts of those left out, the first shard's material.

    shards: label files, each with the presses of its samples, from a pose table or a log. wrong_images: samples to
    leave out. A place is (file number, index in the file). Samples left out are counted by reason. moment_of: gives the
    moment of a label that was imported without one.
    """
    found: list[DatasetSample] = []
    places: list[tuple[int, int]] = []
    left_out: dict[str, int] = {}
    material: dict = {}
    for number, (path, presses) in enumerate(shards):
        by_id = {press.sample_id: press for press in presses}
        labels = read_labels(path)
        material = material or labels.material
        totals = labels.label.sum(axis=(2, 3), dtype=np.float64)
        for at, (name, status) in enumerate(zip(labels.sample_id.tolist(), labels.status, strict=True)):
            press = by_id.get(name)
            reason = _reason(press, status) or (WRONG_IMAGE if name in wrong_images else "")
            if reason or press is None:
                left_out[reason] = left_out.get(reason, 0) + 1
                continue
            moment, beyond = labels.moment[at], labels.outside_moment[at]
            if np.isnan(moment).any():
                moment = moment_of(press.sensor_id, labels.label[at], labels.material)
            wrench = np.concatenate([totals[at], N_M * moment])
            found.append(
                DatasetSample(press, wrench, np.concatenate([labels.outside[at], N_M * beyond]), truth.get(name, {}))
            )
            places.append((number, at))
    return found, places, left_out, material


def moments_by_cells(sensors: dict[str, Sensor], grid: Grid, where: str) -> MomentOf:
    """Moments of labels from their cells."""
    arms = lru_cache(None)(lambda name: Arms(find_sensor(sensors, name, where), grid))
    return lambda name, label, material: arms(name).moment(label, material.get("c10", REFERENCE_C10))


def _reason(press: PressRecord | None, status: Status) -> str:
    if not status.valid:
        return status.name
    if press is None:
        return "no row in the pose table"
    return "" if press.image else NO_IMAGE


def read_truth(data: Path) -> dict:
    """True total forces (fx_n, fy_n, fz_n) by sample_id, if a virtual rig wrote them; only evaluation uses them."""
    path = data / "truth" / "presses.csv"
    needed = ("sample_id", *FORCE)
    rows = read_table(path, "write it again, or remove it", needed) if path.exists() else []
    return {row["sample_id"]: row for row in rows}


def unseen_indenters(catalogue: dict, settings: DatasetTable) -> set[str]:
    """Indenters kept out of training: marked `seen = false` in the catalogue, or named in the parameters."""
    marked = {name for name, table in catalogue.items() if table.get("seen") is False}
    return marked | set(settings.unseen_indenters)


def share_pictures(folder: Path, data: Path, presses: list[PressRecord], size: tuple[int, int]) -> list[str]:
    """Put the files of `learning.pictures` into `folder`, from one copy that all resolutions of the dataset share.

    size: (width, height) of the images. Returns the sensors that have a no-contact image. Resolutions may be made in
    parallel: the first writes the copy, and the others wait for it.
    """
    with alone(folder.parent / "pictures"):
        return _share_pictures(folder, data, presses, size)


def _share_pictures(folder: Path, data: Path, presses: list[PressRecord], size: tuple[int, int]) -> list[str]:
    sensors = sorted({press.sensor_id for press in presses})
    rests = [name for name in sensors if (data / "nocontact" / f"{name}.png").exists()]
    digest = hashlib.sha256(f"{VERSION} {size}".encode())
    named = [(press.sample_id, press.image) for press in presses] + [
        (name, f"nocontact/{name}.png") for name in rests
    ]
    for name, image in named:
        path = data / image
        state = path.stat() if path.exists() else None
        stamp = f"{state.st_mtime_ns} {state.st_size}" if state else "absent"
        digest.update(f"{name} {image} {stamp}\n".encode())
    shared = folder.parent / f"pictures-{digest.hexdigest()[:16]}"
    for left in folder.parent.glob("pictures-*/"):
        if left != shared:  # of other images, or left by a make that was killed
            shutil.rmtree(left)
    noted = shared / "sha256.json"
    # a copy that has become corrupt must not be used again
    if not (noted.exists() and read_json(noted) == {name: digest_of(shared / name) for name in PICTURES}):
        shutil.rmtree(shared, ignore_errors=True)
        shared.mkdir()
        write_pictures(shared, data, presses, rests, size)
        write_json(noted, {name: digest_of(shared / name) for name in PICTURES})
    for name in PICTURES:
        with publish(folder / name) as part:
            link_or_copy(shared / name, part)
    return rests


def write_pictures(
    folder: Path, data: Path, presses: list[PressRecord], rests: list[str], size: tuple[int, int]
) -> None:
    """Write the files of `learning.pictures`; rests: names of sensors with a no-contact image.

    A missing, unreadable or differently sized image raises BadInput.
    """
    images = (read_logged_image(data, press.image, size) for press in tqdm(presses, "images"))
    write_rows(folder / "images.npy", np.uint8, (len(presses), size[1], size[0], 3), images)
    pictures = {
        name: read_logged_image(data, f"nocontact/{name}.png", size, "restore it, or remove it") for name in rests
    }
    shown = RowFile(folder / "images.npy")
    write_pairs(folder, shown, [press.sensor_id for press in tqdm(presses, "pairs")], pictures)


def repeated_pictures(
    path: Path, presses: list[PressRecord], every: list, data: Path, size: tuple[int, int], where: str
) -> list[list[int]]:
    """Groups of `every` press of the log, by number, whose images are equal in every pixel; a note reports them.

    path: the array of the images of `presses`, which have labels; the images of others lie in `data`. Labels of such
    presses contradict each other, and across splits one would leak.
    """
    images = RowFile(path)
    known = {press.sample_id: _digest_of(images[at]) for at, press in enumerate(presses)}
    digests = [known.get(press.sample_id) or _digest_of_file(data, press, size) for press in every]
    found = repeats(every, digests)
    labelled = repeats(presses, [known[press.sample_id] for press in presses])
    if labelled:
        text, hint = describe_repeats(where, presses, labelled), "give each press its own picture, or remove its row"
        print(
            f"note: {text}; all presses of one picture go to one split. Did the camera freeze? If so, {hint}",
            file=sys.stderr,
        )
    return found


def _digest_of(image: np.ndarray) -> bytes:
    return hashlib.blake2b(image.tobytes(), digest_size=16).digest()


def _digest_of_file(data: Path, press: PressRecord, size: tuple[int, int]) -> bytes:
    """Digest of the image of a press without label; of its name where it has none, as no other press shows that."""
    try:
        return _digest_of(read_logged_image(data, press.image, size))
    except BadInput:
        return press.sample_id.encode()


def write_label_array(path, shards, places, grid: Grid, name: str = "label") -> None:
    """Write the labels at `places`, or a field beside them, as float32 (n, …, rows, cols), whole or not at all."""
    with publish(path) as part:
        opened = places[0][0]
        array = _read_array(shards[opened][0], name, grid)
        written = array_on_disk(part, np.float32, (len(places), *array.shape[1:]))
        for at, (number, index) in enumerate(places):
            if number != opened:
                opened, array = number, _read_array(shards[number][0], name, grid)
            written[at] = array[index]
        written.flush()


def _read_array(path: Path, name: str, grid: Grid) -> np.ndarray:
    with open_labels(path) as file:
        array = file[name]
    if array.shape[-2:] != grid.shape:
        raise BadInput(f"{path}: labels of {array.shape[-2:]} cells, asked for {grid}; make labels again")
    return array


def write_fields(folder: Path, shards, places, grid: Grid) -> None:
    """Write what the labels hold beside forces, one array each; arrays of what they no longer hold are removed."""
    with open_labels(shards[places[0][0]][0]) as file:
        held = [name for name in FIELDS if name in file]
    for name in FIELDS:
        if name in held:
            write_label_array(folder / f"{name}.npy", shards, places, grid, name)
        else:
            (folder / f"{name}.npy").unlink(missing_ok=True)


def image_size(presses: list[PressRecord], sensors: dict, where: str) -> tuple[int, int]:
    """The image size that the sensors of all samples share; several sizes raise BadInput."""
    sizes: dict[tuple[int, int], str] = {}
    for name in sorted({press.sensor_id for press in presses}):
        width, height = find_sensor(sensors, name, where).image
        sizes.setdefault((width, height), name)
    if len(sizes) > 1:
        seen = ", ".join(f"{name} {w} x {h}" for (w, h), name in sizes.items())
        raise BadInput(f"{where}: sensors with images of several sizes ({seen}); make one dataset for each size")
    return next(iter(sizes))


def list_shards(of: Layout, resolution: str) -> list[tuple[Path, list]]:
    """Label files with their presses: those of stage 50 with the pose tables, or an imported file with the log."""
    imported = of.data / "labels" / f"{resolution}.npz"
    if not imported.parent.is_dir():
        return [(of.labels(resolution, name), read_poses(of.poses(name))) for name in of.names()]
    # an image imported with its label may have no pose
    rows = [row for name in of.names() for row in read_shard(of.shard(name))]
    rows.sort(key=lambda row: row.row)
    parsed = [parse(raw, str(of.log), ("sample_id", "sensor_id", "image")) for raw in rows]
    presses, doubled = without_duplicates([press for press, _ in parsed if press], str(of.log))
    for rejection in [*(r for _, wrong in parsed for r in wrong), *doubled]:
        print(rejection, file=sys.stderr)
    return [(imported, presses)]


def wrong_imported(of: Layout, presses: list[PressRecord]) -> dict[str, str]:
    """Why images of imported samples are not of their sensors, by sample; stage 15, which needs poses, skips them."""
    images = LogImages(of.data, load_sensors(of.parameters("sensors")))
    found = {press.sample_id: fault for press in tqdm(presses, "images judged") if (fault := images.fault(press))}
    for fault in sorted(set(found.values())):
        rows = [press.row for press in presses if found.get(press.sample_id) == fault]
        print(f"rejected: {fault} (row {row_list(rows)})", file=sys.stderr)
    return found


def doubts_of_forces(found: Sequence[DatasetSample], material: Mapping) -> list[str]:
    """Doubts from comparing the log's force readings with the labels of their presses, in the order of the log."""
    ordered = sorted(found, key=lambda each: each.press.row)
    presses = [each.press for each in ordered]
    log = LogForces(
        path=np.array([(press.dx_mm, press.dy_mm) for press in presses]),
        depth=np.array([-press.dz_mm for press in presses]),
        rot_deg=np.array([press.rot_deg for press in presses]),
        force=np.array([press.force for press in presses], float),
    )
    labels = np.array([each.total + np.nan_to_num(each.outside[:3]) for each in ordered])
    usual = REFERENCE_C10 / material["c10"] if "c10" in material else 1.0
    return of_labels(log, labels, [press.indenter for press in presses], usual)


def camera(sensor: Sensor) -> dict[str, Any]:
    """What places the cells of a sensor's maps on its gel, as a table of sensors.toml."""
    return {"gel": sensor.gel, "image": list(sensor.image), "projection": sensor.projection.tolist()}


def describe(name: str, grid: Grid, found: list[DatasetSample], splits, left_out, size, material: dict) -> dict:
    """Contents of dataset.json."""
    names, counts = np.unique(splits, return_counts=True)
    return {
        "name": name,
        "grid": list(grid.shape),
        "image": list(size),
        "samples": len(found),
        "splits": dict(zip(names.tolist(), counts.tolist(), strict=True)),
        "sensor": found[0].press.sensor_id,
        "sensors": sorted({each.press.sensor_id for each in found}),
        "indenters": sorted({each.press.indenter for each in found}),
        "left_out": left_out,
        **material,
    }


def published_splits(
    data: Path, presses: list, splits: np.ndarray, repeated: Sequence[Sequence[int]] = ()
) -> np.ndarray:
    """The splits (n,) that an imported dataset brings in data/DATASET/splits.csv, else the given ones.

    repeated: groups of presses, by number, with equal images; BadInput if a group lies in two splits.
    """
    path = data / "splits.csv"
    if not path.exists():
        return splits
    rows = TableRows.read(path, "write it again, or remove it to make new splits", ("sample_id", "split"))
    for at, row in rows:
        if not names_files(row["split"]):
            raise BadInput(f"{path}: row {at}: split {row['split'][:100]!r} is not a name; give {ID_RULE}")
        if row["split"] not in SPLITS and (plain := letters(row["split"])) in SPLITS:
            raise BadInput(f"{path}: row {at}: split {row['split']!r} is none of networks' splits; write {plain}")
    known: dict[str, str] = {}
    for at, row in rows:
        if known.setdefault(row["sample_id"], row["split"]) != row["split"]:
            raise BadInput(
                f"{path}: row {at}: sample {row['sample_id'][:100]!r} is in two splits; leave one of both rows"
            )
    missing = [press.sample_id for press in presses if press.sample_id not in known]
    if missing:
        raise BadInput(f"{path}: has no split of sample {missing[0]}; add it, or remove the file to make new splits")
    found = np.array([known[press.sample_id] for press in presses])
    refuse_torn_presses(path, presses, found)
    for members in repeated:
        other = next((at for at in members if found[at] != found[members[0]]), None)
        if other is not None:
            first, second = (f"{presses[at].sample_id} ({found[at]})" for at in (members[0], other))
            raise BadInput(
                f"{path}: the images of {first} and {second} are equal, but in two splits; give both the same, or remove"
                " the file to make new splits"
            )
    return found


def refuse_torn_presses(path: Path, presses: list, splits: np.ndarray) -> None:
    """BadInput if images of one press lie in two splits (n,): networks would be tested on a press they learnt from.

    Images of different sensors may lie in different splits, as when a sensor is kept for a test.
    """
    seen: dict[tuple[str, str], tuple[str, str]] = {}
    for press, split in zip(presses, splits.tolist(), strict=True):
        if not press.press_id:
            continue
        first, of = seen.setdefault((press.press_id, press.sensor_id), (press.sample_id, split))
        if of != split:
            raise BadInput(
                f"{path}: samples {first} and {press.sample_id} are of one press, {press.press_id}, but in the splits"
                f" {of} and {split}; give both the same"
            )


def group_names(presses: Sequence[PressRecord], groups: np.ndarray) -> np.ndarray:
    """Names (n,) of groups (n,): the sample_id of the first press of each, which no later press changes."""
    _, first, number = np.unique(groups, return_index=True, return_inverse=True)
    return np.array([press.sample_id for press in presses])[first][number.ravel()]


def among(groups: list[list[int]], places: list[int]) -> list[list[int]]:
    """Groups of numbers of all presses as groups of those at `places`; single ones are left out."""
    number = {place: at for at, place in enumerate(places)}
    found = [[number[one] for one in members if one in number] for members in groups]
    return [members for members in found if len(members) > 1]


def nothing_left(of: Layout, left_out: dict) -> str:
    """Why no sample has both a label and an image, and what to do."""
    if left_out.keys() == {NO_IMAGE}:
        return (
            f"{of.log}: names no images, so that its flow ends at labels: run {of.command('labels')}, or write each press's"
            " image into the column image"
        )
    why = f"left out: {counted(left_out)}" if left_out else "there are no labels"
    return f"{of.data}: no sample has both a label and an image ({why}); look at {of.command('status')}"


def counted(found: dict) -> str:
    """Counts by name, in words."""
    return ", ".join(f"{count} x {name}" for name, count in found.items()) or "none"


def build(args: Namespace) -> dict:
    """Write the arrays and tables of one resolution beside args.out; return the contents of dataset.json."""
    of, folder = args.of, args.out.parent
    params = read_parameters(of.parameters("dataset"))
    grid, settings = Grid.parse(args.resolution), params.dataset
    shards = list_shards(of, args.resolution)
    wrong_images: dict[str, str] = {}
    judged: dict[str, Any] = {}
    if not (of.data / "labels").is_dir():
        pictured = any(press.image for _, presses in shards for press in presses)
        judged = read_json(of.images()) if pictured else {}
        wrong_images = judged.get("left_out", {})
    elif params.poses.judge_images:
        wrong_images = wrong_imported(of, [press for _, presses in shards for press in presses])
    sensors = load_sensors(of.parameters("sensors"))
    by_cells = moments_by_cells(sensors, grid, str(of.log))
    found, places, left_out, material = collect(shards, read_truth(of.data), wrong_images, by_cells)
    if not found:
        raise BadInput(nothing_left(of, left_out))
    presses = [each.press for each in found]
    inside, outside = (np.array([getattr(each, name)[2] for each in found]) for name in ("total", "outside"))
    refuse_unseen([press.sensor_id for press in presses], inside, np.nan_to_num(outside), of.parameters("sensors"))
    size = image_size(presses, sensors, str(of.log))
    rests = share_pictures(folder, of.data, presses, size)
    # all presses of the log are split, those without label too, so that one that is solved later moves no other
    every = [press for _, each in shards for press in each]
    repeated = repeated_pictures(folder / "images.npy", presses, every, of.data, size, str(of.log))
    catalogue = {
        name: table for name, table in read_json(of.parameters("indenters")).items() if isinstance(table, dict)
    }
    folds = {name: fold(table) for name, table in catalogue.items()}
    splits, groups = split_presses(every, unseen_indenters(catalogue, settings), folds, settings, repeated)
    place = {press.sample_id: at for at, press in enumerate(every)}
    mine = np.array([place[press.sample_id] for press in presses])
    splits, groups, repeated = splits[mine], group_names(every, groups)[mine], among(repeated, mine.tolist())
    splits = published_splits(of.data, presses, splits, repeated)
    write_label_array(folder / "labels.npy", shards, places, grid)
    write_fields(folder, shards, places, grid)
    found = [replace(each, split=str(s), group=str(g)) for each, s, g in zip(found, splits, groups, strict=True)]
    write_samples(folder / "samples.csv", found)
    short = ("sample_id", "group", "split")
    write_csv(folder / "split.csv", short, [{name: each.cells()[name] for name in short} for each in found])
    about = describe(of.data.name, grid, found, splits, left_out, size, material)
    about["cameras"] = {name: camera(sensors[name]) for name in about["sensors"]}
    about |= {"repeated_pictures": len(repeated)} if repeated else {}
    about["doubts_of_forces"] = doubts_of_forces(found, material) + tilt_notes(
        judged.get("tilts", []), every, sensors
    )
    for doubt in about["doubts_of_forces"]:
        print(f"note: {of.log}: {doubt}", file=sys.stderr)
    return about | {"nocontact": rests}


@stage(Layout.dataset_table)
def main(args: Namespace) -> None:
    about = build(args)
    beside = [path for path in listed(args.out.parent, "*") if path.suffix in (".npy", ".csv")]
    write_json(args.out, about | {"sha256": {path.name: digest_of(path) for path in beside}})
    print(f"{about['samples']} samples: {counted(about['splits'])}; left out: {counted(about['left_out'])}")


if __name__ == "__main__":
    main.exit()
