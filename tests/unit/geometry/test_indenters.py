"""The catalogue: what it holds, closed forms, and what it refuses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.geometry import triangles
from gelforge.geometry.indenters import build, fold, load_catalogue, read_catalogue
from gelforge.geometry.profiles import regular_polygon
from gelforge.geometry.sampled import check_body


@pytest.fixture(scope="module")
def catalogue(root):
    return load_catalogue(root / "workflow" / "indenters.toml")


def table(kind, **keys):
    return {"kind": kind, "fillet": 0.5, "height": 8.0, **keys}


def test_standard_set_has_the_papers_numbers(catalogue):
    standard = [b for b in catalogue.values() if not b.spare]
    assert len(standard) == 24
    assert sum(not b.seen for b in standard) == 5


def test_every_surface_is_closed_outward_on_its_tip_and_within_a_hundredth_of_the_distance(catalogue):
    for name, body in catalogue.items():
        vertices, faces = body.surface()
        assert triangles.is_watertight(faces), name
        assert triangles.volume(vertices, faces) > 0.0, name
        # chords: the sampled tip of a sloping edge may miss its lowest point by a chord's height
        assert 0.0 <= vertices[:, 2].min() < 0.01, name
        assert body.radius() >= np.hypot(*vertices[:, :2].T).max() - 1e-9, name
        assert body.height == pytest.approx(vertices[:, 2].max(), abs=1e-9), name
        # corners lie on the body; only a boolean cut puts corners on chords
        assert np.abs(body.distance(vertices)[0]).max() < 0.005, name
        assert np.abs(body.distance(vertices[faces].mean(axis=1))[0]).max() < 0.01, name


@given(st.integers(0, 10**6), st.floats(5.0, 16.0), st.floats(0.0, 45.0), st.floats(0.1, 0.4))
@settings(max_examples=20)
def test_every_random_solid_is_a_body(seed, size, slope, fillet):
    """Closed, on its tip, as large as asked for at most, and its surface where its distance is 0."""
    table = {
        "kind": "random_solid",
        "seed": seed,
        "size": size,
        "slope_deg": max(slope, 0.1),
        "fillet": fillet,
        "height": 9,
    }
    body = build("solid", table)
    vertices, faces = body.surface()
    assert triangles.is_watertight(faces) and triangles.volume(vertices, faces) > 0.0
    assert 0.0 <= vertices[:, 2].min() < 0.01 and np.hypot(*vertices[:, :2].T).max() <= size / 2 + 1e-6
    assert np.abs(body.distance(vertices)[0]).max() < 0.005
    middles = vertices[faces].mean(axis=1)
    below = middles[:, 2] < body.height - fillet  # where a slope reaches the top, their edge is not rounded
    assert np.abs(body.distance(middles[below])[0]).max() < 0.01
    again, _ = build("again", table).surface()
    assert np.array_equal(again, vertices)


def test_sphere_is_a_sphere(catalogue):
    points = np.random.default_rng(1).uniform([-9, -9, -4], [9, 9, 7.4], (500, 3))
    # deeper than 2 mm the flat end of the shank may be nearer than the sphere
    points = points[np.linalg.norm(points - [0.0, 0.0, 7.5], axis=1) > 5.5]
    distance, normal = catalogue["sphere_15"].distance(points)
    away = points - [0.0, 0.0, 7.5]
    length = np.linalg.norm(away, axis=1)
    # rounding only: both are closed forms
    np.testing.assert_allclose(distance, length - 7.5, atol=1e-12)
    np.testing.assert_allclose(normal, away / length[:, None], atol=1e-12)


def test_cuboid_has_flat_wall_edge_and_corner(catalogue):
    points = np.array([[0, 0, -1], [7, 0, 5], [5 + 3, 0, 1 - 4], [4 + 2, 4 + 2, 1 - 1], [0, 0, 1], [0, 0, 11.0]])
    distance, normal = catalogue["cuboid_10"].distance(points)
    np.testing.assert_allclose(distance, [1, 2, np.hypot(4, 4) - 1, 3 - 1, -1, 1], atol=1e-12)
    np.testing.assert_allclose(normal[0], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(normal[3], np.array([2, 2, -1]) / 3.0, atol=1e-12)


def test_ellipse_distance_is_that_of_its_nearest_point():
    body = build("e", table("ellipse", size=[15, 10]))
    angle = np.linspace(0.0, 2.0 * np.pi, 40_001)
    edge = np.column_stack([7.5 * np.cos(angle), 5.0 * np.sin(angle)])
    points = np.random.default_rng(2).uniform(-9, 9, (100, 2))
    brute = np.array([np.linalg.norm(edge - p, axis=1).min() for p in points])
    distance = body.profile.distance(points)[0]
    # the brute-force edge is sampled every 0.001 mm
    np.testing.assert_allclose(np.abs(distance), brute, atol=1e-5)


def test_volume_approaches_the_sharp_body():
    for kind, keys, expected in (
        ("lying_cylinder", {"diameter": 6.0, "length": 12.0}, np.pi * 9.0 * 12.0),
        ("cuboid", {"size": [4.0, 6.0]}, 4.0 * 6.0 * 8.0),
        ("cross", {"size": [8.0, 10.0], "arm": 2.0}, (8.0 * 2.0 + 8.0 * 2.0) * 8.0),
        ("polygon", {"sides": 5, "side": 4.0}, 8.0 * 4.0**2 * 5.0 / (4.0 * np.tan(np.pi / 5.0))),
        ("outline", {"corners": [[0, 0], [5, 0], [5, 2], [2, 2], [2, 5], [0, 5]]}, 16.0 * 8.0),
        ("cylinder", {"diameter": 8.0, "hole": 4.0}, np.pi * (16.0 - 4.0) * 8.0),
        ("triple_triangle", {"side": 12.0, "wall": 1.0},
         8.0 * np.sqrt(3.0) / 4.0 * (12.0**2 - 3.0 * (12.0 / np.sqrt(12.0) - 1.0) ** 2)),
    ):  # fmt: skip
        height = {} if kind == "lying_cylinder" else {"height": 8.0}
        body = build("b", {"kind": kind, "fillet": 0.02, **height, **keys})
        # fillets of 0.02 mm and chords of 0.003 mm take well under 1 % away
        assert triangles.volume(*body.surface()) == pytest.approx(expected, rel=0.01), kind


# Two blocks of 8 x 3 mm with a neck of 1 x 4 mm between them.
BONE = [
    [-4, -5], [4, -5], [4, -2], [0.5, -2], [0.5, 2], [4, 2], [4, 5], [-4, 5], [-4, 2], [-0.5, 2], [-0.5, -2], [-4, -2],
]  # fmt: skip


def test_a_neck_is_as_wide_as_it_was_drawn():
    body = build("b", {"kind": "outline", "corners": BONE, "fillet": 0.4, "height": 8})
    assert body.distance(np.array([[0.6, 0.0, 4.0], [1.5, 0.0, 4.0]]))[0] == pytest.approx([0.1, 1.0])


WRONG = (
    ({"kind": "sphare", "diameter": 3}, "choose one of"),
    ({"kind": "sphere", "diameter": "3", "height": 5}, "diameter"),
    ({"kind": "sphere", "diameter": True, "height": 5}, "diameter"),
    ({"kind": "sphere", "diameter": float("nan"), "height": 5}, "diameter"),
    ({"kind": "sphere", "diameter": 5, "height": 5, "colour": 1}, "no such key"),
    ({"kind": "sphere", "diameter": 20, "height": 0}, "height"),
    ({"kind": "cuboid", "size": [5, 5], "fillet": 0, "height": 5}, "fillet = 0; give a number above 0"),
    ({"kind": "cuboid", "size": [5], "fillet": 1, "height": 5}, "two positive numbers"),
    ({"kind": "cuboid", "size": [1.5, 9], "fillet": 1, "height": 5}, "too large"),
    ({"kind": "cuboid", "size": [True, 5], "fillet": 1, "height": 5}, "two positive numbers"),
    ({"kind": "random_solid", "size": 9, "seed": 1.7, "fillet": 1, "height": 5}, "whole number"),
    ({"kind": "polygon", "sides": 5.5, "side": 4, "fillet": 0.5, "height": 8}, "sides = 5.5"),
    ({"kind": "sloping_cuboid", "size": [9, 9], "slope_deg": 100, "fillet": 1, "height": 9}, "slope_deg = 100"),
    ({"kind": "pyramid", "size": [9, 9], "slope_deg": 170, "fillet": 1, "height": 9}, "slope_deg = 170"),
    ({"kind": "sloping_cuboid", "size": [9, 9], "slope_deg": 89, "fillet": 1, "height": 2}, "above the height"),
    (
        {"kind": "random_solid", "size": 10, "slope_deg": 60, "seed": 1, "fillet": 0.5, "height": 1},
        "above the height",
    ),
    ({"kind": "cross", "size": [5, 12], "arm": 6, "fillet": 0.5, "height": 8}, "arm = 6.0"),
    ({"kind": "cross", "size": [10, 10], "arm": 3, "offset": 3.5, "fillet": 0.5, "height": 8}, "offset = 3.5"),
    ({"kind": "cross", "size": [10, 10], "arm": 3, "offset": -4.5, "fillet": 0.5, "height": 8}, "offset = -4.5"),
    ({"kind": "outline", "corners": BONE, "fillet": 0.6, "height": 8}, "narrowest part"),
    ({"kind": "cylinder", "diameter": 4, "fillet": 3, "height": 8}, "too large"),
    ({"kind": "cylinder", "diameter": 8, "hole": 6, "fillet": 0.8, "height": 8}, "too large"),
    ({"kind": "ellipse", "size": [8, 3], "fillet": 1, "height": 8}, "too large"),
    ({"kind": "cylinder", "diameter": 5, "hole": 6, "fillet": 0.1, "height": 5}, "does not fit"),
    ({"kind": "triple_triangle", "side": 5, "wall": 4, "fillet": 0.1, "height": 5}, "no hole"),
    ({"kind": "stl", "file": "nowhere.stl"}, "there is no file"),
    ({"kind": "cuboid", "size": [5, 5], "fillet": 1, "height": 5, "seen": "yes"}, "true or false"),
    ({"size": [5, 5]}, "kind"),
    ({"kind": "outline", "corners": [[0, 0], [5, 5], [5, 0], [0, 5]], "fillet": 0.1, "height": 5}, "cross"),
    ({"kind": "outline", "corners": [[0, 0], [5, 5]], "fillet": 0.1, "height": 5}, "three corners"),
    ({"kind": "outline", "corners": [[0, 0], [5, 0], [3, 0], [3, 4], [0, 4]], "fillet": 0.2, "height": 8}, "touch"),
    ({"kind": "outline", "corners": [[0, 0], [5, 10**400], [0, 5]], "fillet": 0.1, "height": 5}, "three corners"),
    ({"kind": "outline", "corners": [[0, 0], [5, "a"], [0, 5]], "fillet": 0.1, "height": 5}, "three corners"),
    ({"kind": "outline", "corners": [[0, 0], [5, float("inf")], [0, 5]], "fillet": 0.1, "height": 5}, "corners"),
)


def test_wrong_tables_are_refused_with_name_and_hint():
    for wrong, says in WRONG:
        with pytest.raises(BadInput, match="indenter wrong_one") as error:
            build("wrong_one", wrong)
        assert says in str(error.value), wrong


PLUS = [[-1, -3], [1, -3], [1, -1], [3, -1], [3, 1], [1, 1], [1, 3], [-1, 3], [-1, 1], [-3, 1], [-3, -1], [-1, -1]]


def test_edges_on_one_line_that_do_not_touch_are_no_crossing():
    """A plus drawn corner by corner is the cross of the same size."""
    drawn = build("p", {"kind": "outline", "corners": PLUS, "fillet": 0.2, "height": 8})
    cross = build("c", {"kind": "cross", "size": [6, 6], "arm": 2, "fillet": 0.2, "height": 8})
    points = np.random.default_rng(1).uniform([-4, -4, -1], [4, 4, 3], (500, 3))
    np.testing.assert_allclose(drawn.distance(points)[0], cross.distance(points)[0], atol=1e-12)


def test_a_table_that_no_body_has_comes_onto_itself_by_a_whole_turn():
    for sides in (float("inf"), float("nan"), "five", None):
        assert fold({"kind": "polygon", "sides": sides}) == 1


def test_catalogue_faults_name_the_file(tmp_path):
    path = tmp_path / "indenters.toml"
    path.write_text("a = 1\n")
    with pytest.raises(BadInput, match="outside any table"):
        load_catalogue(path)
    path.write_text("[a\n")
    with pytest.raises(BadInput, match="not valid TOML"):
        load_catalogue(path)
    with pytest.raises(BadInput, match="not found; name an existing catalogue"):
        load_catalogue(tmp_path / "none.toml")


def test_catalogue_names_are_looked_up(root):
    with pytest.raises(BadInput, match="no indenter named 'spere_15'; did you mean sphere_15"):
        load_catalogue(root / "workflow" / "indenters.toml", ["spere_15"])


def write_stl_catalogue(folder, mesh, **keys):
    triangles.write_stl(folder / "mine.stl", *mesh)
    lines = [f"{k} = {v}" for k, v in keys.items()]
    path = folder / "indenters.toml"
    path.write_text("\n".join(["[mine]", 'kind = "stl"', 'file = "mine.stl"', *lines]) + "\n")
    return path


def test_users_stl_comes_back_as_its_body(tmp_path, catalogue):
    original = catalogue["cuboid_7"]
    body = load_catalogue(write_stl_catalogue(tmp_path, original.surface()))["mine"]
    points = np.random.default_rng(3).uniform([-4.5, -4.5, -0.8], [4.5, 4.5, 4.0], (3000, 3))
    near = np.abs(original.distance(points)[0]) < 0.5
    # chords of 0.005 mm and a spline on 0.2 mm
    np.testing.assert_allclose(body.distance(points)[0][near], original.distance(points)[0][near], atol=0.015)
    assert body.radius() == pytest.approx(original.radius(), abs=0.01)


def test_files_that_are_no_body_are_refused_with_name_and_hint(tmp_path, catalogue):
    vertices, faces = catalogue["cuboid_7"].surface()
    pulled, aside = vertices.copy(), vertices + [4.5, 0.0, 0.0]
    pulled[np.argmax(vertices[:, 2])] = [0.0, 0.0, -5.0]
    for mesh, keys, says in (
        ((vertices / 1000.0, faces), {}, r"measures 0.007 x 0.007 x 0.01 mm .*1000 for a file in metres"),
        ((vertices, faces), {"scale": 1e-11}, "scale = 1e-11"),
        ((vertices, faces[:-1]), {}, "not closed.*holes"),
        ((pulled, faces), {}, "cut through each other.*repair"),
        ((aside, faces), {}, "1 mm beside the z axis"),
        ((vertices, faces), {"spacing": 0.01}, "coarser"),
    ):
        with pytest.raises(BadInput, match=rf"indenter mine.*{says}"):
            load_catalogue(write_stl_catalogue(tmp_path, mesh, **keys))
    path = write_stl_catalogue(tmp_path, (vertices / 1000.0, faces), scale=1000.0)
    assert load_catalogue(path)["mine"].height == pytest.approx(10.0, abs=1e-5)
    for content in (b"", b"\x89PNG not a mesh", bytes(80) + b"\xff\xff\xff\xff" + bytes(50)):
        (tmp_path / "mine.stl").write_bytes(content)
        with pytest.raises(BadInput, match=r"indenter mine.*mine\.stl"):
            load_catalogue(path)


def test_a_file_is_measured_once_until_it_changes(tmp_path, catalogue):
    """What was kept is the same to the last bit, and a damaged one is measured again."""
    path, kept = write_stl_catalogue(tmp_path, catalogue["cuboid_7"].surface()), tmp_path / "surfaces"
    table = read_catalogue(path)["mine"]
    points = np.random.default_rng(3).uniform(-4.0, 4.0, (500, 3))

    def measured():
        found = build("mine", table, path, kept=kept)
        return *found.surface(), *found.distance(points)

    def same(one, other):
        return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))

    first, own = measured(), build("mine", table, path)
    assert same(first, (*own.surface(), *own.distance(points)))
    (file,) = kept.glob("*.npz")
    before = file.stat().st_mtime_ns
    assert same(measured(), first) and file.stat().st_mtime_ns == before
    file.write_bytes(file.read_bytes()[:200])
    assert same(measured(), first) and file.stat().st_mtime_ns > before
    write_stl_catalogue(tmp_path, catalogue["cuboid_10"].surface())
    assert not np.array_equal(measured()[2], first[2]) and len(list(kept.glob("*.npz"))) == 2


def test_inward_triangles_are_turned(catalogue):
    vertices, faces = catalogue["cuboid_7"].surface()
    assert triangles.volume(*check_body(vertices, faces[:, ::-1], "inward")) > 0.0


def test_ears_cover_a_polygon_with_notches():
    comb = np.array(
        [[0, 0], [7, 0], [7, 3], [6, 3], [6, 1], [4, 1], [4, 3], [3, 3], [3, 1], [1, 1], [1, 3], [0, 3]], float
    )
    a, b, c = comb[triangles.ears(comb)].transpose(1, 0, 2)
    area = ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])) / 2.0
    assert (area >= 0.0).all()
    assert area.sum() == pytest.approx(7.0 + 3 * 2.0)


def test_regular_polygon_has_its_side():
    corners = regular_polygon(6, 5.0, 0.0)
    assert np.linalg.norm(corners[0] - corners[1]) == pytest.approx(5.0)


def test_the_widest_fillet_still_stands_on_its_tip():
    """The distance that solves use is zero where the surface that is posed is lowest."""
    for made in (
        {"kind": "cylinder", "diameter": 4, "fillet": 2, "height": 8},
        {"kind": "cylinder", "diameter": 8, "hole": 6, "fillet": 0.5, "height": 8},
        {"kind": "ellipse", "size": [8, 4], "fillet": 1, "height": 8},
    ):
        body = build("b", made)
        vertices, _ = body.surface()
        lowest = vertices[np.argmin(vertices[:, 2])]
        assert lowest[2] == pytest.approx(0.0, abs=1e-9)
        assert body.distance(lowest[None])[0][0] == pytest.approx(0.0, abs=1e-6)
