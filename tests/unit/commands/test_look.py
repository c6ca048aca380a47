"""Pictures and .vtu of a sample."""

import os
import re
from dataclasses import replace

import cv2
import matplotlib as mpl
import numpy as np
import pytest

from gelforge.commands import look
from gelforge.commands.deck import hand_out
from gelforge.errors import BadInput
from gelforge.flow.files import write_csv
from gelforge.formats.vtu import write_vtu
from gelforge.geometry.stlfile import read_stl
from gelforge.records.log import write_rejections
from gelforge.records.press import Rejection
from gelforge.reporting.forcemaps import SIGNED, write_maps
from gelforge.reporting.page import COLOURS
from tests.support.pressed_dataset import label, write_pressed


@pytest.fixture(scope="module")
def made(tmp_path_factory, root):
    os.chdir(root)
    made = write_pressed(tmp_path_factory.mktemp("made"), count=6, failed=(2,))
    label(made, "24x32")
    label(made, "48x64")
    return made


def run(made, sample_id, *resolutions):
    where = ["--data", str(made["data"]), "--results", str(made["results"])]
    return look.main([*where, "--id", sample_id, "--resolution", *resolutions])


def test_vtu_opens_and_holds_the_press(made):
    import pyvista as pv

    run(made, "s001", "24x32", "48x64")
    grid = pv.read(made["results"] / "look/s001.vtu")
    mesh, force = made["mesh"], made["loads"]["s001"]
    assert grid.n_points == len(mesh.nodes) and grid.n_cells == len(mesh.elements)
    assert np.allclose(grid.points, mesh.nodes) and np.allclose(grid["force"], force)
    assert np.allclose(grid["displacement"][mesh.surface_nodes], -0.1 * np.abs(force[mesh.surface_nodes]), atol=1e-7)
    assert not grid["displacement"][mesh.base].any()
    # A solid whose node order were wrong would have inverted elements.
    assert grid.compute_cell_sizes()["Volume"].min() > 0
    for resolution in ("24x32", "48x64"):
        assert cv2.imread(str(made["results"] / f"look/s001-{resolution}.png")).shape[1] > 1000
    tip = read_stl(made["results"] / "look/s001-indenter.stl")[0][:, 2].min()
    assert tip == pytest.approx(-1.0, abs=1e-6)


def test_the_indenter_is_drawn_where_it_enters_the_gel(made):
    """A ball of 10 mm, 1 mm below the apex, cuts a plane in a circle of 3 mm; the gel falls away to its sides."""
    seen = seen_of(made)
    lines = seen.sensor.unproject(look.outline(seen).reshape(-1, 2)) - [
        seen.press.x0_mm + seen.press.dx_mm, seen.press.y0_mm + seen.press.dy_mm
    ]  # fmt: skip
    assert np.abs(lines.mean(axis=0)).max() < 0.3
    assert np.hypot(*lines.T).min() > 2.3 and np.hypot(*lines.T).max() < 3.1


def test_the_lowest_part_of_the_indenter_is_marked(made):
    """Wherever the rest of a body lies, here a wing beside a ball that is moved: a shape beside its axis is seen at once."""
    seen = seen_of(made)
    vertices, faces = seen.indenter
    below = np.array([seen.press.x0_mm + seen.press.dx_mm, seen.press.y0_mm + seen.press.dy_mm])
    for aside in ([0.0, 0.0], [1.5, -2.0]):
        winged = np.vstack([vertices + [*aside, 0.0], [[9.0, 9.0, 0.0]]])
        (mark,) = look.draw(replace(seen, indenter=(winged, faces))).axes[0].lines
        assert np.hypot(*(seen.sensor.unproject(mark.get_xydata())[0] - below - aside)) < 0.1
    assert "lowest" in look.draw(seen).axes[0].get_title()


