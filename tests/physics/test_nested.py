"""The path on coarse hexahedra and its end on fine ones: what is carried over, and how close it comes to the whole path."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build, load_catalogue
from gelforge.geometry.touch import width_of
from gelforge.mechanics.elements.element import ELEMENTS
from gelforge.mechanics.extrapolate import MOST, Convergence, Edge
from gelforge.mechanics.hexsettings import QUALITIES, HexSettings, Nested
from gelforge.mechanics.linear.factorisation import symmetric_solver
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.hexmesh import FineBox, build_mesh, dissected, elimination_order
from gelforge.mechanics.path.loadpath import frame_time, gaps
from gelforge.mechanics.path.transfer import (
    FLAT,
    LoadPath,
    surface_motion,
    touches,
    transferred,
    untangled,
    volume_motion,
)
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver, solve_hex
from gelforge.records.press import Press
from gelforge.records.status import Status
from tests.support.refused import refused

COARSE = build_mesh(Gel(), FineBox(-4, 4, -4, 4, 1.0), 3, 2.0)
FINE = build_mesh(Gel(), FineBox(-4, 4, -4, 4, 0.5), 5, 2.0)
STEPPED = build_mesh(Gel(), FineBox(-4, 4, -4, 4, 0.5), 5, 2.0, widened=(3, 1))
PATH = HexSettings(size=0.7, layers=4, layer_ratio=2.0, gauss=2, press_steps=6, shear_steps=3)
BALL = build("ball", {"kind": "sphere", "diameter": 15, "height": 10})
CUBOID = build("cuboid", {"kind": "cuboid", "size": [7, 7], "fillet": 1, "height": 10})


def heights_of(mesh):
    """Relative height (n,) of every node between base and top."""
    base, top = -Gel().height, np.asarray(Gel().top(mesh.nodes[:, 0], mesh.nodes[:, 1]))
    return (mesh.nodes[:, 2] - base) / (top - base)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_carrying_keeps_trilinear_fields(seed):
    """A displacement linear along x, y and relative height is interpolated to the fine nodes without error.

    Inside the rounded corners only: there mesh lines are bent, and places on a line are not evenly spaced.
    """
    k = np.random.default_rng(seed).normal(size=(3, 4))

    def field(mesh):
        x, y, h = mesh.nodes[:, 0], mesh.nodes[:, 1], heights_of(mesh)
        return np.stack([a + b * x + c * y * h + d * x * y for a, b, c, d in k], axis=1)

    straight = np.all(np.abs(FINE.nodes[:, :2]) < [8.0, 10.0], axis=1)
    found = transferred(COARSE, field(COARSE), FINE)
    np.testing.assert_allclose(found[straight], field(FINE)[straight], atol=1e-9)
    top = FINE.nodes[FINE.surface_nodes]
    inner = np.all(np.abs(top[:, :2]) < [8.0, 10.0], axis=1)
    moved = surface_motion(COARSE, field(COARSE), top[inner, :2])
    np.testing.assert_allclose(moved, field(FINE)[FINE.surface_nodes][inner], atol=1e-9)
    everywhere = volume_motion(COARSE, field(COARSE), FINE.nodes[straight], Gel())
    np.testing.assert_allclose(everywhere, field(FINE)[straight], atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 0.6))
@settings(max_examples=20)
def test_what_is_tangled_is_made_sound_and_what_is_sound_stays(seed, size):
    """Nodes thrown out of place turn hexahedra over; afterwards none is, the base holds, and the rest has not moved."""
    rng, hexahedra = np.random.default_rng(seed), ELEMENTS["hex8"].on(FINE.nodes, FINE.cells)
    at_rest = np.zeros_like(FINE.nodes)
    assert untangled(FINE, hexahedra, at_rest) is at_rest
    u = at_rest.copy()
    free = np.setdiff1d(np.arange(len(u)), FINE.base)
    thrown = rng.choice(free, 8, replace=False)
    u[thrown] = rng.uniform(-size, size, (8, 3))
    found = untangled(FINE, hexahedra, u)
    assert hexahedra.smallest_ratios(found).min() >= FLAT
    assert not found[FINE.base].any()
    flat = np.unique(FINE.elements[hexahedra.smallest_ratios(u) < FLAT])
    kept = np.setdiff1d(np.arange(len(u)), flat)
    np.testing.assert_array_equal(found[kept], u[kept])


@pytest.mark.parametrize(
    "name", ["triangle_8", *(pytest.param(name, marks=pytest.mark.slow) for name in ("cuboid_10", "cross_15_10_3"))]
)
def test_deep_presses_of_wide_shapes_take_the_short_way(name, root):
    """The gel bends round an edge within one wide hexahedron: what is carried over would turn small ones over."""
    found = solve_hex(deep_press(name, root), QUALITIES["draft"])
    assert found.status is Status.OK and found.evidence["load_steps"] == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, press",
    [
        ("cuboid_15", (-0.415982, 3.320796, 0, 0.003017, 0.218762, -1.924644, 82.545897)),
        ("bar_10", (-0.525477, -1.886135, 0, -0.369903, -0.011157, -1.999718, 213.811875)),
    ],
)
def test_a_press_that_bends_hexahedra_nearly_flat_takes_the_short_way(name, press, root):
    """At 250 N what is carried over is flat beside whole edges, and usual steps invert hexahedra: shorter ones do not."""
    body = load_catalogue(root / "workflow" / "indenters.toml")[name]
    found = solve_hex(Scene(Gel(), Material(), body, Press(*press)), QUALITIES["label"])
    assert found.status is Status.OK and found.evidence["load_steps"] == 0


@pytest.mark.slow
def test_a_deep_press_is_what_its_whole_path_gives(root):
    """In as many load steps: their number alone moves this force by 1 %."""
    nested = replace(QUALITIES["label"].nested, convergence=None, press_steps=6)
    plain = replace(QUALITIES["label"], nested=nested)
    short = solve_hex(deep_press("triangle_8", root), plain)
    whole = solve_hex(deep_press("triangle_8", root), replace(plain, nested=None, press_steps=6))
    assert np.linalg.norm(short.total - whole.total) < 0.005 * np.linalg.norm(whole.total)


def deep_press(name, root):
    body = load_catalogue(root / "workflow" / "indenters.toml")[name]
    return Scene(Gel(), Material(), body, Press(0.3, -0.5, 0, 0.1, 0.1, -1.9, 10))


def test_points_that_never_moved_touch_straight_above_them():
    """A ball that comes down on a gel at rest meets each point where the point is, whatever the steps."""
    points = FINE.nodes[FINE.surface_nodes]
    rest, times = np.zeros_like(COARSE.nodes), [0.0, 0.3, 0.7, 1.0]
    scene = Scene(Gel(), Material(), BALL, Press(0, 0, 0, 0, 0, -1.5))
    path = LoadPath(scene, COARSE, times, [rest] * len(times), 1e-6, [None] * len(times))
    held, places = touches(path, points)
    inside = gaps(path.scene, points, path.pose(1.0)) < 0.0
    assert inside.sum() > 50 and np.array_equal(held, inside)
    np.testing.assert_allclose(places[held][:, :2], points[held][:, :2], atol=1e-12)
    # the gap of a straight way is not straight in time: the place errs by what a step bends it
    assert np.abs(BALL.distance(places[held])[0]).max() < 0.02


@pytest.mark.parametrize(
    ("law", "body", "press"),
    [
        ("no_slip", BALL, Press(0, 0, 0, 0, 0, -1.0)),
        pytest.param("frictionless", BALL, Press(0, 0, 0, 0, 0, -1.0), marks=pytest.mark.slow),
        pytest.param("no_slip", CUBOID, Press(1, -2, 0, 0.3, 0.1, -1), marks=pytest.mark.slow),
    ],
)
def test_nested_and_whole_path_come_together_as_hexahedra_shrink(law, body, press):
    """Total force within 3 % on hexahedra of 1 mm, within 1.5 % on those of 0.5 mm: the difference falls like the size."""
    for size, bound in ((1.0, 0.03), (0.5, 0.015)):
        scene = Scene(Gel(), Material(), body, press, Interface(law))
        whole = solve_hex(scene, replace(PATH, size=size))
        nested = solve_hex(scene, replace(PATH, size=size, nested=Nested(layers=2)))
        assert whole.status is nested.status is Status.OK
        assert nested.evidence["load_steps"] == 0  # it did take the short way
        assert nested.evidence["pulling_fraction"] < 2e-3
        apart = np.linalg.norm(nested.total - whole.total) / np.linalg.norm(whole.total)
        assert apart < bound


@pytest.mark.slow
def test_extrapolation_brings_wide_hexahedra_closer_to_small_ones():
    """Forces are too large on wide hexahedra; one factor, found from two sizes, takes most of that back."""
    scene = Scene(Gel(), Material(), BALL, Press(0, 0, 0, 0, 0, -1.0))
    fine = np.linalg.norm(solve_hex(scene, replace(PATH, size=0.4, layers=7)).total)
    wide = replace(PATH, size=0.5, layers=5)
    plain = solve_hex(scene, replace(wide, nested=Nested(layers=3)))
    better = solve_hex(scene, replace(wide, nested=Nested(layers=3, convergence=Convergence(smooth=1 / 3))))
    assert abs(np.linalg.norm(better.total) - fine) < 0.5 * abs(np.linalg.norm(plain.total) - fine)
    np.testing.assert_allclose(better.forces, better.evidence["extrapolated"] * plain.forces, rtol=1e-12)
    end, *force = better.evidence["path"][-1]
    assert end == 1.0
    np.testing.assert_allclose(force, better.total, rtol=1e-9, atol=1e-12)
    pressed = better.contact.weights @ better.contact.traction
    np.testing.assert_allclose(pressed, better.total, rtol=1e-6, atol=1e-6)


def test_a_correction_is_the_share_of_what_the_sizes_differ_by_and_never_more_than_a_limit():
    edge = Edge(sharp=0.0, near=0.1, size=0.5, height=4.0)
    for difference, right in ((0.1, 0.1 / 3), (0.0, 0.0), (-0.1, -0.1 / 3), (2.0, MOST), (-0.9, -MOST)):
        found = Convergence(smooth=1 / 3).correction(edge, difference)
        assert found == pytest.approx(right, abs=1e-12) and abs(found) <= 0.15


@pytest.mark.parametrize(
    ("travel", "depth", "mu"), [(0.2, 0.5, 0.5), pytest.param(0.0, 1.0, 0.2, marks=pytest.mark.slow)]
)
def test_friction_is_carried_to_fine_hexahedra(travel, depth, mu):
    """A path on coarse hexahedra with a walk at its end gives the force of a path of many steps on the fine ones.

    Without the traction of slipping points the second, most of which slips, was 0.9 % low.
    """
    scene = Scene(Gel(), Material(), BALL, Press(0, 0, 0, travel, 0, -depth), Interface("coulomb", mu))
    small = replace(PATH, size=0.7)
    nested = solve_hex(scene, replace(small, nested=Nested()))
    whole = solve_hex(scene, replace(small, nested=None, press_mm=0.02, shear_mm=0.05))
    assert nested.evidence["newton_iterations"] < whole.evidence["newton_iterations"] / 3
    assert "fell_back" not in nested.evidence
    assert np.linalg.norm(nested.total - whole.total) < 0.006 * np.linalg.norm(whole.total)
    assert nested.evidence["beyond_cone"] < 1e-9 and 0.0 < nested.evidence["slipping"] <= 1.0


def test_width_of_plane_figures():
    x, y = np.meshgrid(np.arange(-5, 5, 0.05), np.arange(-6, 6, 0.04), indexing="ij")
    for inside, width in (
        (np.hypot(x, y) < 3.0, 6.0),
        (np.maximum(abs(x), abs(y)) < 2.5, 5.0 * 4 / np.pi),  # straight edges are not too long
        ((np.hypot(x, y) < 4.0) & (np.hypot(x, y) > 3.0), 2.0),
    ):
        assert width_of(inside, (0.05, 0.04)) == pytest.approx(width, rel=0.03)


@given(st.lists(st.booleans(), min_size=1, max_size=30), st.lists(st.booleans(), min_size=1, max_size=30))
def test_nested_dissection_takes_each_column_once(cuts_x, cuts_y):
    order = dissected(np.array(cuts_x), np.array(cuts_y))
    assert np.array_equal(np.sort(order), np.arange(len(cuts_x) * len(cuts_y)))


@pytest.mark.parametrize("mesh", [FINE, STEPPED])
def test_elimination_order_is_one_of_the_free_unknowns(mesh):
    assert np.array_equal(np.sort(elimination_order(mesh)), np.arange(3 * len(mesh.unknown)))


def test_an_indefinite_matrix_is_solved_after_a_definite_one():
    """Cholesky's method serves one, stops at the other, and serves again."""
    rng = np.random.default_rng(0)
    a = rng.normal(size=(30, 30))
    definite = a @ a.T + 30 * np.eye(30)
    saddle = definite.copy()
    saddle[15:, 15:] *= -1.0
    rows, columns = np.triu_indices(30)
    solver = symmetric_solver(np.concatenate([[0], np.cumsum(np.arange(30, 0, -1))]), columns)
    b = rng.normal(size=30)
    for matrix in (definite, saddle, definite):
        solver.factorise(matrix[rows, columns])
        np.testing.assert_allclose(matrix @ solver.solve(b), b, atol=1e-3)


