"""Gel meshes: what a name means, which one a press takes, and what pytetwild must keep."""

import signal
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, write_json
from gelforge.geometry.gel import GELS, load_gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.family import (
    MeshFamily,
    MeshName,
    choose_mesh,
    first_candidate,
    load_mesh,
    placed,
    region,
    required_meshes,
    sizing,
    unplaced,
)
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.meshstore import SHIPPED, MeshSource, add
from gelforge.mechanics.mesh.moved import RASTER_MM, ROUNDING_MM, moved, reach, way_to
from gelforge.mechanics.mesh.tetmesh import (
    EDGES,
    bend,
    boundary_faces,
    gel_mesh,
    jacobians,
    kuhn_grid,
    mesh_report,
    orient,
    prism,
    scaled_jacobians,
    second_order,
    signed_volumes,
    sizing_grid,
    split_long_edges,
    tetrahedralise,
)
from gelforge.mechanics.scene import Scene
from gelforge.records.press import Press
from tests.conftest import process_signals
from tests.support.blocks import symmetric_block
from tests.support.parameters import parameters, with_values
from tests.support.refused import refused

GEL = GELS["gelsight_mini"]
TABLE = replace(
    parameters().meshes, growth=0.4, coarsest_mm=4.0, fine_depth_mm=0.6, hold={},
    regions={"centre": (4.0, 4.0), "wide": (9, 11)},
)  # fmt: skip


SIZING, HOLD = sizing((4.0, 4.0), 2.0, TABLE), 1.3


@pytest.fixture(scope="module")
def mesh():
    """The one mesh of the usual gel that is made here: pytetwild takes ten seconds and more."""
    return gel_mesh(GEL, SIZING, longest=lambda points: HOLD * SIZING(points))


def test_an_interrupt_after_meshing_is_still_one_that_python_can_answer():
    # pytetwild lets SIGINT end the process
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        before = process_signals()
        square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
        tetrahedralise(*prism(square, 3.0), edge_length_fac=0.5, epsilon=0.02, num_threads=1, optimize=False)
        assert process_signals() == before
    finally:
        signal.signal(signal.SIGINT, handler)


def test_gel_of_tetrahedra_keeps_its_shape(mesh):
    report = mesh_report(mesh, GEL)
    top = mesh.nodes[mesh.surface_nodes]
    np.testing.assert_allclose(top[:, 2], GEL.top(top[:, 0], top[:, 1]), atol=1e-12)
    assert set(mesh.nodes[mesh.base, 2]) == {-GEL.height}
    # the outline's arcs are polygons of four sides, and edges 3 mm long cut the fall to the rim
    assert abs(report["volume_error"]) < 5e-3
    assert report["min_scaled_jacobian"] > 0.2
    assert report["min_volume"] > 0


def test_top_faces_look_outward_and_cover_the_outline(mesh):
    a, b, c = (mesh.nodes[mesh.faces[:, i]] for i in range(3))
    up = np.cross(b - a, c - a)[:, 2]
    assert up.min() > 0
    corners = 4 * GEL.corner_radius**2 * (1 - np.pi / 4)
    assert up.sum() / 2 == pytest.approx(GEL.width * GEL.length - corners, rel=2e-3)
    middles = (mesh.nodes[mesh.faces[:, [0, 1, 2]]] + mesh.nodes[mesh.faces[:, [1, 2, 0]]]) / 2
    np.testing.assert_allclose(mesh.nodes[mesh.faces[:, 3:], :2], middles[..., :2], atol=1e-12)


def test_second_order_mesh_is_closed(mesh):
    faces = boundary_faces(mesh.elements[:, :4])
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)


