"""Stage 50: any resolution beside the others, nothing lost, nothing half-written."""

import os

import numpy as np
import pytest

from gelforge.flow.step import NOTICES
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import assemble
from gelforge.labelling.sensor import load_sensors
from gelforge.records.forcefile import ForceFile, SampleForces, write_forces
from gelforge.records.labelfile import read_labels, write_labels
from gelforge.records.status import Status
from gelforge.stages import labels
from tests.support.pressed_dataset import HEXAHEDRA, bump, label, make_mesh, mesh_name, write_pressed
from tests.support.refused import refused


@pytest.fixture(scope="module")
def made(tmp_path_factory, root):
    os.chdir(root)
    return write_pressed(tmp_path_factory.mktemp("made"), failed=(5,), sensors=("mini_a", "mini_c"))


def test_labels_hold_the_forces_of_their_nodes(made):
    folder = label(made, "24x32")
    for shard in ("0000", "0001", "0002"):
        found = read_labels(folder / f"{shard}.npz")
        assert found.label.shape == (8, 3, 24, 32) and found.label.dtype == np.float32
        assert found.material == {"c10": 0.0725, "c10_interval68": [0.07, 0.075]}
        for at, name in enumerate(found.sample_id):
            total = made["loads"][str(name)].sum(axis=0)
            seen = found.label[at].astype(float).sum(axis=(1, 2)) + found.outside[at]
            if name == "s005":
                assert found.status[at] is Status.DIVERGED and np.isnan(seen).all()
            else:
                assert seen == pytest.approx(total, rel=1e-9, abs=1e-9 * np.abs(total).sum())


def test_a_shard_whose_presses_were_all_rejected_is_read_as_any_other(tmp_path):
    nothing = {"sample_id": np.array([], "<U4"), "status": np.array([], "<U2"), "outside": np.zeros((0, 3))}
    write_labels(tmp_path / "0000.npz", [], (0, 3, 24, 32), nothing | {"c10": np.float64(0.0725)})
    found = read_labels(tmp_path / "0000.npz")
    assert found.label.shape == (0, 3, 24, 32) and found.status == []


def test_each_sample_is_seen_by_its_own_sensor(made):
    found = read_labels(label(made, "12x16") / "0000.npz")
    sensors = load_sensors("workflow/sensors.toml")
    for at, name in ((0, "mini_a"), (1, "mini_c")):
        force = made["loads"][f"s00{at}"]
        node = np.flatnonzero(force.any(axis=1))
        operator = assemble(made["mesh"], sensors[name], Grid(12, 16))
        cells, _ = operator.apply(np.array([0, len(node)]), node, force[node])
        assert np.abs(found.label[at] - cells[0]).max() < 1e-6  # float32 of some newtons


def test_stored_resolutions_nest(made):
    coarse = read_labels(label(made, "12x16") / "0001.npz").label
    fine = read_labels(label(made, "48x64") / "0001.npz").label.astype(float)
    summed = fine.reshape(8, 3, 12, 4, 16, 4).sum(axis=(3, 5))
    assert np.abs(summed - coarse).max() < 1e-6 * np.abs(coarse).max()  # what float32 of a cell can hold


def test_blocks_do_not_change_labels(made, monkeypatch):
    whole = read_labels(label(made, "9x11") / "0000.npz").label
    monkeypatch.setattr(labels, "BLOCK_BYTES", 3 * 3 * 8 * 99)
    assert np.array_equal(read_labels(label(made, "9x11") / "0000.npz").label, whole, equal_nan=True)


def test_a_press_over_the_rim_reports_what_it_lost(tmp_path, capsys):
    made = write_pressed(tmp_path, count=1)
    mesh, force = made["mesh"], bump(make_mesh(), 0.0, 11.0, 3.0, (0, 0, -4.0))
    surface = mesh.surface_nodes
    sample = SampleForces("s000", "OK", HEXAHEDRA, surface, force[surface], np.zeros((len(surface), 3)))
    write_forces(made["results"] / "40_forces/0000.npz", [sample], 0.0725)
    found = read_labels(label(made, "24x32") / "0000.npz")
    outside = found.outside[0, 2]
    assert -4.0 < outside < -0.5
    assert found.label.astype(float)[0, 2].sum() + outside == pytest.approx(-4.0, rel=1e-9)
    assert "s000" in capsys.readouterr().out