FRAMED = HexSettings(
    size=0.5,
    across=12,
    layers=4,
    layer_ratio=2.0,
    gauss=2,
    nested=Nested(layers=3, press_steps=6, convergence=Convergence(smooth=0.36)),
)


def framed(body, depths, shear=()):
    presses = [Press(1, -2, 0, 0, 0, -depth) for depth in depths]
    presses += [Press(1, -2, 0, share * 0.3, share * 0.1, -depths[-1]) for share in shear]
    return [Scene(Gel(), Material(), body, press) for press in presses]


@pytest.mark.parametrize(("body", "shear"), [(BALL, ()), pytest.param(CUBOID, (0.5, 1.0), marks=pytest.mark.slow)])
def test_frames_of_one_press_are_what_single_presses_to_them_give(body, shear):
    scenes = framed(body, (0.4, 0.9), shear)
    solver = HexSolver(FRAMED)
    frames = solver.solve_frames(scenes)
    for scene, frame in zip(scenes, frames, strict=True):
        alone = HexSolver(replace(FRAMED, box=frames[-1].mesh_name.box)).solve(scene)
        assert frame.status is alone.status is Status.OK
        assert frame.evidence["pulling_fraction"] < 2e-3
        assert frame.mesh_name == alone.mesh_name
        apart = np.linalg.norm(frame.total - alone.total) / np.linalg.norm(alone.total)
        assert apart < 0.02  # the coarse path's load steps are not the same
        end, *force = frame.evidence["path"][-1]
        assert end == (2.0 if scene.press.dx else 1.0)
        np.testing.assert_allclose(force, frame.total, rtol=1e-9, atol=1e-12)
    last = solver.solve(scenes[-1]).total
    assert np.linalg.norm(frames[-1].total - last) / np.linalg.norm(last) < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize("law", [Interface("no_slip"), Interface("coulomb", 0.5)])
