"""Stage 60: images and labels as arrays ready to train on, with a split without leaks and normalisation."""

import hashlib
import os
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish, read_csv, read_json, write_csv, write_json
from gelforge.flow.main import command, option
from gelforge.flow.progress import progress
from gelforge.formats.feats import LabelSample, Ranges
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import find_sensor, load_sensors
from gelforge.networks.split import split_presses
from gelforge.records.labelfile import CHANNELS, read_labels
from gelforge.records.status import Status
from gelforge.stages.plan import planned_shards

VERSION = 2
POSE_COLUMNS = ["x0_mm", "y0_mm", "z0_mm", "dx_mm", "dy_mm", "dz_mm", "rot_deg"]
FORCES = ["fx_n", "fy_n", "fz_n"]
COLUMNS = [
    "sample_id",
    "indenter",
    "sensor_id",
    "gel_id",
    "split",
    "group",
    *FORCES,
    *(f"outside_{name}" for name in FORCES),
    *(f"measured_{name}" for name in FORCES),
    *(f"true_{name}" for name in FORCES),
    *POSE_COLUMNS,
    "image",
]


def collect(shards: list[tuple[Path, list[dict]]], truth: dict) -> tuple[list[dict], list, dict]:
    """Rows of samples.csv, where each one's label lies, and what was left out and why.

    shards: label files with the rows of their samples (a pose table or a log). Returns rows (n,), (file
    number, index in it) (n,), and {reason: count}.
    """
    rows, places, left_out = [], [], {}
    for number, (path, table) in enumerate(shards):
        by_id = {row["sample_id"]: row for row in table}
        found = read_labels(path)
        totals = found["label"].sum(axis=(2, 3), dtype=np.float64)
        for at, (name, status) in enumerate(zip(found["sample_id"], found["status"], strict=True)):
            row, status = by_id.get(str(name)), str(status)
            reason = _reason(row, status)
            if reason:
                left_out[reason] = left_out.get(reason, 0) + 1
                continue
            rows.append(_sample_row(row, totals[at], found["outside"][at], truth.get(str(name), {})))
            places.append((number, at))
    return rows, places, left_out


def _reason(row, status) -> str:
    if not Status[status].valid:
        return status
    if row is None:
        return "no row in the pose table"
    return "" if row.get("image") else "no image in the log"


def _sample_row(row, total, outside, true) -> dict:
    kept = {
        name: row.get(name, "") for name in ("sample_id", "indenter", "sensor_id", "gel_id", *POSE_COLUMNS, "image")
    }
    for channel, axis in enumerate(CHANNELS):
        kept[FORCES[axis]] = round(float(total[channel]), 9)
        kept[f"outside_{FORCES[axis]}"] = "" if np.isnan(outside[channel]) else round(float(outside[channel]), 9)
    for name in FORCES:
        kept[f"measured_{name}"], kept[f"true_{name}"] = row.get(name, ""), true.get(name, "")
    return kept


def read_truth(data: Path) -> dict:
    """True resultants (fx_n, fy_n, fz_n) by sample_id where a virtual rig left them; only evaluation compares."""
    path = data / "truth" / "presses.csv"
    return {row["sample_id"]: row for row in read_csv(path)} if path.exists() else {}


def unseen_indenters(catalogue: dict, settings: dict) -> set[str]:
    """Indenters kept out of training: marked `seen = false` in the catalogue, or named in the parameters."""
    marked = {name for name, table in catalogue.items() if isinstance(table, dict) and table.get("seen") is False}
    return marked | set(settings["unseen_indenters"])


def check_settings(settings: dict) -> None:
    """Raise BadInput for shares that are none, and for force edges that do not rise."""
    shares = settings["validation"], settings["test"]
    if not all(0 <= share < 1 for share in shares) or sum(shares) >= 1:
        raise BadInput(
            f"[dataset] validation = {shares[0]} and test = {shares[1]}: shares from 0 that leave some to train"
        )
    edges = settings["force_edges"]
    if list(edges) != sorted(set(edges)):
        raise BadInput(f"[dataset] force_edges = {edges}: write rising numbers of newtons")
    if not (settings["same_press_mm"] > 0 and settings["same_press_deg"] > 0):
        raise BadInput("[dataset] same_press_mm and same_press_deg must be above 0")


