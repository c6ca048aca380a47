"""Datasets of stage 60 as training and evaluation read them: one, or several concatenated."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.layout import command_for
from gelforge.labelling.sensor import Sensor, gelsight_mini, sensor_of
from gelforge.learning.pictures import PICTURES
from gelforge.learning.split import drawn
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.records.press import N_M, PressRecord
from gelforge.records.rowfile import ChainedRows, RowFile, Rows, map_array
from gelforge.records.samplefile import TRAINING, UNSEEN_BOTH, UNSEEN_SENSOR, VALIDATION, DatasetSample, read_samples

FILES = (*PICTURES, "labels.npy", "samples.csv", "dataset.json")
ONE_CELL = (1, 1)  # the grid of a label that is the total force alone
LEAST_TOTAL = 0.01  # least scale of a component's total force, as a fraction of the largest component's
CHUNK = 256  # rows read at a time
FEWEST_EACH = 9  # fewest validation presses for model selection, and as many for calibrating intervals
HALVES = 2  # seed of the hash that parts validation presses and unseen sensors
# Fewest samples for batch statistics (train) and for an error (val).
SMALLEST = {TRAINING: 4, VALIDATION: 1}


@dataclass(frozen=True)
class Data:
    """One dataset of stage 60, its arrays on disk.

    images, pairs (n, height, width, 3) uint8 RGB, rests (m, height, width, 3) and beside (n,): learning.pictures; labels (n, 3, rows, cols) float32 N per cell along
    gel x, y, z; table has one record per sample; splits gives row numbers by name; nocontact
    has the no-contact image (height, width, 3) uint8 RGB of each sensor that has one; maps (n,) bool: whether a row's
    label is a map, not only a known total.
    """

    folder: Path
    images: np.ndarray | Rows
    pairs: np.ndarray | Rows
    rests: np.ndarray | Rows
    beside: np.ndarray
    labels: np.ndarray | Rows
    table: list[DatasetSample]
    splits: dict[str, np.ndarray]
    info: dict
    nocontact: dict[str, np.ndarray]
    maps: np.ndarray

    @property
    def name(self) -> str:
        """Name of the dataset; of its folder below results/ if dataset.json names none."""
        return str(self.info.get("name", self.folder.parent.parent.name))

    @property
    def image_size(self) -> tuple[int, int]:
        _, height, width, _ = self.images.shape
        return height, width

    @property
    def grid(self) -> tuple[int, int]:
        _, _, rows, cols = self.labels.shape
        return rows, cols

    def column(self, name: str) -> np.ndarray:
        """One column of samples.csv as float64 (n,); empty fields are NaN."""
        return np.array([sample.numbers()[name] for sample in self.table])

    def names(self, column: str) -> np.ndarray:
        """One column of samples.csv as text (n,)."""
        return np.array([sample.text(column) for sample in self.table])

    def require_nocontact(self, rows) -> list[str]:
        """Names of the sensors of some rows (k,); BadInput where one has no no-contact image."""
        names = [self.table[row].press.sensor_id for row in rows]
        missing = sorted(set(names) - set(self.nocontact))
        if missing:
            raise BadInput(
                f"{self.folder}: the no-contact image of sensor {', '.join(missing)} is missing, and this network needs it "
                f"beside each image: put nocontact/{missing[0]}.png into the dataset's data folder and make the "
                "dataset again, or choose MODEL=unet, which reads the image alone"
            )
        return names

    def seen(self, rows, pair: bool) -> np.ndarray:
        """Images of some rows as a network reads them, uint8 (k, height, width, 3).

        With `pair` (k, height, width, 6): each image beside its no-contact image, as stage 60 compared them.
        Raises BadInput as `require_nocontact`.
        """
        import cv2

        if not pair:
            return self.images[rows]
        self.require_nocontact(rows)
        both = zip(self.pairs[rows], self.rests[self.beside[rows]], strict=True)
        # OpenCV puts channels side by side several times faster than numpy
        return np.stack([cv2.merge([image, rest]) for image, rest in both])

    def presses(self, rows) -> np.ndarray:
        """Identity of the press of some rows, (k,): several images may show one; a row without group is its own."""
        samples = (self.table[row] for row in rows)
        return np.array([one.group or f"{one.press.sensor_id} {one.press.sample_id}" for one in samples])

    def sensor(self, name: str) -> Sensor:
        """A sensor of the dataset; a GelSight Mini's view for one that joined from another dataset."""
        camera = self.info.get("cameras", {}).get(name)
        return sensor_of(str(self.folder / "dataset.json"), name, camera) if camera else gelsight_mini()

    @property
    def c10(self) -> float:
        """Stiffness of the gel, MPa; the reference where labels were measured or imported."""
        return float(self.info.get("c10", REFERENCE_C10))

    def moments(self, rows) -> np.ndarray:
        """Moments of the labels of some rows about the gel's apex, (k, 3) N mm; NaN where unknown."""
        return np.array([self.table[row].wrench[3:] for row in rows]).reshape(-1, 3) / N_M

    def totals(self, rows) -> np.ndarray:
        """Total force of the labels of some rows, (k, 3) float64 N."""
        return self.labels[rows].sum((2, 3), dtype=np.float64)