def test_frames_that_a_whole_path_passes_are_ends_of_shorter_ones(law):
    """Not nested: the contact of each frame is iterated where the path passes it, and the path goes on as if nobody had looked."""
    settings = replace(PATH, size=0.8)
    scenes = [replace(scene, interface=law) for scene in framed(CUBOID, (0.4, 0.9), (0.5, 1.0))]
    frames = HexSolver(settings).solve_frames(scenes)
    for scene, frame in zip(scenes, frames, strict=True):
        alone = solve_hex(scene, replace(settings, box=frames[-1].mesh_name.box))
        assert frame.status.valid and alone.status.valid
        assert np.linalg.norm(frame.total - alone.total) / np.linalg.norm(alone.total) < 0.02
        assert frame.evidence["path"][-1][0] == pytest.approx(2.0 if scene.press.dx else 1.0)
    assert len({id(frame.contact) for frame in frames}) == len(frames)


def test_frames_before_the_touch_and_alone_are_told_as_such():
    above = Scene(Gel(), Material(), BALL, Press(0, 0, 0.5, 0, 0, -0.2))
    deep = Scene(Gel(), Material(), BALL, Press(0, 0, 0.5, 0, 0, -1.0))
    first, last = HexSolver(FRAMED).solve_frames([above, deep])
    assert first.status is Status.NO_CONTACT and not first.forces.any()
    assert last.status is Status.OK


