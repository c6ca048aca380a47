"""The artifact of stage 40: contact forces of one shard of samples.

An uncompressed .npz. `n` samples; `k` contact nodes and `m` surface nodes, all samples together:

| array | shape, type | meaning |
| --- | --- | --- |
| sample_id, status, mesh | (n,) str | `status` names a `Status`, `mesh` what `gelforge.mechanics.mesh.names.load_mesh` takes |
| ptr, node, force | (n+1,) int64, (k,) int32, (k, 3) float64 | N on the gel at `c10`; free nodes are left out |
| surface_ptr, displacement | (n+1,) int64, (m, 3) float32 | mm, rows follow the mesh's `surface_nodes` |
| total, moment | (n, 3) float64 | total force, N, and moment about the gel's apex, N mm |
| c10 | () float64 | MPa |
| c10_interval68, c10_interval95 | (2,) float64 | MPa, only where the material was calibrated |
| extrapolated | (n,) float64 | factor that corrects `force`, not `displacement`, for the size of hexahedra; 1: none |
| error_n | (n,) float64 | N, 90 % bound on the error of the total force's magnitude; NaN: not known |
| cells_error_n | (n,) float64 | N, the same of the forces per cell of a 24 x 32 grid, summed over cells |
| friction_error_n | (n,) float64 | N, error of the total force by that of the friction coefficient, `[interface] mu_error`; 0: nothing slips |
| press_id | (n,) str | only if samples are frames of a press: its identifier |

Samples without a valid state have no nodes. Labels read `force` only, and a zip member can be read alone. Nothing is
compressed: on 100 samples of 6000 surface nodes, deflating saves 8 % of the bytes and reading takes eight times as
long.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish
from gelforge.records.arrays import Archive, Schema
from gelforge.records.status import Status

INTERVALS = ("c10_interval68", "c10_interval95")
NUMBERS = ("extrapolated", "error_n", "cells_error_n", "friction_error_n")  # of each sample
ERRORS = NUMBERS[1:]  # those in N, which scale with C10


@dataclass(frozen=True)
class SampleForces:
    """One sample of a shard: forces (s, 3) N and displacements (s, 3) mm at `nodes` (s,), all surface nodes.

    moment: of the forces about the gel's apex, (3,) N mm.
    """

    sample_id: str
    status: str
    mesh: str
    nodes: np.ndarray
    force: np.ndarray
    displacement: np.ndarray
    press_id: str = ""
    extrapolated: float = 1.0
    error_n: float = np.nan
    cells_error_n: float = np.nan
    friction_error_n: float = np.nan
    moment: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def failed(cls, sample_id: str, status: str, mesh: str = "", press_id: str = "") -> "SampleForces":
        """A sample without a valid state."""
        return cls(sample_id, status, mesh, np.empty(0, np.int32), np.empty((0, 3)), np.empty((0, 3)), press_id)


def write_forces(
    path: str | Path, samples: Sequence[SampleForces], c10: float, intervals: dict[str, Any] | None = None
) -> None:
    """Write `samples` (SampleForces, in the order of the shard) to `path`, whole or not at all.

    c10 in MPa is the material the forces are scaled to; `intervals` may hold "c10_interval68" and
    "c10_interval95", (2,) each. A force that is not finite raises BadInput with the sample's name.
    """
    for sample in samples:
        _check_sample(path, sample)
    touched = [np.flatnonzero(sample.force.any(axis=1)) for sample in samples]
    arrays: dict[str, Any] = {
        "sample_id": np.array([s.sample_id for s in samples], dtype=str),
        "status": np.array([s.status for s in samples], dtype=str),
        "mesh": np.array([s.mesh for s in samples], dtype=str),
        "ptr": _pointer([len(rows) for rows in touched]),
        "node": _stack([s.nodes[rows] for s, rows in zip(samples, touched, strict=True)], (0,), np.int32),
        "force": _stack([s.force[rows] for s, rows in zip(samples, touched, strict=True)], (0, 3), np.float64),
        "surface_ptr": _pointer([len(s.displacement) for s in samples]),
        "displacement": _stack([s.displacement for s in samples], (0, 3), np.float32),
        "total": np.array([s.force.sum(axis=0) for s in samples], np.float64).reshape(-1, 3),
        "moment": np.array([s.moment for s in samples], np.float64).reshape(-1, 3),
        "c10": np.float64(c10),
        **{name: np.array([getattr(s, name) for s in samples], np.float64) for name in NUMBERS},
    }
    if any(sample.press_id for sample in samples):
        arrays["press_id"] = np.array([sample.press_id for sample in samples], dtype=str)
    for name, interval in (intervals or {}).items():
        if name not in INTERVALS:
            raise BadInput(f"{path}: unknown interval {name!r}; use one of {', '.join(INTERVALS)}")
        arrays[name] = np.asarray(interval, np.float64).reshape(2)
    with publish(path) as part, part.open("wb") as stream:
        np.savez(stream, **arrays)


def _check_sample(path: str | Path, sample: SampleForces) -> None:
    where = f"{path}: sample {sample.sample_id}"
    if sample.status not in Status.__members__:
        raise BadInput(f"{where}: unknown status {sample.status!r}; use one of {', '.join(Status.__members__)}")
    if not len(sample.nodes) == len(sample.force) == len(sample.displacement):
        raise BadInput(
            f"{where}: {len(sample.nodes)} nodes, {len(sample.force)} forces and"
            f" {len(sample.displacement)} displacements; give one of each per surface node"
        )
    if not (np.isfinite(sample.force).all() and np.isfinite(sample.displacement).all()):
        raise BadInput(f"{where}: forces or displacements are not finite; record the sample as UNREADABLE instead")


def _pointer(lengths: Sequence[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(np.asarray(lengths, np.int64))]).astype(np.int64)


def _stack(parts: Sequence[np.ndarray], empty_shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    return np.concatenate([np.empty(empty_shape, dtype), *(np.asarray(p, dtype) for p in parts)])


SCHEMA = Schema(
    "a forces shard",
    {
        "sample_id": ("U", 1), "status": ("U", 1), "mesh": ("U", 1), "ptr": ("i", 1), "node": ("i", 1), "force": ("f", 2),
        "surface_ptr": ("i", 1), "displacement": ("f", 2), "total": ("f", 2), "moment": ("f", 2), "c10": ("f", 0), **dict.fromkeys(NUMBERS, ("f", 1)),
    },
    {"press_id": ("U", 1), **dict.fromkeys(INTERVALS, ("f", 1))},
)  # fmt: skip
HINT = "delete it and run make again"


class ForceFile:
    """Reader of what `write_forces` wrote, used as a context manager; large arrays are read when first accessed.

    A file that is no such shard raises BadInput.
    """

    def __init__(self, path: str | Path):
        self.path = path
        self._file = file = Archive(path, SCHEMA, HINT)
        self.sample_id, self.status, self.mesh = (file[k] for k in ("sample_id", "status", "mesh"))
        self.ptr, self.total, self.moment = file["ptr"], file["total"], file["moment"]
        self.c10 = float(file["c10"])
        self.intervals = {name: file[name] for name in INTERVALS if name in file}
        self.press_id = file.get("press_id", np.full(len(self.sample_id), ""))
        self.numbers = {name: file[name] for name in NUMBERS}

    def __enter__(self) -> "ForceFile":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.__exit__()

    def __len__(self) -> int:
        return len(self.sample_id)

    @cached_property
    def node(self) -> np.ndarray:
        return self._file["node"]

    @cached_property
    def force(self) -> np.ndarray:
        return self._file["force"]

    @cached_property
    def surface_ptr(self) -> np.ndarray:
        return self._file["surface_ptr"]

    @cached_property
    def displacement(self) -> np.ndarray:
        return self._file["displacement"]

    def index(self, sample_id: str) -> int:
        """Position of a sample in the shard; a name that is not in it raises BadInput."""
        found = np.flatnonzero(self.sample_id == sample_id)
        if not len(found):
            raise BadInput(
                f"{self.path}: has no sample {sample_id!r}; it holds {len(self)} samples,"
                f" the first is {self.sample_id[0] if len(self) else 'none'}"
            )
        return int(found[0])

    def sample(self, index: int, surface_nodes: np.ndarray) -> SampleForces:
        """Sample `index` with forces on all of its mesh's `surface_nodes` (sorted), zero where none acts.

        Raises BadInput if the mesh has another number of surface nodes than the shard.
        """
        rows = slice(self.surface_ptr[index], self.surface_ptr[index + 1])
        displacement = self.displacement[rows].astype(float)
        touched = slice(self.ptr[index], self.ptr[index + 1])
        names = str(self.sample_id[index]), str(self.status[index]), str(self.mesh[index])
        press = str(self.press_id[index])
        known: dict[str, Any] = {name: float(self.numbers[name][index]) for name in NUMBERS}
        known["moment"] = self.moment[index]
        if not len(displacement):
            return SampleForces.failed(*names, press)
        if len(displacement) != len(surface_nodes):
            raise BadInput(
                f"{self.path}: sample {names[0]} has {len(displacement)} surface nodes, mesh {names[2]} has"
                f" {len(surface_nodes)}; the mesh changed since, run make again"
            )
        force = np.zeros((len(surface_nodes), 3))
        force[np.searchsorted(surface_nodes, self.node[touched])] = self.force[touched]
        return SampleForces(*names, surface_nodes, force, displacement, press, **known)
