"""Tetrahedral meshes: the gel's base mesh bisected at the edge of a contact, and names that hold all of one."""

import base64
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.geometry.gel import GELS, gels_from, load_gel
from gelforge.geometry.triangles import write_stl
from gelforge.mechanics.mesh.basemesh import base_of
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.names import FORM, Contact, TetMeshName, load_mesh
from gelforge.mechanics.mesh.tetmesh import (
    EDGES,
    FACES,
    RIM,
    RIM_GROWTH,
    Sizes,
    bend,
    bisected,
    jacobians,
    mesh_report,
    orient,
    scaled_jacobians,
    second_order,
    signed_volumes,
)
from tests.support.blocks import box
from tests.support.refused import refused

pytestmark = pytest.mark.processes  # pytetwild makes base meshes in one

GEL = GELS["gelsight_mini"]
GELS_TOML = """
[flat]
width = 16
length = 24
thickness = 3
corner_radius = 0.5

[round]
width = 16
length = 16
thickness = 3
corner_radius = 8

[steep]
width = 18
length = 20
thickness = 5
corner_radius = 1
apex = 0.2
edge_width = 2
edge_drop = 3

[solid]
file = "pad.stl"
base = "-z"
"""


def disc(radius: float, at: tuple[float, float] = (0.0, 0.0), pixel: float = 0.2) -> Contact:
    """A round contact."""
    count = 2 * (int(radius / pixel) + 2)
    place = (np.arange(count) + 0.5 - count / 2) * pixel
    low = at[0] - count / 2 * pixel, at[1] - count / 2 * pixel
    return Contact.of(np.hypot(place[:, None], place) < radius, pixel, low)


BASE = "0123456789abcdef"  # digest of no mesh
NAME = TetMeshName("gelsight_mini", BASE, 0.7, 1.2, disc(3.0, (1.0, -2.0)))


def made_here(name: TetMeshName) -> TetMeshName:
    """The name with the digest of the base mesh of this process."""
    return replace(name, base=base_of(load_gel(name.gel)).digest)


@pytest.fixture(scope="module")
def mesh() -> GelMesh:
    return made_here(NAME).mesh()


@pytest.fixture(
    params=[
        "gelsight_mini-3.2mm",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("flat", "round", "steep")),
        "solid",
    ]
)
def gel(request, tmp_path):
    (tmp_path / "gels.toml").write_text(GELS_TOML)
    write_stl(tmp_path / "pad.stl", *box([0.0, 0.0, 0.0], [18.0, 24.0, 4.0]))
    with gels_from(tmp_path / "gels.toml"):
        yield load_gel(request.param)