@given(
    st.lists(st.floats(0.05, 1.0), min_size=1, max_size=6),
    st.lists(st.floats(0.01, 0.5), max_size=4),
)
def test_frames_follow_the_path_in_order(steps, aside):
    scenes = framed(BALL, list(np.cumsum(steps)), [w / sum(aside) for w in np.cumsum(aside)] if aside else ())
    times = [frame_time(scene, scenes[-1]) for scene in scenes]
    assert times == sorted(times) and times[-1] == scenes[-1].press.end
    assert all(0.0 < t <= 2.0 for t in times)


def test_a_frame_is_the_nearest_point_of_its_path():
    for aside, down, last, expected in (
        ((0.0008, 0.0), 0.4, (0.3, 0.0), 0.4),  # a frame that gave way while the press went down
        ((0.0008, 0.0), 0.4, (0.0, 0.0), 0.4),  # of a press that goes down alone
        ((0.015, -0.01), 0.6, (0.3, 0.0), 0.6),
        ((0.15, 0.0), 0.99, (0.3, 0.0), 1.5),  # and one that gave way while it went sideways
        ((0.0, 0.0), 1.0, (0.3, 0.0), 1.0),
        ((0.3, 0.0), 1.0, (0.3, 0.0), 2.0),
    ):
        scene, end = (
            Scene(Gel(), Material(), BALL, Press(0, 0, 0, *way, -deep)) for way, deep in ((aside, down), (last, 1.0))
        )
        assert frame_time(scene, end) == pytest.approx(expected, abs=1e-9)