def open_data(folder) -> Data:
    """Open a dataset folder of stage 60 and check that its parts belong together.

    Raises BadInput for missing files, arrays of wrong shape or type, and labels that are not finite.
    """
    folder = Path(folder)
    for name in FILES:
        if not (folder / name).exists():
            command = command_for("dataset", folder)
            raise BadInput(f"{folder}: {name} is missing; make it with `{command}`, RES being the grid you want")
    images, pairs, rests = (RowFile(folder / f"{name}.npy") for name in ("images", "pairs", "nocontact"))
    labels, beside = (map_array(folder / f"{name}.npy") for name in ("labels", "beside"))
    table = read_samples(folder / "samples.csv")
    info = read_json(folder / "dataset.json")
    check_shapes(folder, images, labels, table, info)
    check_finite(folder, labels, table)
    split = np.array([sample.split for sample in table])
    splits = {str(name): np.flatnonzero(split == name) for name in np.unique(split)}
    nocontact = {name: rests[at] for at, name in enumerate(info.get("nocontact", []))}
    maps = np.full(len(table), labels.shape[2:] != ONE_CELL)
    return Data(folder, images, pairs, rests, np.array(beside), labels, table, splits, info, nocontact, maps)


def check_shapes(folder, images, labels, table, info) -> None:
    """Raise BadInput where the arrays of a dataset do not fit each other."""
    if images.dtype != np.uint8 or images.ndim != 4 or images.shape[3] != 3:
        raise BadInput(
            f"{folder}/images.npy: expected uint8 (n, height, width, 3), got {images.dtype} {images.shape}"
        )
    if labels.dtype != np.float32 or labels.ndim != 4 or labels.shape[1] != 3:
        raise BadInput(f"{folder}/labels.npy: expected float32 (n, 3, rows, cols), got {labels.dtype} {labels.shape}")
    if not len(images) == len(labels) == len(table):
        raise BadInput(
            f"{folder}: {len(images)} images, {len(labels)} labels and {len(table)} rows of samples.csv; "
            "the numbers must be equal: remove the folder and make the dataset again"
        )
    grid = info.get("grid")
    if grid and tuple(grid) != labels.shape[2:]:
        raise BadInput(
            f"{folder}: the grid is {grid} in dataset.json and {list(labels.shape[2:])} in labels.npy; "
            "make the dataset again for one resolution"
        )


def check_finite(folder, labels, table) -> None:
    """Raise BadInput naming the first sample whose label is not finite."""
    for start in range(0, len(labels), CHUNK):
        good = np.isfinite(labels[start : start + CHUNK]).all((1, 2, 3))
        if not good.all():
            row = start + int(np.argmin(good))
            name = table[row].press.sample_id
            raise BadInput(
                f"{folder}/labels.npy: the label of sample {name} (row {row}) is not finite; "
                "look at its solve, then make labels and dataset again"
            )


def require_splits(data: Data) -> None:
    """Raise BadInput if a dataset is too small to train on and validate with."""
    for name, least in SMALLEST.items():
        have = len(data.splits.get(name, ()))
        if have < least:
            raise BadInput(
                f"{data.folder}: split {name!r} holds {have} of {len(data.table)} samples, training needs "
                f"at least {least}; add presses or change the fractions in [dataset]"
            )


