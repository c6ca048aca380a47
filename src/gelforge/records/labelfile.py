"""The artifact of stage 50: labels of one shard of samples at one resolution.

An uncompressed .npz. `n` samples:

| array | shape, type | meaning |
| --- | --- | --- |
| sample_id, status | (n,) str | as in the forces; a sample without a valid state has labels of NaN |
| label | (n, 3, rows, cols) float32 | N per cell along gel x, y, z |
| outside | (n, 3) float64 | N that fell outside the image, along the same axes |
| moment, outside_moment | (n, 3) float64 | N mm of the force in and outside the image about the gel's apex, from the nodes; absent in imported labels |
| press_id | (n,) str | only if samples are frames of a press: its identifier |
| extrapolated | (n,) float64 | factor that corrects forces, not displacement, for the size of hexahedra; 1: none |
| error_n | (n,) float64 | N, 90 % bound on the error of the total force's magnitude; NaN: not known |
| cells_error_n | (n,) float64 | N, the same of the forces per cell of a 24 x 32 grid, summed over cells |
| friction_error_n | (n,) float64 | N, error of the total force by that of the friction coefficient, `[interface] mu_error`; 0: nothing slips |
| c10 | () float64 | MPa, the material of the forces; absent where a force sensor measured them |
| c10_interval68, c10_interval95 | (2,) float64 | MPa, where the material was calibrated; labels scale with c10 |

Only if `[labels] channels` asks for them, NaN in cells that show no gel:

| array | shape, type | meaning |
| --- | --- | --- |
| displacement | (n, 3, rows, cols) float32 | mm, mean over the piece of the undeformed surface that the cell shows |
| traction, area | (n, 3, rows, cols), (n, rows, cols) float32 | kPa on the undeformed area, and that area, mm^2 |
| traction_deformed, area_deformed | the same | kPa on the deformed area of the same piece, and that area, mm^2 |
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

    Labels are streamed, because a large shard at a fine resolution does not fit in memory. So are `fields`: shape and
    blocks by name. `arrays`: the others by name, written after the last label block, so that producing the blocks may
    fill them. Whole or not at all.
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


# Optional arrays of a shard beside the forces, and their numbers of dimensions.
FIELDS = {"displacement": 4, "traction": 4, "area": 3, "traction_deformed": 4, "area_deformed": 3}
MOMENTS = ("moment", "outside_moment")
SCHEMA = Schema(
    "a label shard",
    {"sample_id": ("U", 1), "status": ("U", 1), "label": ("f", 4), "outside": ("f", 2)},
    {
        "press_id": ("U", 1), **dict.fromkeys(MOMENTS, ("f", 2)), "c10": ("f", 0), **dict.fromkeys((*INTERVALS, *NUMBERS), ("f", 1)),
        **{name: ("f", dimensions) for name, dimensions in FIELDS.items()},
    },
)  # fmt: skip


@dataclass(frozen=True)
class LabelShard:
    """Labels of n samples at one resolution; the arrays are those of the file, NaN for absent ones."""

    path: Path
    sample_id: np.ndarray
    status: list[Status]
    label: np.ndarray
    outside: np.ndarray
    moment: np.ndarray
    outside_moment: np.ndarray
    material: dict[str, float | list[float]]
    press_id: np.ndarray
    extrapolated: np.ndarray
    error_n: np.ndarray
    cells_error_n: np.ndarray
    friction_error_n: np.ndarray
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
    """A label file, for reading single arrays."""
    hint = f"delete it and run {command_for('labels', path)} again, or import it again"
    return Archive(path, SCHEMA, hint)


def read_labels(path: str | Path) -> LabelShard:
    """Read a label file, made by stage 50 or imported, and check it.

    Raises BadInput, naming file and sample, for an array that is missing or malformed, an unknown status, a repeated
    sample_id and a valid sample whose label is not finite.
    """
    with open_labels(path) as file:
        names, states = file["sample_id"], file["status"]
        label, outside = file["label"], file["outside"]
        c10 = float(file["c10"]) if "c10" in file else None
        material: dict[str, float | list[float]] = {} if c10 is None else {"c10": c10}
        material |= {name: file[name].tolist() for name in INTERVALS if name in file}
        press = file.get("press_id", np.full(len(names), ""))
        unknown = np.full(len(names), np.nan)
        moments = {name: file.get(name, np.full((len(names), 3), np.nan)) for name in MOMENTS}
        numbers = {name: file.get(name, unknown) for name in NUMBERS}
        fields = {name: file[name] for name in FIELDS if name in file}
    _check_shapes(path, names, states, label, outside, press, fields)
    for name, values in (numbers | moments).items():
        if len(values) != len(names):
            raise BadInput(f"{path}: {len(values)} values of {name} for {len(names)} names; make the labels again")
    states_of = _statuses(path, names, states)
    shard = LabelShard(
        Path(path),
        names,
        states_of,
        label,
        outside,
        **moments,
        material=material,
        press_id=press,
        **numbers,
        fields=fields,
    )
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
    """BadInput if the shapes of the arrays of a label file do not match."""
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
    """The status of each sample; BadInput for an unknown status and a repeated sample_id."""
    ids, counts = np.unique(names, return_counts=True)
    if (counts > 1).any():
        first = counts.argmax()
        raise BadInput(
            f"{where}: sample {ids[first]} occurs {counts[first]} times; give every label its own sample_id"
        )
    for name, state in zip(names.tolist(), states.tolist(), strict=True):
        if state not in Status.__members__:
            raise BadInput(
                f"{where}: sample {name}: unknown status {state!r}; use one of {', '.join(Status.__members__)}"
            )
    return [Status[state] for state in states]


def _check_values(shard: LabelShard) -> None:
    """BadInput for a valid sample whose label is not finite, and for a stiffness that is not positive and finite."""
    lost = np.array([not state.valid for state in shard.status], bool) | np.isfinite(shard.label).all(axis=(1, 2, 3))
    if not lost.all():
        raise BadInput(
            f"{shard.path}: sample {shard.sample_id[np.argmin(lost)]} has a label that is not finite; make or import the labels again"
        )
    c10 = shard.material.get("c10")
    if isinstance(c10, float) and not 0.0 < c10 < np.inf:
        raise BadInput(f"{shard.path}: c10 = {c10:g} MPa; it must be above 0: make or import the labels again")


def to_float32(values: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """Round values (k,) to float32 (k,) so that the sum of each group is kept.

    group (k,) numbers the values' groups from 0 to groups - 1. Rounding each value alone would change a sum by some
    1e-8. The difference is added to the smallest value that is at least a thousand times as large: small, so that
    float32 resolves the difference there.
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