def test_a_frame_beyond_the_last_one_of_its_press_is_refused():
    """The state of the last one would be taken for it without a word."""
    end, straight = (Scene(Gel(), Material(), BALL, Press(0, 0, 0, dx, 0, -1.0)) for dx in (0.3, 0.0))
    for press, said in (
        (Press(0, 0, 0, 0.3, 0, -1.2), "0.2 mm deeper"),
        (Press(0, 0, -0.1, 0, 0, -1.0), "0.1 mm deeper"),
        (Press(0, 0, 0, 0.5, 0, -1.0), "0.2 mm farther sideways"),
    ):
        beyond = f"ends {said} than its last one, .* allowed; give frames in order"
        refused(beyond, frame_time, replace(end, press=press), end)
    refused("0.3 mm farther sideways", frame_time, end, straight)


@pytest.mark.slow
def test_a_frame_that_gave_way_aside_has_the_force_of_its_own_depth():
    """Half a micrometre aside at 0.4 mm is no press at full depth."""
    straight = framed(BALL, (0.4, 1.0), (1.0,))
    bent = [replace(straight[0], press=replace(straight[0].press, dx=5e-4)), *straight[1:]]
    solver = HexSolver(FRAMED)
    one, other = (solver.solve_frames(scenes)[0].total for scenes in (straight, bent))
    np.testing.assert_allclose(one[2], other[2], rtol=5e-3)


@pytest.mark.parametrize(
    "law", [Interface("no_slip"), pytest.param(Interface("coulomb", 0.5), marks=pytest.mark.slow)]
)
def test_frames_that_rounding_separates_are_one(law):
    """On coarse and fine hexahedra, and on one path where friction asks for it."""
    scenes = [
        Scene(Gel(), Material(), BALL, Press(0, 0, z0, 0, 0, dz), law)
        for z0, dz in ((0.1, -0.5), (0.105, -0.505), (0.1, -0.9))
    ]
    one, other, end = HexSolver(FRAMED).solve_frames(scenes)
    assert one.status is other.status is end.status is Status.OK
    assert one.total[2] == pytest.approx(other.total[2], rel=1e-6) and end.total[2] < 2.0 * one.total[2] < 0.0
    for frame in (one, other, end):
        times = [t for t, *_ in frame.evidence["path"]]
        assert len(times) > 1 and times == sorted(times) and times[-1] == 1.0
    one.evidence["attempt"] = "what is noted of one frame belongs to it alone"
    assert "attempt" not in other.evidence


@pytest.mark.parametrize(
    ("law", "z0", "deep"),
    [(Interface("no_slip"), 0.1, 1.0), (Interface("no_slip"), 0.3, 1.5), (Interface("coulomb", 0.5), 0.2, 1.0)],
)
def test_a_frame_at_the_first_touch_has_no_force(law, z0, deep):
    """Where the touch is known to a billionth of the path, a load step to it would be shorter than that."""
    scenes = [Scene(Gel(), Material(), BALL, Press(0, 0, z0, 0, 0, -way), law) for way in (z0, deep)]
    first, last = HexSolver(FRAMED).solve_frames(scenes)
    assert first.status is Status.NO_CONTACT and not first.forces.any()
    assert last.status is Status.OK
