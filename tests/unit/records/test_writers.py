"""Every writer of a file that says "whole or not at all": a full disk, and a kill before the file has its name."""

import os

import numpy as np
import pytest

from gelforge.errors import GelforgeError
from gelforge.flow.files import write_csv, write_json, write_text
from gelforge.formats.featsfile import write_normalisation
from gelforge.formats.vtu import write_vtu
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.mesh.basemesh import BaseMesh
from gelforge.mechanics.mesh.hexmesh import FineBox, build_mesh
from gelforge.records.forcefile import SampleForces, write_forces
from gelforge.records.image import write_png
from gelforge.records.labelfile import write_labels
from gelforge.records.log import write_log
from gelforge.records.predictionfile import write_predictions
from gelforge.records.press import Press
from gelforge.records.solvetable import Solved, write_solves
from gelforge.records.status import Status
from gelforge.virtualrig.fields import Surface
from tests.support.limited import small_disk
from tests.support.press_records import press_record

pytestmark = pytest.mark.processes
RNG = np.random.default_rng(0)
PRESS = Press(0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0)


def noise(*shape: int) -> np.ndarray:
    """Numbers that cannot be compressed."""
    return RNG.standard_normal(shape)


def forces(path, n):
    write_forces(path, [SampleForces("a", "OK", "m", np.arange(n), noise(n, 3), noise(n, 3))], 0.07)


def labels(path, n):
    write_labels(path, (noise(1, 3, 2, 2) for _ in range(n)), (n, 3, 2, 2), {"sample_id": np.arange(n).astype(str)})


def solves(path, n):
    every = [Solved(f"s{k}", Status.OK, "", "label", "m", "f", (0.0, 0.1, -1.0), {"seconds": 1.5}) for k in range(n)]
    write_solves(path, every)


def mesh(path, n):
    BaseMesh(noise(n, 3), RNG.integers(0, n, (n, 4)), "box", {}).write(path)


def grid(path, _):
    write_vtu(path, build_mesh(load_gel("gelsight_mini"), FineBox(-1.0, 1.0, -1.0, 1.0, 0.1), 2))


# Each writes a file of n rows or so; one of 30 000 is far larger than `small_disk`.
WRITERS = {
    "text": lambda path, n: write_text(path, "long " * n),
    "json": lambda path, n: write_json(path, {"n": list(range(n))}),
    "csv": lambda path, n: write_csv(path, ["n"], [{"n": k} for k in range(n)]),
    "log": lambda path, n: write_log(path, [press_record(sample_id=f"s{k}") for k in range(n)]),
    "solves": solves,
    "forces": forces,
    "labels": labels,
    "predictions": lambda path, n: write_predictions(path, np.arange(n).astype(str), noise(n, 3, 2, 2), noise(n, 3)),
    "normalisation": lambda path, n: write_normalisation(path, {f"f{k}": {"min": 0, "max": k} for k in range(n)}),
    "png": lambda path, n: write_png(path, RNG.integers(0, 255, (n // 100 + 1, 100, 3), np.uint8)),
    "surface": lambda path, n: Surface(np.arange(2.0), np.arange(float(n)), noise(n, 2, 3), PRESS).save(path),
    "mesh": mesh,
    "vtu": grid,
}
SUFFIX = {"png": ".png", "vtu": ".vtu", "surface": ".npz"}


def test_a_full_disk_leaves_what_was_there(tmp_path):
    with small_disk(tmp_path / "disk") as disk:
        for name, write in WRITERS.items():
            path = disk / f"x{SUFFIX.get(name, '')}"
            path.write_bytes(b"before")
            with pytest.raises((OSError, GelforgeError)):
                write(path, 30_000)
            assert path.read_bytes() == b"before" and os.listdir(disk) == [path.name], name
            path.unlink()


def killed_at_its_name(write, path) -> int:
    """Status of a process that dies when it is about to give a file its name."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1]
    os.replace = lambda *_: os.kill(os.getpid(), 9)
    try:
        write(path, 50)
    finally:
        os._exit(0)


def test_a_kill_leaves_what_was_there_and_the_next_writer_replaces_it(tmp_path):
    for name, write in WRITERS.items():
        path = tmp_path / name / f"x{SUFFIX.get(name, '')}"
        path.parent.mkdir()
        path.write_bytes(b"before")
        assert killed_at_its_name(write, path) == 9, name
        assert path.read_bytes() == b"before" and [one for one in os.listdir(path.parent) if one[0] != "."] == [
            path.name
        ], name
        write(path, 50)
        assert path.read_bytes() != b"before", name
