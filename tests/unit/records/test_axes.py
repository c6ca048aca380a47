"""One order of axes: a sheared press walks through every output, along gel x, y, z; in FEATS' files alone along y, x, z."""

import csv

import numpy as np
import pytest

from gelforge.commands import predict
from gelforge.flow.files import read_csv
from gelforge.formats.feats_folder import export_dataset
from gelforge.formats.featsfile import exchanged
from gelforge.learning.data import open_data
from gelforge.learning.evaluate import reference_totals
from gelforge.live.reading import COLUMNS, Reading
from gelforge.live.topics import RosMessages
from gelforge.reading.forcereading import ForceReading, total_columns
from gelforge.records.axes import CHANNELS, MOMENTS, TITLES
from gelforge.records.forcefile import SampleForces, write_forces
from gelforge.records.labelfile import read_labels
from gelforge.records.press import FORCE
from tests.support.pressed_dataset import HEXAHEDRA, bump, collect, label, write_pressed

PRESSED = np.array([0.5, -1.5, -4.0])
PLACE = np.array([0.5, -1.0])
# N mm, of PRESSED at PLACE, about the apex: the bump is symmetric, and its cells are flat
TURNED = np.cross([*PLACE, 0.0], PRESSED)


@pytest.fixture
def made(tmp_path):
    """Eight presses that all bear PRESSED, from force files to the dataset."""
    made = write_pressed(tmp_path, count=8)
    load, surface = bump(made["mesh"], *PLACE, 3.0, PRESSED), made["mesh"].surface_nodes
    forces = [SampleForces(f"s{k:03d}", "OK", HEXAHEDRA, surface, load[surface], 0 * load[surface])
              for k in range(8)]  # fmt: skip
    write_forces(made["results"] / "40_forces/0000.npz", forces, 0.0725)
    return made


def reading(cells: np.ndarray) -> ForceReading:
    """What a network would say that reads these cells."""
    total, half, image = cells.sum((1, 2), dtype=float), np.array([0.1, 0.2, 0.3]), np.zeros((2, 2, 3), np.uint8)
    return ForceReading(cells, total, half, "", 0.0, image, 0, TURNED, np.array([1.0, 2.0, 3.0]))


def test_names_are_those_of_the_axes():
    assert CHANNELS == ("fx", "fy", "fz") and tuple(f"{name}_n" for name in CHANNELS) == FORCE
    assert TITLES == ("fx: force along gel x", "fy: force along gel y", "fz: force along gel z")
    assert exchanged(exchanged(PRESSED)).tolist() == PRESSED.tolist() == exchanged(PRESSED)[[1, 0, 2]].tolist()


def test_a_sheared_press_walks_from_its_forces_to_every_file(made, tmp_path):
    cells = read_labels(label(made, "6x8") / "0000.npz").label
    assert cells.sum(axis=(2, 3)) == pytest.approx(np.tile(PRESSED, (8, 1)), rel=1e-5)
    folder = collect(made, "6x8")
    assert [float(read_csv(folder / "samples.csv")[0][name]) for name in FORCE] == pytest.approx(PRESSED, rel=1e-5)
    data = open_data(folder)
    assert data.totals([0])[0] == pytest.approx(PRESSED, rel=1e-5)
    measured = np.stack([data.column(f"measured_{name}") for name in FORCE], axis=1)
    assert np.array_equal(reference_totals(data, "sensor"), measured)
    of_nodes = read_labels(folder.parents[1] / "50_labels/6x8/0000.npz").moment[0]
    assert data.moments([0])[0] == pytest.approx(of_nodes, abs=1e-6)  # as rounded in the table
    assert of_nodes == pytest.approx(TURNED, abs=0.01 * 10.0 * np.linalg.norm(PRESSED))
    export_dataset(folder, tmp_path / "feats")
    theirs = np.load(next((tmp_path / "feats").glob("*/*.npy")), allow_pickle=True).item()
    for name, value in zip(("x", "y", "z"), exchanged(PRESSED), strict=True):
        assert theirs[f"grid_{name}"].sum() == pytest.approx(value, rel=1e-5) == theirs[f"f_{name}"]


def test_a_reading_has_the_same_order_in_tables_events_and_messages(made):
    cells = read_labels(label(made, "6x8") / "0000.npz").label[0]
    found = reading(cells)
    row = total_columns(found)
    assert [row[name] for name in FORCE] == pytest.approx(PRESSED, abs=1e-4)
    assert [row[f"{name}_half_width_n"] for name in CHANNELS] == [0.1, 0.2, 0.3]
    one = Reading(0, 0.0, found, 1.0)
    assert [row[f"{name}_nm"] for name in MOMENTS] == pytest.approx(1e-3 * found.moment, abs=1e-6)
    assert [row[f"{name}_half_width_nm"] for name in MOMENTS] == pytest.approx(1e-3 * found.moment_half_width)
    event = one.event()
    assert {*FORCE} < {*COLUMNS} and [event[name] for name in FORCE] == pytest.approx(PRESSED, abs=1e-4)
    said = {topic.split("/", 2)[2]: message for topic, message in RosMessages("mini")(one)[1]}
    for topic, off in (("wrench", 0.0), ("wrench/high", 1.0), ("wrench/low", -1.0)):
        force = said[topic].wrench.force
        assert [getattr(force, axis) for axis in "xyz"] == pytest.approx(PRESSED + off * found.half_width, rel=1e-5)
        turning, torque = found.moment + off * found.moment_half_width, said[topic].wrench.torque
        assert [getattr(torque, axis) for axis in "xyz"] == pytest.approx(1e-3 * turning, rel=1e-5)
    for name, value in zip(("along_x", "along_y", "normal"), PRESSED, strict=True):
        assert said[f"forces/{name}"].data.view("<f4").sum() == pytest.approx(value, rel=1e-5)


def test_the_shipped_network_reads_shear_along_the_axis_that_it_acts_along(root, tmp_path):
    """The demo's press that is sheared most along x and the one most along y, each by its own sign."""
    rows = read_csv(root / "data/demo/log.csv")
    for axis, name in enumerate(FORCE[:2]):
        row = max((r for r in rows if r["image"]), key=lambda r: abs(float(r[name])) - abs(float(r[FORCE[1 - axis]])))
        words = [
            str(root / "data/demo" / row["image"]),
            "--nocontact",
            str(root / f"data/demo/nocontact/{row['sensor_id']}.png"),
        ]
        predict.main([*words, "--out", str(tmp_path / name)])
        with (tmp_path / name / "totals.csv").open() as stream:
            read = next(csv.DictReader(stream))
        assert float(read[name]) == pytest.approx(float(row[name]), rel=0.5)
        assert abs(float(read[name])) > 2 * abs(float(read[FORCE[1 - axis]]))
