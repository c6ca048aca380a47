"""How bodies from files stand: what touches first is said, and only those that stand wrongly are doubted."""

import numpy as np
import pytest

from gelforge.geometry.indenters import build, load_catalogue
from gelforge.geometry.sampled import sampled_from_stl
from gelforge.geometry.standing import cut_at, standing
from gelforge.geometry.triangles import Mesh, write_stl
from tests.support.refused import refused

CATALOGUE = load_catalogue("workflow/indenters.toml")


def wedge(angle_deg: float, height: float = 6.0, length: float = 8.0, blunt: float = 0.0) -> Mesh:
    """A fin along x that widens by an angle from its lower edge, `blunt` mm wide there."""
    top, low = blunt / 2 + height * np.tan(np.deg2rad(angle_deg) / 2), max(blunt / 2, 0.0)
    section = [(low, 0.0), (top, height), (-top, height), (-low, 0.0)][: 4 if low else 3]
    vertices = [(x, y, z) for x in (-length / 2, length / 2) for y, z in section]
    if low == 0.0:
        faces = [(0, 2, 1), (3, 4, 5), (0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3), (2, 3, 5)]
    else:
        faces = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7),
                 (2, 7, 6), (3, 0, 4), (3, 4, 7)]  # fmt: skip
    return np.array(vertices), np.array(faces)


def turned(mesh: Mesh, by: int) -> Mesh:
    """With another axis up."""
    return np.roll(mesh[0], by, axis=1), mesh[1]


def tool() -> Mesh:
    """A ball of 4 mm on a cone that widens to a flat end of 8 mm, 12 mm high."""
    angle = np.linspace(-np.pi / 2, 0.3, 24)
    profile = [(2 * np.cos(a), 2 + 2 * np.sin(a)) for a in angle[1:]] + [(4.0, 9.0), (4.0, 12.0)]
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    rings = [(r * np.cos(t), r * np.sin(t), z) for r, z in profile for t in turn]
    vertices, faces = np.array([(0.0, 0.0, 0.0), *rings, (0.0, 0.0, 12.0)]), []
    for at in range(48):
        after = (at + 1) % 48
        faces.append((0, 1 + after, 1 + at))
        for ring in range(len(profile) - 1):
            a, b, c, d = (1 + 48 * ring + at, 1 + 48 * ring + after, 49 + 48 * ring + at, 49 + 48 * ring + after)
            faces += [(a, b, d), (a, d, c)]
        last = 1 + 48 * (len(profile) - 1)
        faces.append((last + at, last + after, len(vertices) - 1))
    return vertices, np.array(faces)


def test_no_good_body_is_doubted():
    good = {name: body.surface() for name, body in CATALOGUE.items()}
    good |= {"tool": tool(), "fin": wedge(60.0, blunt=1.0), "low fin": wedge(90.0, height=3.0, blunt=0.5)}
    for name, mesh in good.items():
        assert standing(*mesh).doubts == [], name


def test_what_stands_wrongly_is_said():
    (vertices, faces), (cuboid, sides), (bar, ends) = tool(), *(CATALOGUE[n].surface() for n in ("cuboid_7", "bar_5"))
    for mesh, said in (
        (turned(tool(), 1), "it lies: 12 mm along x"), (turned(tool(), 2), "it lies: 12 mm along y"),
        ((vertices * [1, -1, -1], faces), ""), ((vertices + [4, 4, 0], faces), "beside the axis"),
        ((cuboid + [3.5, 3.5, 0], sides), "4.95 mm beside the axis"), ((bar + [15, 0, 0], ends), "15 mm beside the axis"),
        (wedge(60.0), "a ridge of 60 degrees, 8 mm long"), (wedge(90.0), "a ridge of 90 degrees"),
        (wedge(30.0, blunt=0.02), ""),
    ):  # fmt: skip
        doubts = standing(*mesh).doubts
        assert any(said in doubt for doubt in doubts) if said else doubts == []


def test_sharp_edges_of_a_flat_side_are_said():
    for mesh, sharp in (
        (wedge(60.0, blunt=1.0), True), (CATALOGUE["cuboid_7"].surface(), False), (tool(), False), (wedge(60.0), False)
    ):  # fmt: skip
        assert ("with sharp edges" in standing(*mesh).touches) == sharp


def test_what_touches_first_is_measured():
    flat, ball = (standing(*CATALOGUE[name].surface()).touches for name in ("cuboid_7", "sphere_10"))
    assert "a flat side of 25 mm2 touches first" in flat and "0.00 mm beside the axis" in flat
    assert "a tip or a rounded side touches first, 1.98 x 1.98 mm wide" in ball
    section = cut_at(wedge(90.0, length=8.0), 1.0)
    assert section.area == pytest.approx(16.0) and section.high - section.low == pytest.approx([8.0, 2.0])


def test_walls_that_the_grid_of_distances_loses_are_refused(tmp_path):
    """Its distance would say that nothing is there."""
    path = tmp_path / "fin.stl"
    for angle in (5.0, 20.0):
        write_stl(path, *wedge(angle, height=2.0, length=1.0))
        said = r"indenter fin: .*too thin for spacing = 0.2 mm.*half the wall thickness"
        refused(said, sampled_from_stl, path, name="fin")
    fine = sampled_from_stl(path, spacing=0.05, reach=0.5, name="fin")
    assert fine.distance(np.array([[0.0, 0.0, 0.2]]))[0][0] < 0.0


@pytest.mark.parametrize("mesh", [wedge(90.0), CATALOGUE["cylinder_10_7"].surface()], ids=["ridge", "ring"])
def test_what_the_grid_holds_is_not_refused_and_what_touches_is_said_once(tmp_path, capfd, mesh):
    path = tmp_path / "body.stl"
    write_stl(path, *mesh)
    for said in (1, 0):
        sampled_from_stl(path, name="body", folder=tmp_path / "kept").distance(np.zeros((1, 3)))
        assert capfd.readouterr().err.count("above its lowest point") == said


def test_a_body_by_a_table_is_no_file():
    from gelforge.geometry.sampled import notes_of

    assert notes_of(build("ball", {"kind": "sphere", "diameter": 4, "height": 4})) == []
