"""Laws of the binning operator: no newton is lost, coarse cells are sums of fine ones, nothing changes sign."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.labelling.clip import clip_to_grid, polygon_area
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import assemble
from gelforge.labelling.sensor import Sensor, load_sensors
from gelforge.records.labelfile import to_float32
from tests.support.patch import consistent_loads, irregular_surface

ROUNDING = 1e-12  # relative; sums of some thousand float64 terms
MESHES = {kind: irregular_surface(kind, 1.5, np.random.default_rng(2)) for kind in ("tet10", "hex8")}
sides = st.integers(1, 40)
seeds = st.integers(0, 2**32 - 1)
kinds = st.sampled_from(sorted(MESHES))


@st.composite
def sensors(draw):
    """Units near the reference: scale, shift, turn and a little perspective."""
    scale, angle = draw(st.floats(9.0, 20.0)), draw(st.floats(-0.2, 0.2))
    shift = draw(st.tuples(st.floats(-60, 60), st.floats(-60, 60)))
    tilt = draw(st.tuples(st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3)))
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return Sensor("drawn", (320, 240), np.array([[s, -c, 160 + shift[0]], [-c, -s, 120 + shift[1]], [*tilt, 1.0]]))


def random_forces(mesh, seed):
    rng = np.random.default_rng(seed)
    node = rng.choice(mesh.surface_nodes, 30, replace=False)
    return np.array([0, 12, 12, 30]), node, rng.normal(0, 1, (30, 3))


@settings(max_examples=40)
@given(sensors(), sides, sides, seeds, kinds)
def test_every_newton_is_in_a_cell_or_outside(sensor, rows, cols, seed, kind):
    ptr, node, force = random_forces(MESHES[kind], seed)
    operator = assemble(MESHES[kind], sensor, Grid(rows, cols))
    cells, outside = operator.apply(ptr, node, force)
    total = np.array([force[a:b].sum(axis=0) for a, b in zip(ptr, ptr[1:], strict=False)])
    assert np.abs(cells.sum(axis=(2, 3)) + outside - total).max() <= ROUNDING * np.abs(force).sum()
    assert operator.weight.min() >= 0
    sums = np.asarray(operator.matrix.sum(axis=1)).ravel()[MESHES[kind].surface_nodes]
    assert np.abs(sums - 1).max() <= ROUNDING


@settings(max_examples=25)
@given(sensors(), st.integers(1, 12), st.integers(1, 12), st.integers(2, 4), st.integers(2, 4), seeds, kinds)
def test_coarse_cells_are_sums_of_fine_cells(sensor, rows, cols, down, right, seed, kind):
    ptr, node, force = random_forces(MESHES[kind], seed)
    coarse, beyond = assemble(MESHES[kind], sensor, Grid(rows, cols)).apply(ptr, node, force)
    fine, outside = assemble(MESHES[kind], sensor, Grid(rows * down, cols * right)).apply(ptr, node, force)
    summed = fine.reshape(3, 3, rows, down, cols, right).sum(axis=(3, 5))
    assert np.abs(summed - coarse).max() <= ROUNDING * np.abs(force).sum()
    assert np.abs(outside - beyond).max() <= ROUNDING * np.abs(force).sum()


@settings(max_examples=20)
@given(sensors(), st.integers(-6, 6), st.integers(-6, 6), seeds, kinds)
def test_moving_the_image_by_whole_cells_moves_the_label(sensor, right, down, seed, kind):
    ptr, node, force = random_forces(MESHES[kind], seed)
    grid = Grid(24, 32)
    shift = np.array([[1, 0, 10.0 * right], [0, 1, 10.0 * down], [0, 0, 1]])
    here, _ = assemble(MESHES[kind], sensor, grid).apply(ptr, node, force)
    there, _ = assemble(MESHES[kind], replace(sensor, projection=shift @ sensor.projection), grid).apply(
        ptr, node, force
    )
    keep = np.s_[..., max(down, 0) : 24 + min(down, 0), max(right, 0) : 32 + min(right, 0)]
    back = np.s_[..., max(-down, 0) : 24 + min(-down, 0), max(-right, 0) : 32 + min(-right, 0)]
    # The clipping's own rounding, 1e-13 of an area, is the only difference.
    assert np.abs(there[keep] - here[back]).max() <= 1e-9 * np.abs(force).max()


@settings(max_examples=30)
@given(st.floats(-1e3, 1e3), seeds)
def test_labels_are_linear_in_force(factor, seed):
    mesh = MESHES["tet10"]
    operator = assemble(mesh, load_sensors("workflow/sensors.toml")["gelsight_mini"], Grid(12, 16))
    ptr, node, force = random_forces(mesh, seed)
    once, many = operator.apply(ptr, node, force)[0], operator.apply(ptr, node, factor * force)[0]
    assert np.abs(many - factor * once).max() <= ROUNDING * max(1.0, abs(factor)) * np.abs(force).sum()


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(-50, 370), st.floats(-50, 290)), min_size=3, max_size=3), sides, sides)
def test_clipped_areas_add_up(corners, rows, cols):
    triangle = np.array([corners])
    whole = clip_to_grid(triangle, (1, 1), (320, 240))[2].sum()
    parts = clip_to_grid(triangle, (rows, cols), (320, 240))
    assert parts[2].sum() == pytest.approx(whole, rel=1e-9, abs=1e-7)  # px^2 of 76 800
    assert whole <= polygon_area(triangle)[0] * (1 + 1e-9) + 1e-7
    assert (parts[2] <= 320 / cols * 240 / rows * (1 + 1e-9)).all()


@settings(max_examples=60)
@given(seeds, st.sampled_from([1e-6, 1e-3, 1.0, 50.0]))
def test_rounding_to_float32_keeps_sums(seed, scale):
    rng = np.random.default_rng(seed)
    cells = rng.normal(0, scale, (4, 3, 9, 11)) * (rng.random((4, 3, 9, 11)) < 0.4)
    cells[1] = 0.0
    stored = to_float32(cells.ravel(), np.repeat(np.arange(12), 99), 12).reshape(cells.shape)
    assert stored.dtype == np.float32
    lost = np.abs(stored.astype(float).sum(axis=(2, 3)) - cells.sum(axis=(2, 3)))
    assert (lost <= 1e-9 * np.abs(cells).sum(axis=(2, 3))).all()
    # A cell gives up at most a thousandth of itself to hold what the others lost.
    assert (np.abs(stored - cells) <= 1.1e-3 * np.abs(cells)).all()
    assert (np.abs(stored - cells).reshape(4, 3, -1).sum(axis=-1) <= 2e-7 * np.abs(cells).sum(axis=(2, 3))).all()


def test_upright_faces_keep_their_nodes_force():
    """A face seen edge-on has no projected area: its nodes' force goes to the neighbours, a lone one to its point."""
    nodes = np.array([
        [0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, -2], [2, 0, -2], [4, 4, 0], [4, 4, -2], [5, 5, 0], [5, 5, -2]
    ], float)  # fmt: skip
    faces = np.array([[0, 1, 2, 3], [1, 0, 4, 5], [6, 8, 9, 7]])
    mesh = replace(MESHES["hex8"], nodes=nodes, faces=faces.astype(np.int32))
    sensor = load_sensors("workflow/sensors.toml")["gelsight_mini"]
    operator = assemble(mesh, sensor, Grid(240, 320))
    cells, outside = operator.apply(np.array([0, 1, 2, 3]), np.array([0, 4, 6]), np.eye(3))
    assert cells.sum(axis=(2, 3)) == pytest.approx(np.eye(3), abs=1e-12) and not outside.any()
    u, v = sensor.project(nodes[6])
    assert cells[2, 2, int(v), int(u)] == 1.0
    u, v = sensor.project(nodes[4])
    assert cells[1, 1, int(v), int(u)] == 1.0