@dataclass(frozen=True)
class Groups:
    """Rows of a dataset by what they decide in a training; they have no press in common, and tests are the other splits.

    train: the weights. choose: the epoch, and how intervals grow. calibrate: the size of intervals.
    """

    train: np.ndarray
    choose: np.ndarray
    calibrate: np.ndarray


def groups_of(own: Data, learnt: Data) -> Groups:
    """The groups of rows of `learnt`, all that a network learns from, whose first rows are `own`.

    Validation presses choose or calibrate by a hash of their group, so that a press that is added moves no other, alone or
    joined with other datasets. With fewer than 2 FEWEST_EACH validation presses in `own` all choose. Presses of `own`'s
    unseen sensors, of half of them by a hash, calibrate as well. A press that another dataset trains or chooses on
    calibrates nothing.
    """
    train, rows = learnt.splits[TRAINING], learnt.splits[VALIDATION]
    halves = len(np.unique(own.presses(own.splits[VALIDATION]))) >= 2 * FEWEST_EACH
    second = np.array([halves and drawn(_bare(learnt.table[row]), HALVES) >= 0.5 for row in rows], bool)
    choose, calibrate = rows[~second], rows[second & (rows < len(own.table))]
    unseen = np.concatenate([own.splits.get(name, np.zeros(0, int)) for name in (UNSEEN_SENSOR, UNSEEN_BOTH)])
    sensors = np.array([drawn(name, HALVES) < 0.5 for name in own.names("sensor_id")[unseen]], bool)
    calibrate = np.union1d(calibrate, unseen[sensors])
    used = np.unique(press_keys(learnt, np.concatenate([train, choose])))
    of_sensors = np.isin(calibrate, unseen)  # these test the sensor, whoever else saw the press
    return Groups(train, choose, calibrate[of_sensors | ~np.isin(press_keys(learnt, calibrate), used)])


def _bare(sample: DatasetSample) -> str:
    """Name of the group of a sample in its own dataset."""
    return (sample.group or sample.press.sample_id).rsplit("/", 1)[-1]


def press_keys(data: Data, rows) -> np.ndarray:
    """Identity of the press of some rows, unique over all datasets, (k,) text.

    Frames, depths and shears of one touch are one press, whichever sensor saw it. A press without a pose is
    identified by its dataset and its press_id, or else its sample_id and measured force.
    """
    return np.array([_press_key(data.name, data.table[row].press) for row in rows])


def _press_key(dataset: str, press: PressRecord) -> str:
    if press.posed:
        said = f"{press.indenter} {press.x0_mm:.4f} {press.y0_mm:.4f} {press.rot_deg:.3f}"
    else:
        said = f"{dataset} {press.press_id or f'{press.sample_id} {np.round(press.force, 3)}'}"
    return hashlib.sha1(said.encode(), usedforsecurity=False).hexdigest()[:10]


def data_version(data: Data) -> str:
    """Fingerprint of a dataset: of its tables and labels, its no-contact images and every 64th image."""
    digest = hashlib.sha256()
    for name in ("samples.csv", "dataset.json", "nocontact.npy", "beside.npy"):
        digest.update((data.folder / name).read_bytes())
    for start in range(0, len(data.labels), CHUNK):
        digest.update(np.ascontiguousarray(data.labels[start : start + CHUNK]).tobytes())
    for row in range(0, len(data.images), 64):
        digest.update(np.ascontiguousarray(data.images[row]).tobytes())
    return digest.hexdigest()[:16]


