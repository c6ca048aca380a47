"""Gel meshes: what a name means, which one a press takes, and what pytetwild must keep."""

import signal
from dataclasses import replace

import numpy as np
import pytest
from parameters import parameters, with_values

from gelforge.errors import BadInput
from gelforge.flow.files import write_json
from gelforge.geometry.gel import GELS
from gelforge.geometry.indenters import build
from gelforge.mechanics.family import MeshFamily, MeshName, choose_mesh, required_meshes, sizing
from gelforge.mechanics.mesh import GelMesh
from gelforge.mechanics.scene import Material, Press, Scene
from gelforge.mechanics.tet.tetmesh import (
    EDGES,
    boundary_faces,
    gel_mesh,
    kuhn_grid,
    orient,
    quality,
    signed_volumes,
    sizing_grid,
    split_long_edges,
    tetrahedralise,
)
from tests.conftest import process_signals

GEL = GELS["gelsight_mini"]
TABLE = replace(
    parameters().meshes, growth=0.4, coarsest_mm=4.0, fine_depth_mm=0.6, hold={},
    regions={"centre": (4.0, 4.0), "wide": (9, 11)},
)  # fmt: skip


@pytest.fixture(scope="module")
def mesh():
    return gel_mesh(GEL, sizing((4.0, 4.0), 2.0, TABLE))


def test_an_interrupt_after_meshing_is_still_one_that_python_can_answer():
    # pytetwild lets SIGINT end the process
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        before = process_signals()
        tetrahedralise(*build("ball_8", {"kind": "sphere", "diameter": 8.0, "height": 8.0}).surface(), num_threads=1)
        assert process_signals() == before
    finally:
        signal.signal(signal.SIGINT, handler)


def test_gel_of_tetrahedra_keeps_its_shape(mesh):
    report = quality(mesh, GEL)
    top = mesh.nodes[mesh.surface_nodes]
    np.testing.assert_allclose(top[:, 2], GEL.top(top[:, 0], top[:, 1]), atol=1e-12)
    assert set(mesh.nodes[mesh.base, 2]) == {-GEL.height}
    # the outline's arcs are polygons of four sides, and edges 3 mm long cut the fall to the rim
    assert abs(report["volume_error"]) < 5e-3
    assert report["min_scaled_jacobian"] > 0.2
    assert signed_volumes(mesh.nodes, mesh.elements[:, :4]).min() > 0


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


def test_a_held_mesh_is_as_fine_as_asked_and_sound():
    wanted = sizing((2.0, 2.0), 1.5, TABLE)
    mesh = gel_mesh(GEL, wanted, hold=1.3)
    flat = mesh.nodes[mesh.elements[:, :4][:, EDGES].reshape(-1, 2)] * [1, 1, 0]
    on_top = np.isin(mesh.elements[:, :4][:, EDGES].reshape(-1, 2), mesh.surface_nodes).all(axis=1)
    length = np.linalg.norm(flat[:, 0] - flat[:, 1], axis=1)[on_top]
    assert (length <= 1.3 * wanted(flat.mean(axis=1))[on_top] + 1e-9).all()
    assert quality(mesh, GEL)["min_scaled_jacobian"] > 0.2


def test_sizing_grid_fills_the_gel():
    vertices, tets, values = sizing_grid(GEL, lambda p: 1 + 0 * p[:, 0], step=2.0)
    volume = signed_volumes(vertices, tets)
    assert volume.min() > 0
    assert volume.sum() == pytest.approx(np.prod(np.ptp(vertices, axis=0)))
    assert len(values) == len(vertices)


@pytest.mark.parametrize(
    "name", ["ccx-centre", "hex-centre-1.0", "ccx-centre-0.05", "fem-centre-1.0", "ccx-../x-1.0"]
)
def test_names_that_mean_nothing_are_refused(name):
    with pytest.raises(BadInput, match="ccx-REGION-SIZE"):
        MeshName.parse(name)


def test_required_meshes_need_known_regions():
    fea = with_values(parameters().fea, fidelity="ccx", meshes=["centre-0.7", "wide-1.0"])
    assert required_meshes(fea, TABLE) == ["ccx-centre-0.7", "ccx-wide-1.0"]
    assert required_meshes(with_values(fea, fidelity="hex"), TABLE) == []
    with pytest.raises(BadInput, match="edge"):
        required_meshes(with_values(fea, meshes=["edge-1.0"]), TABLE)


def test_a_press_takes_the_finest_mesh_that_holds_its_footprint(tmp_path, mesh):
    for name, half in (("ccx-centre-0.7", [4.0, 4.0]), ("ccx-wide-1.0", [9.0, 11.0])):
        mesh.save(tmp_path / f"{name}.npz")
        report = {"engine": "ccx", "half_mm": half, "size": float(name[-3:]), "nodes": 1}
        write_json(tmp_path / f"{name}.json", report)
    family = MeshFamily(tmp_path, ["ccx-centre-0.7", "ccx-wide-1.0"])
    ball = build("ball", {"kind": "sphere", "diameter": 10, "height": 8})

    def chosen(x, depth):
        return choose_mesh(Scene(GEL, Material(), ball, Press(x, 0, 0, 0, 0, -depth)), family)

    assert chosen(0, 1.0) == "ccx-centre-0.7"
    assert chosen(2, 1.0) == "ccx-wide-1.0"
    with pytest.raises(BadInput, match="make meshes"):
        MeshFamily(tmp_path, ["ccx-centre-0.5"])


def test_half_a_mesh_is_one_sentence(mesh, tmp_path):
    path = tmp_path / "mesh.npz"
    mesh.save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(BadInput, match="not a gel mesh"):
        GelMesh.load(path)
