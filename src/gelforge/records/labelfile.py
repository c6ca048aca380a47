"""The artifact of stage 50: labels of one shard of samples at one resolution.

An uncompressed .npz. `n` samples:

| array | shape, type | meaning |
| --- | --- | --- |
| sample_id, status | (n,) str | as in the forces; a sample without a valid state has labels of NaN |
| label | (n, 3, rows, cols) float32 | N per cell along gel x, y, z |
| outside | (n, 3) float64 | N that fell outside the image, along the same axes |
| press_id | (n,) str | where samples are frames of a press: which one |
| extrapolated | (n,) float64 | factor for the size of hexahedra that the forces hold and displacement does not; 1: none |
| error_n, cells_error_n | (n,) float64 | N by which the size of the total force, and the forces per cell of 24 x 32 summed, may be off: nine of ten are within; NaN: not known |
| c10 | () float64 | MPa, the material that the forces belong to; absent where they were read by a sensor |
| c10_interval68, c10_interval95 | (2,) float64 | MPa, where the material was calibrated; labels scale with c10 |

Only where `[labels] channels` asks for them, NaN in cells that show no gel:

| array | shape, type | meaning |
| --- | --- | --- |
| displacement | (n, 3, rows, cols) float32 | mm, mean over the piece of surface that the cell shows before the touch |
| traction, area | (n, 3, rows, cols), (n, rows, cols) float32 | kPa on the undeformed area, and that area, mm^2 |
| traction_deformed, area_deformed | the same | kPa on the deformed area of the same piece, and that area |
"""

import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish
from gelforge.flow.layout import command_for
from gelforge.records.arrays import Archive, Schema
from gelforge.records.forcefile import INTERVALS, NUMBERS
from gelforge.records.status import Status

Stream = tuple[tuple[int, ...], Iterable[np.ndarray]]


