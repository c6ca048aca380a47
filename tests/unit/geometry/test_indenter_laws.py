"""Laws that every indenter's distance obeys."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.geometry.indenters import FOLDS, build, fold, load_catalogue, read_catalogue
from gelforge.records.press import Press
from tests.support.sandbox import ROOT

CATALOGUE = ROOT / "workflow" / "indenters.toml"
EXTRA = {
    "lying": {"kind": "lying_cylinder", "diameter": 7.0, "length": 12.0, "fillet": 0.8},
    "disc": {"kind": "ellipse", "size": [9.0, 4.0], "fillet": 0.3, "height": 5.0},
    "hook": {"kind": "outline", "corners": [[-4, -4], [4, -4], [4, 0], [0, 0], [0, 5], [-4, 5]], "fillet": 0.7,
             "height": 6.0},
    "lens": {"kind": "sphere", "diameter": 40.0, "height": 2.5},
    "sharp": {"kind": "cuboid", "size": [6.0, 3.0], "fillet": 0.01, "height": 5.0},
}  # fmt: skip
TABLES = read_catalogue(CATALOGUE) | EXTRA
BY_KIND = {kind: [name for name, table in TABLES.items() if table["kind"] == kind]
           for kind in sorted({table["kind"] for table in TABLES.values()})}  # fmt: skip
BODIES = {kind: st.sampled_from(names) for kind, names in BY_KIND.items()}
SEEDS = st.integers(0, 2**32 - 1)
EACH_KIND = pytest.mark.parametrize("kind", BY_KIND)


@cache
def body(name):
    return build(name, EXTRA[name]) if name in EXTRA else load_catalogue(CATALOGUE, [name])[name]


def draw(name, seed, count=200):
    r = body(name).radius() + 2.0
    return np.random.default_rng(seed).uniform([-r, -r, -2.0], [r, r, body(name).height + 2.0], (count, 3))


@EACH_KIND
@given(data=st.data(), seed=SEEDS)
@settings(max_examples=8)
def test_distance_never_changes_faster_than_the_point_moves(kind, data, seed):
    name = data.draw(BODIES[kind])
    a = draw(name, seed)
    b = a + np.random.default_rng(seed).normal(size=a.shape) * np.geomspace(1e-6, 3.0, len(a))[:, None]
    change = np.abs(body(name).distance(a)[0] - body(name).distance(b)[0])
    # 1e-9 mm is rounding in the hull of a polyhedron
    assert (change <= np.linalg.norm(a - b, axis=1) + 1e-8).all()


@EACH_KIND
@given(data=st.data(), seed=SEEDS)
@settings(max_examples=6)
def test_normal_is_the_gradient_has_length_one_and_leads_to_a_foot_on_the_surface(kind, data, seed):
    name = data.draw(BODIES[kind])
    p, h = draw(name, seed), 1e-5
    distance, normal = body(name).distance(p)
    # rounding only
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-9)
    ahead, behind = body(name).distance(p + h * normal)[0], body(name).distance(p - h * normal)[0]
    slope = (ahead - behind) / (2.0 * h)
    # at a ridge of the distance (a set of measure zero, here h wide) the slope is that of either side
    assert np.quantile(np.abs(slope - 1.0), 0.98) < 1e-4
    outside = p[distance > 0.0]
    # below the sharp ridge where fillets of the thin walls of three triangles meet, the distance is that to one
    # fillet, less than that to the ridge: the first foot lies outside, its own foot on the surface
    for _ in range(2 if name == "zelda_15" else 1):
        d, n = body(name).distance(outside)
        assert (d >= -1e-7).all()
        outside = outside - d[:, None] * n
    assert (np.abs(body(name).distance(outside)[0]) <= 2e-7).all()


@EACH_KIND
@given(data=st.data(), seed=SEEDS)
@settings(max_examples=3)
def test_a_turn_that_brings_a_body_onto_itself_changes_no_distance(kind, data, seed):
    name = data.draw(BODIES[kind])
    order = fold(TABLES[name])
    angle = np.deg2rad(360.0 / order) if order else np.random.default_rng(seed).uniform(0.0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    p = draw(name, seed)
    np.testing.assert_allclose(body(name).distance(p @ turn.T)[0], body(name).distance(p)[0], atol=1e-6)


@pytest.mark.parametrize("name", [name for names in BY_KIND.values() for name in names[:: max(1, len(names) - 1)]])
def test_sign_agrees_with_the_surface(name):
    import pyvista

    p = draw(name, 7, 1500)
    d, _ = body(name).distance(p)
    vertices, faces = body(name).surface()
    mesh = pyvista.PolyData.from_regular_faces(vertices, faces)
    mesh_distance = np.asarray(pyvista.PolyData(p).compute_implicit_distance(mesh)["implicit_distance"])
    # chords are within 0.01 mm, so beyond that both must say the same side
    sure = np.abs(d) > 0.02
    np.testing.assert_array_equal(np.sign(d[sure]), np.sign(mesh_distance[sure]))
    # outside the distance is exact but for chords (0.01 mm) and the ridges of the three triangles (see above)
    outside = d > 0.02
    rough = 0.05 * d[outside] if name == "zelda_15" else 0.0
    assert (np.abs(mesh_distance - d)[outside] <= 0.01 + rough).all()


@given(
    SEEDS, st.floats(-3, 3), st.floats(-5, 5), st.floats(-180, 180), st.floats(0, 1), st.floats(0, 1),
    st.sampled_from(sorted(TABLES)),
)  # fmt: skip
@settings(max_examples=20)
def test_a_moved_indenter_keeps_its_distances(seed, x, y, turn, press, shear, name):
    rotation, shift = Press(x, y, 0.2, 0.3, -0.4, -1.5, turn).pose(press, shear)
    p = draw(name, seed, 50)
    d, n = body(name).distance(p)
    world = p @ rotation.T + shift
    moved, normal = body(name).distance((world - shift) @ rotation)
    # rounding of one rotation and its inverse
    np.testing.assert_allclose(moved, d, atol=1e-9)
    steady = np.abs(normal - n).max(axis=1) < 1e-6
    assert steady.mean() > 0.9


@given(
    kind=st.sampled_from(["cuboid", "polygon", "pyramid", "sloping_cuboid", "cylinder"]),
    size=st.floats(4.0, 20.0),
    fillet=st.floats(0.05, 1.2),
    slope=st.floats(3.0, 35.0),
)
@settings(max_examples=25)
def test_any_size_builds_a_body_whose_surface_is_on_its_distance(kind, size, fillet, slope):
    keys = {
        "cuboid": {"size": [size, size / 2.0 + 1.0]},
        "polygon": {"sides": 5, "side": size},
        "pyramid": {"size": [size, size], "slope_deg": slope},
        "cylinder": {"diameter": size},
        "sloping_cuboid": {"size": [size, size], "slope_deg": slope},
    }[kind]
    shape = build("any", {"kind": kind, "height": 8.0, "fillet": fillet, **keys})
    vertices, faces = shape.surface()
    # surface corners lie on the body; 1e-6 is rounding in the hull
    assert np.abs(shape.distance(vertices)[0]).max() < 1e-6
    assert np.abs(shape.distance(vertices[faces].mean(axis=1))[0]).max() < 0.01


ROUND = {
    "square": {"kind": "cuboid", "size": [5.0, 5.0], "fillet": 0.4, "height": 5.0},
    "oblong": {"kind": "cuboid", "size": [5.0, 4.0], "fillet": 0.4, "height": 5.0},
    "circle": {"kind": "ellipse", "size": [6.0, 6.0], "fillet": 0.3, "height": 5.0},
}


def turned_away(one, points: np.ndarray, degrees: float) -> float:
    """How far a body's distance at some points changes where it is turned about its axis, mm."""
    way = np.deg2rad(degrees)
    turn = np.array([[np.cos(way), -np.sin(way), 0], [np.sin(way), np.cos(way), 0], [0, 0, 1]])
    return float(np.abs(one.distance(points @ turn.T)[0] - one.distance(points)[0]).max())


def test_a_body_has_the_symmetry_that_is_stated_of_it_and_no_finer_one():
    """Turned by 360 degrees over its fold it is the same body; by half, a third or a fifth of that it is another."""
    points = np.random.default_rng(3).uniform([-8, -8, -0.5], [8, 8, 3.0], (150, 3))
    some = {name: TABLES[name] for kind, names in BY_KIND.items() if kind in FOLDS for name in names[:2]}
    for name, table in (some | ROUND).items():
        one, order = (build(name, table) if name in EXTRA | ROUND else body(name)), fold(table)
        turns = (17.0, 90.0) if order == 0 else (360.0 / order,)
        assert max(turned_away(one, points, turn) for turn in turns) < 1e-6, name
        if order > 0:
            assert min(turned_away(one, points, 360.0 / order / part) for part in (2, 3, 5)) > 1e-3, name
