"""Displacement and traction of cells: laws that hold on irregular surfaces at any resolution."""

import numpy as np
import pytest

from gelforge.labelling.cellsurface import surface_map, traction
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import assemble
from gelforge.labelling.sensor import load_sensors, transform
from gelforge.records.labelfile import read_labels
from tests.support.parameters import parameters, write_stage
from tests.support.patch import consistent_loads, irregular_surface
from tests.support.pressed_dataset import collect, label, write_pressed
from tests.support.refused import refused

EACH_GRID = pytest.mark.parametrize("text", ["6x8", "48x64"])
EVERYTHING = ["force", "displacement", "traction", "traction_deformed"]


@pytest.fixture(scope="module", params=["tet10", "hex8"])
def mesh(request):
    return irregular_surface(request.param, 1.3, np.random.default_rng(4))


@pytest.fixture(scope="module")
def sensor(root):
    return load_sensors(root / "workflow/sensors.toml")["gelsight_mini"]


@EACH_GRID
def test_a_rigid_translation_is_that_translation_and_changes_no_area(mesh, sensor, text):
    surface, move = surface_map(mesh, sensor, Grid.parse(text)), np.array([0.3, -0.2, -1.1])
    moved = np.tile(move, (len(mesh.nodes), 1))
    assert np.abs(surface.displacement(moved) - move[:, None, None]).max() < 1e-12
    assert np.abs(surface.area(moved) / surface.area() - 1.0).max() < 1e-12


@EACH_GRID
def test_a_linear_displacement_is_the_one_at_each_cells_middle(mesh, sensor, text):
    grid = Grid.parse(text)
    slope = np.array([[0.1, 0.0, 0.3], [0.2, 0.5, -0.4]])
    found = surface_map(mesh, sensor, grid).displacement(mesh.nodes[:, :2] @ slope)
    u, v = (np.arange(n) * size / n for n, size in ((grid.cols, sensor.image[0]), (grid.rows, sensor.image[1])))
    step = sensor.image[0] / grid.cols, sensor.image[1] / grid.rows
    corners = np.array([[0, 0], [step[0], 0], step, [0, step[1]]])
    cells = transform(np.linalg.inv(sensor.projection), np.stack(np.meshgrid(u, v), -1)[:, :, None] + corners)
    # the projection's perspective moves a cell's middle from the mean of its corners by far less than this
    assert np.abs(found - np.einsum("rcd,de->erc", cells.mean(axis=2), slope)).max() < 1e-3


@EACH_GRID
def test_area_stretches_as_the_surface_and_does_not_depend_on_the_grid(mesh, sensor, text):
    surface = surface_map(mesh, sensor, Grid.parse(text))
    assert np.abs(surface.area(0.25 * mesh.nodes) / surface.area() - 1.25**2).max() < 1e-9
    one = surface_map(mesh, sensor, Grid(1, 1)).area().sum()
    assert surface.area().sum() == pytest.approx(one, rel=1e-9)


@EACH_GRID
def test_traction_times_area_is_the_force(mesh, sensor, text):
    grid = Grid.parse(text)
    load = consistent_loads(mesh, lambda x, y: np.maximum(0.0, 1.0 - (x**2 + y**2) / 9.0))
    nodes = np.flatnonzero(load)
    force = load[nodes, None] * np.array([0.2, -0.1, -1.0])
    cells, outside = assemble(mesh, sensor, grid).apply([0, len(nodes)], nodes, force)
    surface = surface_map(mesh, sensor, grid)
    for moved in (None, -0.1 * np.abs(mesh.nodes)):
        area = surface.area(moved)
        pressure = traction(cells[0], area)
        assert (pressure * area / 1e3).sum(axis=(1, 2)) + outside[0] == pytest.approx(force.sum(axis=0), rel=1e-12)


def test_uniform_pressure_is_that_pressure_in_every_cell(sensor):
    mesh = irregular_surface("hex8", 1.3, np.random.default_rng(4))
    load = consistent_loads(mesh, lambda x, y: 0.004 + 0.0 * x)
    nodes = np.flatnonzero(load)
    cells, _ = assemble(mesh, sensor, Grid(12, 16)).apply([0, len(nodes)], nodes, load[nodes, None] * [0, 0, -1.0])
    area = surface_map(mesh, sensor, Grid(12, 16)).area()
    assert traction(cells[0], area)[2] == pytest.approx(np.full((12, 16), -4.0), rel=1e-9)


@pytest.fixture(scope="module")
def made(tmp_path_factory, root):
    import os

    os.chdir(root)
    made = write_pressed(tmp_path_factory.mktemp("made"), count=8, failed=(3,))
    write_stage(made["results"] / "00_plan/params", "labels", labels={"channels": EVERYTHING})
    return made


def test_label_files_hold_the_channels_that_were_asked_for(made):
    for resolution in ("6x8", "24x32"):
        found = read_labels(label(made, resolution) / "0000.npz")
        assert set(found.fields) == {"displacement", "traction", "area", "traction_deformed", "area_deformed"}
        good = [status.valid for status in found.status]
        for name, field in found.fields.items():
            assert np.isfinite(field[good]).all() and np.isnan(field[~np.array(good)]).all(), name
        for kind in ("", "_deformed"):
            force = found.fields[f"traction{kind}"] * found.fields[f"area{kind}"][:, None] / 1e3
            # float32 of three numbers
            assert np.abs(force - found.label)[good].max() < 1e-6 * np.abs(found.label[good]).max()
        # the made-up gel moves against every force by a tenth of it: along -x, -y, -z, in the labels' channels
        assert (found.fields["displacement"][good] <= 0).all()


def test_the_dataset_carries_the_channels_in_its_order(made):
    label(made, "6x8")
    folder = collect(made, "6x8")
    labels, area, pressure = (np.load(folder / f"{name}.npy") for name in ("labels", "area", "traction"))
    assert np.abs(pressure * area[:, None] / 1e3 - labels).max() < 1e-6 * np.abs(labels).max()


def test_other_files_stay_as_they_were(made, tmp_path):
    plain = write_pressed(tmp_path, count=8, failed=(3,))
    assert not read_labels(label(plain, "6x8") / "0000.npz").fields
    with_fields = read_labels(label(made, "6x8") / "0000.npz")
    assert np.array_equal(read_labels(label(plain, "6x8") / "0000.npz").label, with_fields.label, equal_nan=True)


def test_unknown_channels_are_refused():
    for channels in (["displacement"], ["force", "depth"], "force", ["force", "force"], 3):
        refused(r"\[labels\] channels", parameters, labels={"channels": channels})