def scales(data: Data) -> dict:
    """Scales of training: image mean and deviation per channel, root mean square of cells and totals, their range.

    Labels are divided and never shifted, so zero force stays zero. A component with totals near zero, such as shear
    of centred presses, is scaled by LEAST_TOTAL of the largest scale, so that its errors keep a bounded weight. The
    scale of cells is that of labels that are maps. Raises BadInput for a component that is zero in every training
    label.
    """
    rows = data.splits[TRAINING]
    sums, squares, cells = np.zeros(3), np.zeros(3), np.zeros(3)
    for part in np.array_split(rows, max(1, len(rows) // CHUNK)):
        pixels = data.images[part].reshape(-1, 3)
        counts = np.stack([np.bincount(pixels[:, c], minlength=256) for c in range(3)])
        levels = np.arange(256) / 255
        sums += counts @ levels
        squares += counts @ levels**2
        cells += (data.labels[part[data.maps[part]]].astype(np.float64) ** 2).sum((0, 2, 3))
    n = len(rows) * np.prod(data.image_size)
    mean = sums / n
    totals = data.totals(rows)
    total = np.sqrt((totals**2).mean(0))
    total = np.maximum(total, LEAST_TOTAL * total.max())
    mapped = np.count_nonzero(data.maps[rows])
    cell = np.sqrt(cells / (mapped * np.prod(data.grid))) if mapped else total
    if (cell == 0).any() or (total == 0).any():
        raise BadInput(f"{data.folder}: a force component is zero in every training label; nothing can be learnt")
    return {
        "image_mean": mean.tolist(),
        "image_std": np.sqrt(np.maximum(squares / n - mean**2, 1e-6)).tolist(),
        "label": cell.tolist(),
        "total": total.tolist(),
        "range": (totals.max(0) - totals.min(0)).tolist(),
    }


def concatenate(own: Data, others: Sequence[Data]) -> Data:
    """One dataset to learn from: `own` with all of its splits, and the training and validation splits of `others`.

    It is named after all of them, and rows of `own` come first. Another dataset may have totals only (a grid of one
    cell): they are spread evenly over the cells, and `maps` is False for them. Its sensors and groups get its name as
    a prefix, so that names in two datasets do not clash. Raises BadInput for one of another image size or grid, and
    for one that is given twice.
    """
    if not others:
        return own
    for at, other in enumerate(others):
        require_alike(own, other)
        if other.name in [own.name, *(one.name for one in others[:at])]:
            raise BadInput(f"{other.folder}: dataset {other.name} is given twice to learn from; name each once")
    table, splits, pictures = list(own.table), dict(own.splits), dict(own.nocontact)
    rests, beside = [own.rests], [own.beside]
    for other in others:
        for name in (TRAINING, VALIDATION):
            mine = splits.get(name, np.zeros(0, int))
            splits[name] = np.concatenate([mine, len(table) + other.splits.get(name, np.zeros(0, int))])
        table += [carrying(other.name, sample) for sample in other.table]
        beside.append(np.where(other.beside < 0, -1, other.beside + sum(map(len, rests))))
        rests.append(other.rests)
        pictures |= {f"{other.name}/{name}": picture for name, picture in other.nocontact.items()}
    every = [own, *others]
    images, pairs = (ChainedRows([getattr(one, name) for one in every]) for name in ("images", "pairs"))
    labels = ChainedRows([one.labels if one.grid == own.grid else spread(one.labels, own.grid) for one in every])
    maps = np.concatenate([one.maps for one in every])
    info = own.info | {"name": ", ".join(one.name for one in every)}
    return replace(
        own, images=images, pairs=pairs, rests=ChainedRows(rests), beside=np.concatenate(beside), labels=labels,
        table=table, splits=splits, info=info, nocontact=pictures, maps=maps,
    )  # fmt: skip


def spread(totals, grid: tuple[int, int]) -> np.ndarray:
    """Total forces (n, 3, 1, 1) N spread evenly over the cells of labels (n, 3, rows, cols)."""
    cells = np.asarray(totals[:]) / np.float32(grid[0] * grid[1])
    return np.broadcast_to(cells, (*cells.shape[:2], *grid))


def carrying(dataset: str, sample: DatasetSample) -> DatasetSample:
    """A sample with the name of its dataset before its sensor and group; an empty group stays empty."""
    press = replace(sample.press, sensor_id=f"{dataset}/{sample.press.sensor_id}")
    return replace(sample, press=press, group=f"{dataset}/{sample.group}" if sample.group else "")


def require_alike(own: Data, other: Data) -> None:
    """Raise BadInput where two datasets cannot be learnt from together."""
    seen, required = (
        f"images of {one.image_size[1]} x {one.image_size[0]} and a grid of {one.grid[0]} x {one.grid[1]}"
        for one in (other, own)
    )
    if other.image_size != own.image_size or other.grid not in (own.grid, ONE_CELL):
        raise BadInput(
            f"{other.folder}: has {seen}, {own.folder} has {required}: datasets that a network learns from together must have"
            " the same image size and grid, or a grid of 1 x 1 (totals alone)"
        )