def test_cells_smaller_than_a_pixel_are_made_with_a_note(tmp_path, capsys):
    for resolution, odd in (("240x320", False), ("241x320", True), ("240x321", True)):
        made = write_pressed(tmp_path / resolution, count=2)
        assert len(read_labels(label(made, resolution) / "0000.npz").label) == 2
        notes = [line for line in capsys.readouterr().out.splitlines() if "smaller than the pixels of mini_" in line]
        assert len(notes) == odd and all(line.startswith(NOTICES) for line in notes)


def spoil_forces(results):
    """A forces shard whose author did not look: NaN in a force."""
    path = results / "40_forces/0000.npz"
    with np.load(path) as file:
        arrays = dict(file)
    arrays["force"][3, 1] = np.nan
    np.savez(path, **arrays)


def rename_mesh(results, name):
    path = results / "40_forces/0000.npz"
    with np.load(path) as file:
        arrays = dict(file)
    arrays["mesh"] = np.array([name] * len(arrays["mesh"]))
    np.savez(path, **arrays)


def rewrite(path, old, new):
    path.write_text(path.read_text().replace(old, new))


BROKEN = (
    (spoil_forces, "0000.npz.*s000.*not finite"),
    (lambda r: (r / "40_forces/0000.npz").write_bytes(b"PK\x03\x04half"), "0000.npz.*delete it"),
    (lambda r: rename_mesh(r, "teapot"), "mesh name 'teapot' starts with neither"),
    (lambda r: (r / "10_poses/0000.csv").write_text("sample_id,sensor_id\n"), "0000.csv.*s000|s000.*0000.csv"),
    (lambda r: rewrite(r / "10_poses/0000.csv", "mini_a", "zzz"), "zzz.*mini_a"),
    (lambda r: rename_mesh(r, mesh_name(2.5).name), "node.*make"),
)


def test_broken_inputs_are_named_and_nothing_is_half_written(tmp_path):
    for k, (breaking, said) in enumerate(BROKEN):
        results = (made := write_pressed(tmp_path / f"made{k}", count=2))["results"]
        breaking(results)
        refused(said, label, made, "10x10")
        folder = results / "50_labels/10x10"
        assert not list(folder.glob(".*")) and not (folder / "0000.npz").exists()
    refused("24by32", label, made, "24by32")


def test_forces_come_back(tmp_path):
    mesh = make_mesh(2.5)
    surface, rng = mesh.surface_nodes, np.random.default_rng(0)
    force = rng.normal(size=(len(surface), 3)) * (rng.random(len(surface)) < 0.2)[:, None]
    samples = [
        SampleForces("a", "OK", "m", surface, force, 0.1 * force),
        SampleForces.failed("b", "DIVERGED"),
        SampleForces("c", "OK", "m", surface, -force, force),
    ]
    write_forces(tmp_path / "f.npz", samples, 0.08)
    with ForceFile(tmp_path / "f.npz") as file:
        assert file.index("c") == 2 and file.c10 == 0.08 and not file.intervals
        back = file.sample(2, surface)
        assert np.array_equal(back.force, -force) and np.abs(back.displacement - force).max() < 1e-6
        assert not len(file.sample(1, surface).nodes)
        assert np.allclose(file.total, [force.sum(0), np.zeros(3), -force.sum(0)])
        refused("no sample 'z'", file.index, "z")
        refused("surface nodes", file.sample, 0, surface[:-1])


def test_forces_that_are_none_are_refused(tmp_path):
    zeros = {"force": np.zeros((2, 3)), "displacement": np.zeros((2, 3))}
    good = {"sample_id": "a", "status": "OK", "mesh": "m", "nodes": np.arange(2), **zeros}
    for change, reason in (
        ({"status": "FINE"}, "FINE"),
        ({"force": np.full((2, 3), np.nan)}, "finite"),
        ({"force": np.zeros((3, 3))}, "3 forces"),
    ):
        refused(reason, write_forces, tmp_path / "f.npz", [SampleForces(**{**good, **change})], 0.07)
    assert not list(tmp_path.iterdir())