def write_image_array(path, data: Path, rows: list[dict], size: tuple[int, int]) -> None:
    """Write the images of `rows` as uint8 (n, height, width, 3) RGB, whole or not at all.

    size is (width, height). A missing, unreadable or differently sized image raises BadInput.
    """
    with publish(path) as part:
        images = np.lib.format.open_memmap(part, "w+", np.uint8, (len(rows), size[1], size[0], 3))
        for at, row in progress(list(enumerate(rows)), "images"):
            images[at] = read_image(data, row["image"], size)
        images.flush()


def read_image(data: Path, name: str, size: tuple[int, int]) -> np.ndarray:
    """One image of a dataset folder as RGB (height, width, 3)."""
    import cv2

    path = (data / name).resolve()
    if not path.is_relative_to(data.resolve()):
        raise BadInput(f"{data}/log.csv: image {name!r} leads out of the dataset's folder; give a path inside it")
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise BadInput(f"{path}: image is missing or unreadable; restore it, or empty the log's column `image`")
    if (image.shape[1], image.shape[0]) != tuple(size):
        raise BadInput(
            f"{path}: image is {image.shape[1]} x {image.shape[0]} pixels, its sensor has {size[0]} x {size[1]};"
            " resize it, or correct `image` in workflow/sensors.toml"
        )
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def write_nocontact(path, data: Path, names: list[str], size: tuple[int, int]) -> list[str]:
    """Write the pictures of untouched sensors, nocontact/NAME.png, as uint8 (k, height, width, 3) RGB.

    Returns the k of `names` that have one; a network that reads differences needs them, no other does.
    """
    there = [name for name in names if (data / "nocontact" / f"{name}.png").exists()]
    pictures = [read_image(data, f"nocontact/{name}.png", size) for name in there]
    with publish(path) as part, part.open("wb") as stream:
        np.save(stream, np.array(pictures, np.uint8).reshape(len(there), size[1], size[0], 3))
    return there


def share_images(folder: Path, data: Path, rows: list[dict], size) -> None:
    """Put images.npy into `folder` as a hard link to one copy that all resolutions of the dataset share."""
    digest = hashlib.sha256(str(size).encode())
    for row in rows:
        path = data / row["image"]
        stamp = path.stat().st_mtime_ns if path.exists() else 0
        digest.update(f"{row['sample_id']} {row['image']} {stamp}\n".encode())
    shared = folder.parent / f"images-{digest.hexdigest()[:16]}.npy"
    if not shared.exists():
        write_image_array(shared, data, rows, size)
    with publish(folder / "images.npy") as part:
        os.link(shared, part)
    for other in folder.parent.glob("images-*.npy"):
        if other.stat().st_nlink == 1:
            other.unlink(missing_ok=True)


def write_label_array(path, shards, places, grid: Grid) -> None:
    """Write the labels at `places` as float32 (n, 3, rows, cols), whole or not at all."""
    with publish(path) as part:
        labels = np.lib.format.open_memmap(part, "w+", np.float32, (len(places), 3, *grid.shape))
        opened, array = None, None
        for at, (number, index) in enumerate(places):
            if number != opened:
                opened, array = number, read_labels(shards[number][0], ["label"])["label"]
            if array.shape[2:] != grid.shape:
                raise BadInput(
                    f"{shards[number][0]}: labels of {array.shape[2:]} cells, asked for {grid}; make labels again"
                )
            labels[at] = array[index]
        labels.flush()


def training_ranges(folder: Path, rows: list[dict]) -> dict:
    """Smallest and largest value of every field over the training split, as FEATS' normalisation has them."""
    images, labels = (np.load(folder / name, mmap_mode="r") for name in ("images.npy", "labels.npy"))
    ranges = Ranges()
    for at, row in enumerate(rows):
        if row["split"] == "train":
            ranges.add(LabelSample(images[at], labels[at]))
    return ranges.found


