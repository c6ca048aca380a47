"""The posed STL of stage 10 and the distance by which presses are solved are one surface, to 0.01 mm."""

import numpy as np
import pytest

from gelforge.geometry import touch
from gelforge.geometry.gel import GELS
from gelforge.geometry.indenters import CATALOGUE, build, read_catalogue
from gelforge.geometry.stlfile import read_stl
from gelforge.geometry.triangles import write_stl
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import PosedFile, Scene
from gelforge.mechanics.solvers.ccxcontact import surface_of
from gelforge.records.press import Press
from gelforge.stages.poses import write_posed
from tests.support.parameters import parameters

PRESS = Press(1.2, -2.0, 0.3, 0.4, -0.3, -1.1, 25.0)
NAMES = ("cylinder_8", "triangle_10")
SAME_MM = 0.01


def bodies(folder):
    """One read from an STL file, and bodies of the catalogue."""
    tables = read_catalogue(CATALOGUE)
    write_stl(folder / "ball.stl", *build("ball", {"kind": "sphere", "diameter": 12, "height": 8}).surface())
    yield build("ball", {"kind": "stl", "file": "ball.stl"}, folder=folder)
    yield from (build(name, tables[name]) for name in NAMES)


def test_a_posed_file_is_where_the_distance_is_zero(tmp_path):
    for body in bodies(tmp_path):
        path = tmp_path / f"{body.name}.stl"
        write_posed(path, body, PRESS, parameters().poses)
        vertices, faces = read_stl(path)
        rotation, place = PRESS.pose(0.0, 0.0)
        height = ((vertices - place) @ rotation)[:, 2]
        whole = (height[faces] < height.max() - 1e-6).any(axis=1)  # not the cut at the top
        points = np.concatenate([vertices[faces[whole]].mean(axis=1), vertices[np.unique(faces[whole])]])
        points = points[((points - place) @ rotation)[:, 2] < height.max() - 1e-6]
        assert len(points) > 100 and np.abs(touch.gap(body, PRESS, points, 0.0)).max() < SAME_MM, body.name


def test_calculix_own_contact_reads_that_file_and_moves_it_along(tmp_path):
    for body in [*bodies(tmp_path)][::2]:
        path = tmp_path / f"{body.name}.stl"
        write_posed(path, body, PRESS, parameters().poses)
        scene = Scene(GELS["gelsight_mini"], Material(), body, PRESS, posed=PosedFile(path, PRESS))
        for each in (scene, scene.direct):
            for t in (0.4, each.press.end):
                vertices, faces = surface_of(each, t)
                assert len(faces) == len(read_stl(path)[1])
                low = vertices[vertices[:, 2] < vertices[:, 2].min() + 0.5]
                assert np.abs(touch.gap(body, each.press, low, t)).max() < SAME_MM
        # what is read is the file: a file of something else shows
        vertices, faces = read_stl(path)
        write_stl(path, vertices + [0.0, 0.0, 0.2], faces)
        assert surface_of(scene, 0.0)[0][:, 2].min() == pytest.approx(PRESS.z0 + 0.2, abs=1e-3)