def test_second_order_tetrahedra_keep_their_order(tmp_path):
    import pyvista as pv

    from gelforge.mechanics.mesh.gelmesh import GelMesh

    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    middles = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
    nodes = np.vstack([corners, [corners[list(pair)].mean(axis=0) for pair in middles]])
    mesh = GelMesh("tet10", nodes, np.arange(10)[None], np.array([[0, 2, 1, 6, 5, 4]]), np.array([3]))
    write_vtu(tmp_path / "t.vtu", mesh, np.zeros((10, 3)), np.zeros((10, 3)), np.ones(10, bool))
    grid = pv.read(tmp_path / "t.vtu")
    assert grid.celltypes.tolist() == [24]
    assert grid.compute_cell_sizes()["Volume"][0] == pytest.approx(1 / 6)
    with pytest.raises(BadInput, match="another mesh"):
        write_vtu(tmp_path / "t.vtu", mesh, np.zeros((9, 3)), np.zeros((10, 3)), np.ones(10, bool))


def seen_of(made):
    """The first sample with a label that pushes along every axis on the left and against it on the right."""
    paths = look.shard_paths(made["results"], "s001", "24x32")
    seen = look.load(made["data"], paths, "s001", look.load_sensors("workflow/sensors.toml"), "24x32")
    return replace(seen, label=np.concatenate([np.full((3, 24, 16), 0.1), np.full((3, 24, 16), -0.1)], axis=2))


def is_red(rgb) -> bool:
    return float(rgb[0]) > 2 * float(rgb[2])


def is_blue(rgb) -> bool:
    return float(rgb[2]) > 2 * float(rgb[0])


def test_a_force_along_its_axis_is_red_in_every_picture(made, tmp_path):
    """And one against it blue: in the pictures of `look` and of `predict`, and on the pages of the explorer and `live`."""
    seen = seen_of(made)
    assert all(axis.get_aspect() == 1.0 for axis in look.draw(replace(seen, image=None)).axes[:4])
    shown = [axis.images[-1] for axis in look.draw(seen).axes[1:4]]
    assert all(is_red(each.cmap(each.norm(0.1))) and is_blue(each.cmap(each.norm(-0.1))) for each in shown)
    write_maps(tmp_path / "maps.png", np.zeros((24, 32, 3), np.uint8), seen.label, "")
    picture = cv2.imread(str(tmp_path / "maps.png"))[..., ::-1]
    middle = picture[picture.shape[0] // 2].astype(int)
    red, blue = (np.array([of(pixel) for pixel in middle]) for of in (is_red, is_blue))
    left, right = (int(np.flatnonzero(pixels)[0]) for pixels in (red, blue))
    assert left < right  # of the first map
    stops = re.findall(r"\d+", re.search(r"DIVERGING = \[(.*)\];", COLOURS.read_text(encoding="utf-8"))[1])
    ends = [*mpl.colormaps[SIGNED](0, bytes=True)[:3], *mpl.colormaps[SIGNED](255, bytes=True)[:3]]
    assert [int(stop) for stop in stops[:3] + stops[-3:]] == ends


def test_of_a_rejected_row_the_reason_is_reported_and_its_hint(tmp_path):
    """make sample could never have helped."""
    write_csv(tmp_path / "lab/00_plan/shards.csv", ["sample_id", "shard"], [{"sample_id": "s7", "shard": 0}])
    write_rejections(
        tmp_path / "lab/10_poses/0000.rejected.csv",
        [Rejection("log.csv", 9, "s7", "dz_mm", "deep", "is no number", "write millimetres")],
    )
    reported = "row 9 of the log: dz_mm = 'deep': is no number; write millimetres; then run make labels DATASET=lab"
    with pytest.raises(BadInput, match=reported):
        run({"data": tmp_path, "results": tmp_path / "lab"}, "s7", "24x32")
    with pytest.raises(BadInput, match=reported):
        hand_out(tmp_path / "lab", "s7", tmp_path / "deck")


def test_refusals_say_what_to_do(made):
    for sample_id, resolution, reason in (
        ("", "24x32", "ID=SAMPLE_ID"),
        ("zzz", "24x32", "not in the log"),
        ("s001", "5x5", "make labels RES=5x5"),
        ("s002", "24x32", "DIVERGED"),
        ("s001", "big", "RES=24x32"),
    ):
        with pytest.raises(BadInput, match=reason):
            run(made, sample_id, resolution)