def image_size(rows: list[dict], sensors: dict, where: str) -> tuple[int, int]:
    """The one image size of all samples' sensors; several raise BadInput."""
    sizes = {}
    for name in sorted({row["sensor_id"] for row in rows}):
        sizes.setdefault(tuple(find_sensor(sensors, name, where).image), name)
    if len(sizes) > 1:
        seen = ", ".join(f"{name} {w} x {h}" for (w, h), name in sizes.items())
        raise BadInput(f"{where}: sensors with images of several sizes ({seen}); make one dataset for each size")
    return next(iter(sizes))


def list_shards(args) -> list[tuple[Path, list[dict]]]:
    """Label files with their samples' rows: a stage-50 folder with pose tables, or an imported file with the log."""
    if args.labels.is_dir():
        names = planned_shards(args.shards)
        return [(args.labels / f"{name}.npz", read_csv(args.poses / f"{name}.csv")) for name in names]
    return [(args.labels, read_csv(args.data / "log.csv"))]


def describe(args, grid: Grid, rows, left_out, size, first_labels: Path) -> dict:
    """Contents of dataset.json."""
    about = read_labels(first_labels)
    material = {name: about[name].tolist() for name in about if name.startswith("c10")}
    counts = {}
    for row in rows:
        counts[row["split"]] = counts.get(row["split"], 0) + 1
    return {
        "name": args.data.name,
        "grid": list(grid.shape),
        "image": list(size),
        "samples": len(rows),
        "splits": counts,
        "sensor": rows[0]["sensor_id"],
        "sensors": sorted({row["sensor_id"] for row in rows}),
        "indenters": sorted({row["indenter"] for row in rows}),
        "left_out": left_out,
        **material,
    }


def build(args) -> dict:
    """Write the arrays and tables of one resolution beside args.out; return the contents of dataset.json."""
    grid, settings = Grid.parse(args.resolution), read_json(args.params)["dataset"]
    check_settings(settings)
    shards = list_shards(args)
    rows, places, left_out = collect(shards, read_truth(args.data))
    if not rows:
        raise BadInput(
            f"{args.data}: no sample has both a label and an image (left out: {left_out or 'none'});"
            " look at make status"
        )
    size = image_size(rows, load_sensors(args.sensors), f"{args.data}/log.csv")
    splits, groups = split_presses(
        rows, _strength(rows), unseen_indenters(read_json(args.catalogue), settings), settings
    )
    for row, split, group in zip(rows, splits, groups, strict=True):
        row["split"], row["group"] = str(split), int(group)
    folder = args.out.parent
    write_label_array(folder / "labels.npy", shards, places, grid)
    share_images(folder, args.data, rows, size)
    write_csv(folder / "samples.csv", COLUMNS, rows)
    write_csv(
        folder / "split.csv",
        ["sample_id", "group", "split"],
        [{name: row[name] for name in ("sample_id", "group", "split")} for row in rows],
    )
    write_json(folder / "normalisation.json", training_ranges(folder, rows))
    about = describe(args, grid, rows, left_out, size, shards[0][0])
    return about | {"nocontact": write_nocontact(folder / "nocontact.npy", args.data, about["sensors"], size)}


def _strength(rows) -> np.ndarray:
    """Normal force of each press to a millinewton, the part outside the image included: alike at every resolution."""
    return np.array([round(abs(row["fz_n"] + (row["outside_fz_n"] or 0.0)), 3) for row in rows])


@command(
    option("--data", type=Path, help="data/DATASET"),
    option("--labels", type=Path, help="50_labels/RES, or an imported labels/RES.npz"),
    option("--poses", type=Path, help="folder 10_poses"),
    option("--shards", type=Path, help="folder of planned shards"),
    option("--catalogue", type=Path, help="slice of the indenter catalogue, .json"),
    option("--sensors", type=Path),
    option("--resolution", help="ROWSxCOLS"),
    option("--params", type=Path),
    option("--out", type=Path, help="60_dataset/RES/dataset.json, written last"),
)
def main(args: Namespace) -> None:
    about = build(args)
    write_json(args.out, about)
    print(f"{about['samples']} samples: {about['splits']}; left out: {about['left_out'] or 'none'}")


if __name__ == "__main__":
    main.exit()