def test_splitting_keeps_the_body_and_leaves_no_long_edge():
    def longest(points):
        return 0.1 + 0.3 * np.abs(points[:, 0])

    nodes, tets = split_long_edges(*kuhn_grid([np.linspace(0, 1, 4)] * 3), longest)
    tets = orient(nodes, tets)
    ends = nodes[tets[:, EDGES].reshape(-1, 2)]
    assert (np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) <= longest(ends.mean(axis=1))).all()
    assert signed_volumes(nodes, tets).sum() == pytest.approx(1.0, rel=1e-12)
    # conforming: what belongs to one element only is the cube's own skin, and no two nodes are one
    a, b, c = (nodes[boundary_faces(tets)[:, i]] for i in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(6.0, rel=1e-12)
    assert len(np.unique(np.round(nodes, 9), axis=0)) == len(nodes)


def test_a_held_mesh_is_as_fine_as_asked(mesh):
    flat = mesh.nodes[mesh.elements[:, :4][:, EDGES].reshape(-1, 2)] * [1, 1, 0]
    on_top = np.isin(mesh.elements[:, :4][:, EDGES].reshape(-1, 2), mesh.surface_nodes).all(axis=1)
    length = np.linalg.norm(flat[:, 0] - flat[:, 1], axis=1)[on_top]
    assert (length <= HOLD * SIZING(flat.mean(axis=1))[on_top] + 1e-9).all()


@pytest.mark.slow
def test_a_steep_rim_inverts_no_element():
    """Edges are 4 mm long where the top falls 3 mm within 2 mm; bowed onto the surface they would invert elements."""
    dome = load_gel("dome")
    assert mesh_report(gel_mesh(dome, sizing((2.0, 2.0), 1.5, TABLE)), dome)["min_scaled_jacobian"] >= 0.1


def test_sizing_grid_fills_the_gel():
    vertices, tets, values = sizing_grid(GEL, lambda p: 1 + 0 * p[:, 0])
    volume = signed_volumes(vertices, tets)
    assert volume.min() > 0
    assert volume.sum() == pytest.approx(np.prod(np.ptp(vertices, axis=0)))
    assert len(values) == len(vertices)


def test_names_that_mean_nothing_are_refused():
    for name in ("ccx-centre", "hex-centre-1.0", "ccx-centre-0.05", "fem-centre-1.0", "ccx-../x-1.0"):
        refused("ccx-REGION-SIZE", MeshName.parse, name)


def test_required_meshes_need_known_regions():
    fea = with_values(parameters().fea, method="ccx", meshes=["centre-0.7", "wide-1.0"])
    assert required_meshes(fea, TABLE) == ["ccx-centre-0.7", "ccx-wide-1.0"]
    assert required_meshes(with_values(fea, method="draft"), TABLE) == []
    with pytest.raises(BadInput, match="edge"):
        required_meshes(with_values(fea, meshes=["edge-1.0"]), TABLE)


def test_a_narrow_contact_takes_the_finer_mesh_of_its_region(tmp_path, mesh):
    """A ball's contact is as wide as it is; a tube's is twice its wall."""
    for size in (0.45, 0.35, 0.25):
        mesh.save(tmp_path / f"ccx-centre-{size}.npz")
        write_json(
            tmp_path / f"ccx-centre-{size}.json", {"half_mm": [6.0, 6.0], "reach_mm": [2.0, 3.0], "size": size}
        )
    family = MeshFamily(tmp_path, [f"ccx-centre-{size}" for size in (0.45, 0.35, 0.25)])

    def chosen(**table):
        body = build("body", table | {"height": 10})
        return choose_mesh(Scene(GEL, Material(), body, Press(0, 0, 0, 0, 0, -0.8)), family)

    assert chosen(kind="sphere", diameter=15) == "ccx-centre-0.45"
    assert chosen(kind="ellipse", size=[10, 10], hole=[7, 7], fillet=0.5) == "ccx-centre-0.25"


@given(st.floats(-9, 9), st.floats(0, 6), st.sampled_from([2.0, 4.0, 5.7]), st.integers(0, 5))
@example(-1.0, 5.0 + 1e-13, 4.0, 5)
@example(-1.0, 5.5 + 1e-13, 4.0, 5)
@example(-4.0 - 1e-13, 1.0, 4.0, 5)
@example(-4.5 - 1e-13, 1.0, 4.0, 5)
@example(-4.0, 8.0 + 1e-13, 4.0, 5)
def test_the_fine_part_goes_as_little_as_it_must(low, width, half, far):
    """The least multiple of the raster that holds what is touched, if there is one, to a millionth of a micrometre."""
    high = low + width
    steps = RASTER_MM * np.arange(-far / RASTER_MM, far / RASTER_MM + 1)
    ways = [way for way in steps if -half + way <= low + ROUNDING_MM and high - ROUNDING_MM <= half + way]
    found = way_to(low, high, half, far)
    assert found == (min(ways, key=abs) if ways else None)
    assert "-0" not in placed("ccx-centre-0.7", (found or 0.0, 0.5)).split("@")[1].split(":")


@pytest.mark.parametrize("fraction", [(0.5, 0), (-1, 1)])
def test_a_moved_mesh_is_as_sound_and_as_fine(mesh, fraction):
    far = reach(mesh, GEL, (4.0, 4.0))
    assert min(far) >= 1.0  # of elements as wide as half of the fine part; those of labels go two to six
    way = tuple(np.round(np.multiply(fraction, far)))
    there = moved(mesh, GEL, (4.0, 4.0), way)
    report, before = mesh_report(there, GEL), mesh_report(mesh, GEL)
    assert report["min_scaled_jacobian"] > 0.1
    assert report["volume"] == pytest.approx(before["volume"], rel=2e-3)
    assert set(there.nodes[there.base, 2]) == {-GEL.height}
    top = there.nodes[there.surface_nodes]
    np.testing.assert_allclose(top[:, 2], GEL.top(top[:, 0], top[:, 1]), atol=1e-9)
    np.testing.assert_allclose(np.ptp(there.nodes[:, :2], axis=0), [GEL.width, GEL.length], atol=1e-9)
    # elements of the fine part go along as they are
    fine = np.all(np.abs(mesh.nodes[mesh.elements][:, :, :2]) <= 4.0, axis=(1, 2))
    went = (there.nodes - mesh.nodes)[mesh.elements[fine], :2]
    assert fine.sum() > 10
    np.testing.assert_allclose(went, np.broadcast_to(way, went.shape), atol=1e-9)


def one_element(bow: float) -> GelMesh:
    """A tetrahedron between the fine part and the rim, one of its edges bowed along itself by `bow` mm."""
    corners = np.array([[5.0, 0, -3], [9, 0, -3], [5, 3, -3], [5, 0, -1]])
    middles = corners[EDGES].mean(axis=1)
    middles[EDGES.tolist().index([0, 1]), 0] += bow
    nodes = np.concatenate([corners, middles])
    return GelMesh("tet10", nodes, np.arange(10)[None], np.zeros((0, 6), int), np.zeros(0, int))


def test_no_element_is_turned_inside_out_by_a_bowed_edge():
    """Its corners span a volume wherever it goes; bowed edges grow as the edge itself gets shorter."""
    straight, bowed = (reach(one_element(bow), GEL, (4.0, 4.0))[0] for bow in (0.0, 0.6))
    assert 1.0 <= bowed < straight
    ends = [moved(one_element(0.6), GEL, (4.0, 4.0), (way, 0.0)) for way in (bowed, straight)]
    sound, turned = (jacobians(end.nodes, end.elements).min() for end in ends)
    assert sound > 0 > turned


def test_an_element_is_judged_within_its_bowed_edges():
    """One at a rounded corner, where the top falls: moved, its straight edges cross, and it is far from inverted."""
    flat = np.array([[-9.79, -11.44, -0.56], [-10.37, -11.12, 0], [-10.26, -11.7, 0], [-9.94, -12.19, 0]])
    nodes, elements, _ = second_order(flat, orient(flat, np.arange(4)[None]))
    nodes[:, 2] = bend(GEL, nodes)
    mesh = GelMesh("tet10", nodes, elements, np.zeros((0, 6), int), np.zeros(0, int))
    assert reach(mesh, GEL, (4.0, 4.0)) == (4.0, 6.0)  # as far as the rim lets it go
    end = moved(mesh, GEL, (4.0, 4.0), (4.0, 6.0))
    assert signed_volumes(end.nodes, end.elements[:, :4])[0] < 0
    assert scaled_jacobians(jacobians(end.nodes, end.elements))[0] > 0.3


@given(st.integers(-9, 9), st.integers(-9, 9))
def test_a_name_says_where_the_fine_part_lies(x, y):
    name = placed("ccx-centre-0.45", (x, y))
    assert unplaced(name) == ("ccx-centre-0.45", (x, y))
    assert (name == "ccx-centre-0.45") == (x == y == 0)


def test_a_moved_mesh_comes_from_the_file_of_the_one_in_the_middle(tmp_path, mesh):
    mesh.save(tmp_path / "ccx-centre-0.7.npz")
    report = {"half_mm": [4.0, 4.0], "reach_mm": [2.0, 3.0], "size": 0.7, "gel": GEL.name}
    write_json(tmp_path / "ccx-centre-0.7.json", report)
    found = load_mesh(tmp_path, "ccx-centre-0.7@2:-3")
    np.testing.assert_array_equal(found.nodes, moved(mesh, GEL, (4.0, 4.0), (2.0, -3.0)).nodes)
    assert load_mesh(tmp_path, "ccx-centre-0.7").nodes.tolist() == mesh.nodes.tolist()
    with pytest.raises(BadInput, match="make meshes"):
        load_mesh(tmp_path, "ccx-wide-0.7@2:-3")
    for far in ("2.5:0", "0:-9"):  # elements beside the fine part would be flat or inverted
        with pytest.raises(BadInput, match="cannot go that far"):
            load_mesh(tmp_path, f"ccx-centre-0.7@{far}")
    (tmp_path / "ccx-centre-0.7.json").unlink()
    with pytest.raises(BadInput, match="ccx-centre-0.7.json: .* make meshes"):
        load_mesh(tmp_path, "ccx-centre-0.7@2:-3")


def test_a_press_takes_the_smallest_fine_part_that_holds_its_footprint(tmp_path, mesh):
    halves = {"ccx-centre-0.7": [4.0, 4.0], "ccx-wide-1.0": [9.0, 11.0], "ccx-wide-0.2": [9.0, 11.0]}
    for name, half in halves.items():
        mesh.save(tmp_path / f"{name}.npz")
        report = {"engine": "ccx", "half_mm": half, "reach_mm": [3.0, 4.0], "size": float(name[-3:])}
        write_json(tmp_path / f"{name}.json", report)
    family = MeshFamily(tmp_path, list(halves))
    ball = build("ball", {"kind": "sphere", "diameter": 10, "height": 8})
    block = build("block", {"kind": "cuboid", "size": [14, 14], "fillet": 1, "height": 8})

    def chosen(body, x):
        scene = Scene(GEL, Material(), body, Press(x, 0, 0, 0, 0, -1.0))
        return choose_mesh(scene, family)

    assert chosen(ball, 0) == "ccx-centre-0.7"
    assert chosen(ball, 3) == "ccx-centre-0.7@2:0"  # the small fine part is moved there
    assert chosen(ball, -3) == "ccx-centre-0.7@-2:0"
    assert chosen(ball, 5) == "ccx-wide-0.2"  # where it cannot go; under a ball do not fit ten elements of 1 mm
    assert chosen(block, 0) == "ccx-wide-1.0"
    # and where none holds what is touched
    family = MeshFamily(tmp_path, ["ccx-wide-1.0", "ccx-wide-0.2"])
    family.reports = {
        name: reported | {"half_mm": [2.0, 2.0], "reach_mm": [0.0, 0.0]} for name, reported in family.reports.items()
    }
    assert (chosen(ball, 5), chosen(block, 0)) == ("ccx-wide-0.2", "ccx-wide-1.0")
    with pytest.raises(BadInput, match="make meshes"):
        MeshFamily(tmp_path, ["ccx-centre-0.5"])


def kept_meshes(folder, gel, table, names):
    """A source of meshes of these names, which lie in a folder as if they had been made there."""
    source = MeshSource(gel, table, folder)
    for at, name in enumerate(names):
        half, size = region(MeshName.parse(name), table), 5.0 - 0.25 * at
        report = {"half_mm": list(half), "reach_mm": [3.0, 4.0], "gel": gel.name, "recipe": source.key(name)}
        add(folder, name, symmetric_block(gel, size, 1), report)
    return source


def test_only_the_meshes_that_presses_take_come_into_a_dataset(tmp_path):
    names = ["ccx-centre-0.7", "ccx-wide-1.0", "ccx-wide-0.2"]
    source = kept_meshes(tmp_path / "kept", GEL, TABLE, names)
    ball = build("ball", {"kind": "sphere", "diameter": 10, "height": 8})
    near, far = (Scene(GEL, Material(), ball, Press(x, 0, 0, 0, 0, -1.0)) for x in (3, 5))

    def chosen(scene, source=source):
        family = MeshFamily(tmp_path / "20_meshes", names, source)
        return choose_mesh(scene, family)

    def there():
        return sorted(path.name.rpartition("-")[0] for path in (tmp_path / "20_meshes").glob("*.npz"))

    first = chosen(near)
    assert first.startswith("ccx-centre-0.7-") and first.endswith("@2:0") and there() == ["ccx-centre-0.7"]
    # asked before any mesh is there: how far one really goes is known of those that are
    assert first_candidate(near, MeshFamily(tmp_path / "none", names, source)) == "ccx-centre-0.7"
    assert not (tmp_path / "none").exists()
    mesh = load_mesh(tmp_path / "20_meshes", unplaced(first)[0])
    assert unplaced(first)[0] == f"ccx-centre-0.7-{mesh.digest}", "its name holds the content"
    assert chosen(far).startswith("ccx-wide-0.2-") and there() == ["ccx-centre-0.7", "ccx-wide-0.2"]
    # the dataset has its own copy; where that is lost it comes back byte for byte, for another dataset, too
    (path,) = (tmp_path / "20_meshes").glob("ccx-centre*.npz")
    before = path.read_bytes()
    path.unlink()
    assert chosen(near) == first and path.read_bytes() == before
    # sizes, gradings and gels that differ are other meshes, whatever they are called
    other = replace(source, meshes=replace(TABLE, growth=0.5))
    assert other.known("ccx-centre-0.7", tmp_path / "20_meshes") is None
    thin = replace(source, gel=load_gel("gelsight_mini-3.6mm"))
    assert thin.known("ccx-centre-0.7", tmp_path / "20_meshes") is None
    renamed = replace(source, gel=replace(GEL, name="mine"))
    assert renamed.known("ccx-centre-0.7", tmp_path / "20_meshes") == path


def test_meshes_that_ship_are_those_of_the_parameters():
    table = parameters().meshes
    source = MeshSource(load_gel(table.gel), table)
    keys = {source.key(f"ccx-{kind}"): kind for kind in parameters().fea.meshes}
    shipped = {read_json(path)["recipe"]: path for path in SHIPPED.glob("*.json")}
    assert shipped.keys() == keys.keys(), (
        "a mesh of the parameters is missing, or one of others ships (CONTRIBUTING.md)"
    )
    for key, report in shipped.items():
        mesh = GelMesh.load(report.with_suffix(".npz"))
        assert report.stem == f"ccx-{keys[key]}-{mesh.digest}"
        reported = read_json(report)["min_scaled_jacobian"]
        assert (
            mesh_report(mesh, source.gel)["min_scaled_jacobian"] == pytest.approx(reported, rel=1e-6)
            and reported > 0.1
        )


def test_half_a_mesh_is_one_sentence(mesh, tmp_path):
    path = tmp_path / "mesh.npz"
    mesh.save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(BadInput, match="not a gel mesh"):
        GelMesh.load(path)