def test_loads_of_a_patch_sum_to_the_traction_on_its_area():
    for mesh in MESHES.values():
        area = consistent_loads(mesh, lambda x, y: np.ones_like(x)).sum()
        moment = consistent_loads(mesh, lambda x, y: x).sum()
        assert area == pytest.approx(
            20.75 * 25.25, rel=0.04
        )  # dome and rim make the surface 3 % larger than its plan
        assert abs(moment) <= 0.02 * area


@settings(max_examples=60)
@given(sides, sides, st.lists(st.floats(0.05, 1.0), min_size=3, max_size=12), st.floats(1.0, 400.0), seeds)
def test_parts_of_a_star_add_up_too(rows, cols, spikes, size, seed):
    """A skewed face may bend inwards; cut at its spikes it has more corners than a convex one ever gets."""
    angle = 2 * np.pi * np.arange(len(spikes)) / len(spikes)
    middle = np.random.default_rng(seed).uniform([0, 0], [320, 240])
    star = (middle + size * np.array(spikes)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))[None]
    whole = clip_to_grid(star, (1, 1), (320, 240))[2].sum()
    parts = clip_to_grid(star, (rows, cols), (320, 240))[2].sum()
    assert parts == pytest.approx(whole, rel=1e-9, abs=1e-7)


def test_pieces_of_many_polygons_are_those_of_each_alone(block):
    """However many are cut at a time; some lie in many cells, some in one, some outside."""
    rng = np.random.default_rng(7)
    polygons = rng.uniform(-30.0, 350.0, (40, 1, 2)) + rng.uniform(1.0, 60.0, (40, 1, 1)) * rng.uniform(
        -1.0, 1.0, (40, 3, 2)
    )
    owner, cell, area = clip_to_grid(polygons, (6, 8), (320, 240))
    found = {(int(one), int(where)): size for one, where, size in zip(owner, cell, area, strict=True)}
    assert len(found) == len(owner) > 40
    alone = {}
    for at, polygon in enumerate(polygons):
        _, where, size = clip_to_grid(polygon[None], (6, 8), (320, 240))
        alone |= {(at, int(one)): value for one, value in zip(where, size, strict=True)}
    assert found == pytest.approx(alone)