def write_labels(
    path: str | Path,
    blocks: Iterable[np.ndarray],
    shape: tuple[int, ...],
    arrays: dict[str, Any],
    fields: dict[str, Stream] | None = None,
) -> None:
    """Write a shard whose label array of `shape` comes in consecutive `blocks` (b, 3, rows, cols) float32.

    Labels are streamed, because a large shard at a fine resolution does not fit in memory, and so are `fields`, by
    name their shape and blocks. `arrays` are the others, by name; they are written after the last label block, so
    that what the blocks fill in is in them. Whole or not at all.
    """
    with publish(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        _stream(archive, "label", shape, blocks)
        for name, array in arrays.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w") as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)
        for name, (size, parts) in (fields or {}).items():
            _stream(archive, name, size, parts)


def _stream(archive: zipfile.ZipFile, name: str, shape: tuple[int, ...], blocks: Iterable[np.ndarray]) -> None:
    with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
        header = {"descr": "<f4", "fortran_order": False, "shape": tuple(int(n) for n in shape)}
        np.lib.format.write_array_header_1_0(member, header)
        for block in blocks:
            member.write(np.ascontiguousarray(block, "<f4").data)


# Arrays beside the forces that a shard may have, and their dimensions.
FIELDS = {"displacement": 4, "traction": 4, "area": 3, "traction_deformed": 4, "area_deformed": 3}
SCHEMA = Schema(
    "a label shard",
    {"sample_id": ("U", 1), "status": ("U", 1), "label": ("f", 4), "outside": ("f", 2)},
    {
        "press_id": ("U", 1), "c10": ("f", 0), **dict.fromkeys((*INTERVALS, *NUMBERS), ("f", 1)),
        **{name: ("f", dimensions) for name, dimensions in FIELDS.items()},
    },
)  # fmt: skip


@dataclass(frozen=True)
class LabelShard:
    """Labels of n samples at one resolution; the arrays are those of the file."""

    path: Path
    sample_id: np.ndarray
    status: list[Status]
    label: np.ndarray
    outside: np.ndarray
    material: dict[str, float | list[float]]
    press_id: np.ndarray
    extrapolated: np.ndarray
    error_n: np.ndarray
    cells_error_n: np.ndarray
    fields: dict[str, np.ndarray]

    def index(self, sample_id: str) -> int:
        """Position of a sample; one that is not in the shard raises BadInput."""
        found = np.flatnonzero(self.sample_id == sample_id)
        if not len(found):
            raise BadInput(
                f"{self.path}: has no sample {sample_id}; its row was rejected, see 10_poses/*.rejected.csv"
            )
        return int(found[0])


def open_labels(path: str | Path) -> Archive:
    """A label file to read single arrays of."""
    hint = f"delete it and run {command_for('labels', path)} again, or import it again"
    return Archive(path, SCHEMA, hint)


def read_labels(path: str | Path) -> LabelShard:
    """Read a label file, made by stage 50 or imported, and check it.

    An array that is missing or has another form, a status that is none, a sample_id that stands twice and a valid
    sample whose label is not finite raise BadInput that names the file and the sample.
    """
    with open_labels(path) as file:
        names, states = file["sample_id"], file["status"]
        label, outside = file["label"], file["outside"]
        c10 = float(file["c10"]) if "c10" in file else None
        material: dict[str, float | list[float]] = {} if c10 is None else {"c10": c10}
        material |= {name: file[name].tolist() for name in INTERVALS if name in file}
        press = file.get("press_id", np.full(len(names), ""))
        unknown = np.full(len(names), np.nan)
        numbers = {name: file.get(name, unknown) for name in NUMBERS}
        fields = {name: file[name] for name in FIELDS if name in file}
    _check_shapes(path, names, states, label, outside, press, fields)
    for name, values in numbers.items():
        if len(values) != len(names):
            raise BadInput(f"{path}: {len(values)} values of {name} for {len(names)} names; make the labels again")
    states_of = _statuses(path, names, states)
    shard = LabelShard(Path(path), names, states_of, label, outside, material, press, **numbers, fields=fields)
    _check_values(shard)
    return shard


def _check_shapes(
    where: str | Path,
    names: np.ndarray,
    states: np.ndarray,
    label: np.ndarray,
    outside: np.ndarray,
    press: np.ndarray,
    fields: dict[str, np.ndarray],
) -> None:
    """BadInput where arrays of a label file do not fit each other."""
    n = len(names)
    if not (len(states) == len(label) == len(outside) == len(press) == n and label.shape[1] == 3 == outside.shape[1]):
        raise BadInput(
            f"{where}: {n} names, {len(states)} states, labels {label.shape} and forces outside {outside.shape} do not"
            " fit each other; make or import the labels again"
        )
    for name, field in fields.items():
        if len(field) != n or field.shape[-2:] != label.shape[-2:]:
            raise BadInput(f"{where}: {name} is {field.shape}, the labels are {label.shape}; make the labels again")


def _statuses(where: str | Path, names: np.ndarray, states: np.ndarray) -> list[Status]:
    """The status of each sample; BadInput for one that is none, and for a sample_id that stands twice."""
    ids, counts = np.unique(names, return_counts=True)
    if (counts > 1).any():
        first = counts.argmax()
        raise BadInput(
            f"{where}: sample {ids[first]} stands {counts[first]} times; give every label its own sample_id"
        )
    for name, state in zip(names.tolist(), states.tolist(), strict=True):
        if state not in Status.__members__:
            raise BadInput(f"{where}: sample {name}: status {state!r} is none of {', '.join(Status.__members__)}")
    return [Status[state] for state in states]


def _check_values(shard: LabelShard) -> None:
    """BadInput for a valid sample whose label is not finite, and for a stiffness that is none."""
    lost = np.array([not state.valid for state in shard.status], bool) | np.isfinite(shard.label).all(axis=(1, 2, 3))
    if not lost.all():
        raise BadInput(
            f"{shard.path}: sample {shard.sample_id[np.argmin(lost)]} has a label that is not finite; make or import the labels again"
        )
    c10 = shard.material.get("c10")
    if isinstance(c10, float) and not 0.0 < c10 < np.inf:
        raise BadInput(f"{shard.path}: c10 = {c10:g} MPa; it must be above 0: make or import the labels again")


def to_float32(values: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """Round values (k,) to float32 (k,) so that the sum of each group stays what it was.

    group (k,) numbers the values' groups from 0 to groups - 1. Rounding each value alone would lose some
    1e-8 of a sum. What is lost is put into one small value, whose spacing of float32 numbers is fine
    enough to hold it, and which is a thousand times what it takes in.
    """
    rounded = values.astype(np.float32)
    lost = np.bincount(group, values - rounded, groups)
    size = np.abs(rounded).astype(float)
    score = np.where((size > 0) & (size >= 1000.0 * np.abs(lost)[group]), size, np.inf)
    smallest = np.full(groups, np.inf)
    np.minimum.at(smallest, group, score)
    match = np.flatnonzero(np.isfinite(score) & (score == smallest[group]))
    chosen = match[np.unique(group[match], return_index=True)[1]]
    rounded[chosen] = (rounded[chosen] + lost[group[chosen]]).astype(np.float32)
    return rounded