def test_a_mesh_has_the_shape_of_its_gel_wherever_the_contact_lies(gel):
    for at in ((0.0, 0.0), (0.45 * gel.width, 0.45 * gel.length), (0.0, -0.5 * gel.length)):
        mesh = made_here(TetMeshName(gel.name, BASE, 0.6, 1.2, disc(1.5, at))).mesh()
        report, corners = mesh_report(mesh, gel), mesh.elements[:, :4]
        # the outline's corners are polygons of few sides, and so is the fall to the rim
        assert abs(report["volume_error"]) < 0.015 and report["min_scaled_jacobian"] > 0.05
        top = mesh.nodes[np.unique(mesh.faces[:, :3])]
        np.testing.assert_allclose(top[:, 2], gel.top(top[:, 0], top[:, 1]), atol=1e-12)
        assert set(mesh.nodes[mesh.base, 2]) == {-gel.height}
        # conforming: each face belongs to two elements, or to the skin, which is closed and has top and base
        faces, count = np.unique(np.sort(corners[:, FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
        skin = faces[count == 1]
        assert count.max() == 2
        edges = np.sort(skin[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
        a, b, c = (mesh.nodes[mesh.faces[:, i]] for i in range(3))
        up = np.cross(b - a, c - a)[:, 2]
        assert up.min() > 0 and len(mesh.faces) <= len(skin)
        assert up.sum() / 2 == pytest.approx(gel.width * gel.length - (4 - np.pi) * gel.corner_radius**2, rel=0.02)


def test_edges_are_short_where_the_contact_ends():
    """In the flat box, before its columns are bent.

    The distance to the edge of a contact is known to two pixels: one for the raster's edge, one for a point's pixel.
    """
    base, c = base_of(GEL), disc(3.0, (1.0, -2.0), 0.05)
    nodes, tets = bisected(base.nodes, base.tets, Sizes.at(GEL, c.mask, c.pixel, c.low, NAME.edge_mm, NAME.inside_mm))
    ends = nodes[tets[:, EDGES].reshape(-1, 2)]
    length, middle = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), ends.mean(axis=1)
    away = np.hypot(*(middle[:, :2] - [1.0, -2.0]).T)
    rim = np.hypot(away - 3.0, middle[:, 2]) < RIM * NAME.edge_mm
    assert rim.sum() > 20 and length[rim].max() <= NAME.edge_mm + RIM_GROWTH * 2 * c.pixel
    assert np.median(length[away > 7.0]) > 2.0 * NAME.edge_mm


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.3, 4.0),
    st.floats(0.4, 2.0),
    st.floats(-9, 9),
    st.floats(-11, 11),
    st.floats(0.5, 5.0),
    st.floats(0.05, 0.5),
)
def test_a_name_holds_all_of_a_mesh(edge, inside, x, y, radius, pixel):
    numbers = (float(f"{v:.6g}") for v in (edge, inside, pixel, x, y))
    edge, inside, pixel, x, y = numbers
    contact = disc(radius, pixel=pixel)
    name = TetMeshName("gelsight_mini", BASE, edge, inside, Contact.of(contact.mask, pixel, (x, y)))
    assert TetMeshName.parse(name.name) == name


def test_a_mesh_of_a_name_is_the_same_wherever_it_is_built(mesh):
    other = load_mesh(made_here(NAME).name)
    for part in ("nodes", "elements", "faces", "base"):
        assert np.array_equal(getattr(mesh, part), getattr(other, part))


def raster_of(size: int) -> str:
    return base64.urlsafe_b64encode(zlib.compress(bytes(size))).decode().rstrip("=")


def test_a_name_that_is_none_is_refused():
    raster = NAME.name.rpartition(":")[2]
    for old, new in (
        ("tet@gelsight_mini", "tet@teapot"), (":0.7:", ":nan:"), (":0.7:", ":0:"), (":0.7:", ":1e-9:"), (":1.2:", ":1,2:"),
        (":34:34:", ":34:"), (":34:34:", ":34:35:"), (":34:34:", ":0:34:"), (":34:34:", ":3.4:34:"),
        (":34:34:", ":99999:99999:"), (raster, "x"), (raster, raster_of(1 << 28)), (":0.7:1.2", ""),
    ):  # fmt: skip
        name = NAME.name.replace(old, new, 1)
        assert name != NAME.name
        refused("gel 'teapot'" if "teapot" in new else re.escape(FORM), load_mesh, name)
    for name in ("ccx-centre-0.45", "hex-centre-0.5", "", "../../etc/passwd"):
        refused("make fea", load_mesh, name)


def test_an_element_is_judged_within_its_bowed_edges():
    """One at a rounded corner, where the top falls: its straight edges span a volume, and bowed ones turn it inside out."""
    corners = np.array([[5.0, 0, -3], [9, 0, -3], [5, 3, -3], [5, 0, -1]])
    worst = []
    for bow in (0.0, 2.5):
        nodes, elements, _ = second_order(corners, orient(corners, np.arange(4)[None]))
        nodes[4:][np.flatnonzero(nodes[4:, 0] == 7.0)[0], 0] += bow
        assert signed_volumes(nodes, elements[:, :4])[0] > 0
        worst.append(scaled_jacobians(jacobians(nodes, elements))[0])
    assert worst[0] == pytest.approx(1.0) and worst[1] < 0


def test_columns_are_stretched_between_base_and_top():
    flat = np.array([[0.0, 0, -4], [0, 0, -2], [0, 0, 0], [9, 11, -4], [9, 11, 0]])
    low = float(GEL.top(9.0, 11.0))
    np.testing.assert_allclose(bend(GEL, flat), [-4, -2, 0, -4, low], atol=1e-12)


def test_a_contact_as_small_as_a_hair_is_meshed_around_alone():
    """0.05 mm wide: small tetrahedra where it is, and those of the base mesh (edges near 2 mm) everywhere else."""
    mesh = made_here(TetMeshName("gelsight_mini", BASE, 0.02, 0.02, disc(0.025, (0.3, 0.2), 0.002))).mesh()
    assert mesh_report(mesh, GEL)["min_scaled_jacobian"] > 0.1 and len(mesh.nodes) < 20_000
    ends = mesh.nodes[mesh.faces[:, [0, 1]]]
    length, away = (
        np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1),
        np.hypot(*(ends.mean(axis=1)[:, :2] - [0.3, 0.2]).T),
    )
    assert length[away < 0.03].max() < 0.03 and np.median(length[away > 6.0]) > 1.5 and length[away > 6.0].min() > 0.5
