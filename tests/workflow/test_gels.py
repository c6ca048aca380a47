"""Gels of one's own: pads of workflow/gels.toml and an STL, from the log to labels on hexahedra."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gelforge
from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, read_json, write_csv, write_text
from gelforge.flow.layout import Layout
from gelforge.geometry.gel import Gel, catalogue, gel_shape, is_gel, load_gel
from gelforge.geometry.gelcatalogue import gel_of, names_in
from gelforge.geometry.triangles import volume, write_stl
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.mesh.hexmesh import FineBox, build_mesh
from gelforge.mechanics.mesh.tetmesh import mesh_report
from gelforge.records.forcefile import ForceFile
from gelforge.records.labelfile import read_labels
from gelforge.records.press import COLUMNS
from gelforge.reporting.explorer import grid_points
from gelforge.stages import fea, forces, labels, plan, poses
from gelforge.sweeps.scenes import read_tables
from gelforge.virtualrig.appearance import read_appearances
from gelforge.virtualrig.fields import unloaded
from gelforge.virtualrig.render import Renderer
from tests.support.blocks import symmetric_block
from tests.support.parameters import place_workflow

OWN = ("flat_2mm", "dome")
DATASET = """
gel = "{gel}"
[params.poses]
images = false
[params.fea]
method = "draft"
[params.interface]
law = "no_slip"
"""
SENSOR = """
[own]
gel = "{gel}"
image = [320, 240]
projection = [[0.0, -10.0, 160.0], [-10.0, 0.0, 120.0], [0.0, 0.0, 1.0]]
"""


def labelled(folder, gel, depth) -> Path:
    """A dataset of one press by a ball of 8 mm, as far as its labels; its results."""
    data, results = folder / "data" / gel, folder / "results" / gel
    row = dict.fromkeys(COLUMNS, "") | {
        "sample_id": "one",
        "sensor_id": "own",
        "gel_id": "g",
        "indenter": "sphere_15",
    }
    row |= dict.fromkeys(("x0_mm", "y0_mm", "z0_mm", "dx_mm", "dy_mm", "rot_deg"), 0) | {"x0_mm": 1, "dz_mm": -depth}
    write_csv(data / "log.csv", COLUMNS, [row])
    write_text(data / "dataset.toml", DATASET.format(gel=gel))
    write_text(data / "sensors.toml", SENSOR.format(gel=gel))
    of = Layout(results)
    if not of.workflow.exists():
        place_workflow(folder)
    for module, *words in ((plan,), (poses, "0000"), (fea, "0000"), (forces, "0000"), (labels, "24x32", "0000")):
        assert module.main([str(results), *words]) == 0
    return results


@pytest.mark.parametrize("gel", OWN)
def test_a_gel_of_ones_own_goes_through_labels(tmp_path, gel):
    results = labelled(tmp_path, gel, 0.5)
    (row,) = read_csv(results / "30_fea" / "0000.csv")
    assert row["status"] == "OK" and row["mesh"].startswith(f"hex@{gel}:")
    found = read_labels(results / "50_labels" / "24x32" / "0000.npz")
    with ForceFile(results / "40_forces" / "0000.npz") as made:
        total = made.total[0]
    assert total[2] < -0.3 and abs(found.label[0, 2].sum() + found.outside[0, 2] - total[2]) < 1e-5 * -total[2]
    # mirrored along y: the ball stands on the middle of that side
    np.testing.assert_allclose(found.label[0, 2], found.label[0, 2, :, ::-1], atol=2e-3 * -total[2])
    # by how much forces are extrapolated to smaller hexahedra stands in the table and beside the label
    factor = read_json(Layout(results).solves / f"{row['key']}.json")["evidence"]["extrapolated"]
    assert 0.95 <= factor <= 1.05 and factor != 1.0
    assert (float(row["extrapolated"]), found.extrapolated.tolist()) == (factor, [factor])
    # what is pressed depends on the gel's numbers, so the plan of its shard holds them
    assert read_json(results / "00_plan" / "shards" / "0000.json")["gels"] == {gel: gel_shape(load_gel(gel))}


@pytest.mark.parametrize("gel", [*OWN, "dome-4mm"])
def test_meshes_follow_the_gel(gel):
    gel = load_gel(gel)
    hexahedra = build_mesh(gel, FineBox(-3, 3, -3, 3, 1.0), 3)
    tetrahedra = symmetric_block(gel, 1.5, 2)
    for mesh in (hexahedra, tetrahedra):
        top = mesh.nodes[mesh.surface_nodes]
        np.testing.assert_allclose(top[:, 2], gel.top(top[:, 0], top[:, 1]), atol=1e-9)
        assert set(mesh.nodes[mesh.base, 2]) == {-gel.height}
    assert mesh_report(tetrahedra, gel)["min_scaled_jacobian"] > 0.05
    vertices, faces = gel.surface(0.5)
    assert mesh_report(tetrahedra, gel)["exact_volume"] == pytest.approx(volume(vertices, faces), rel=5e-3)


@pytest.mark.parametrize("gel", OWN)
def test_the_rig_draws_it_and_the_report_shows_it(root, gel):
    gel, sensors = load_gel(gel), load_sensors(root / "workflow" / "sensors.toml")
    appearance = read_appearances(root / "workflow" / "rig" / "sensors.toml")["mini_a"]
    image = Renderer(appearance, sensors["mini_a"].projection, gel).image(unloaded(gel), rng=np.random.default_rng(1))
    assert image.shape == (240, 320, 3) and image.std(axis=(0, 1)).min() > 1.0  # light and markers
    points = grid_points(gel)[2]
    np.testing.assert_allclose(points[:, 2], gel.top(*points[:, :2].T), atol=1e-6)


def test_the_flat_pad_is_flat_and_the_dome_falls_without_a_kink():
    flat, dome = map(load_gel, OWN)
    x, y = np.meshgrid(np.linspace(-9, 9, 181), np.linspace(-9, 9, 181))
    assert not np.asarray(flat.top(x, y)).any() and flat.height == 2.0
    z = np.asarray(dome.top(x, y))
    assert z.max() == 0.0 and z[90, 90] == 0.0
    np.testing.assert_allclose([z[0], z[:, 0]], -3.0, rtol=1e-12)
    assert z[90, 20] == pytest.approx(-1.0, abs=0.02)  # where the edge begins, 7 mm from the middle
    slope = np.diff(z[90, :91]) / 0.1
    assert np.diff(slope).max() < 0.0  # steeper and steeper outwards
    assert -np.diff(slope)[12:].min() < 0.06  # the arc begins with the dome's slope


def solid(tmp_path, turn=None, base="-z", unit=1.0, **changed) -> Gel:
    """The gel of a catalogue with one, the STL of the dome turned by a matrix, in units of so many mm."""
    vertices, faces = load_gel("dome").surface(0.4)
    vertices = vertices @ (np.eye(3) if turn is None else np.array(turn)).T + [3.0, -2.0, 7.0]
    write_stl(tmp_path / "dome.stl", vertices / unit, faces)
    table = {"file": "dome.stl", "base": base} | changed
    text = "[solid]\n" + "".join(f"{key} = {value!r}\n" for key, value in table.items())
    write_text(tmp_path / "gels.toml", text)
    return gel_of(tmp_path / "gels.toml", "solid")


@pytest.mark.parametrize(
    ("turn", "base"),
    [(None, "-z"), ([[1, 0, 0], [0, -1, 0], [0, 0, -1]], "+z"), ([[0, 0, -1], [0, 1, 0], [1, 0, 0]], "+x"),
     ([[1, 0, 0], [0, 0, 1], [0, -1, 0]], "-y")],
)  # fmt: skip
def test_an_stl_is_the_pad_that_it_shows_whichever_side_is_bonded(tmp_path, turn, base):
    gel, dome = solid(tmp_path, turn, base), load_gel("dome")
    assert (gel.width, gel.length, gel.height) == pytest.approx((18.0, 18.0, 5.0), abs=1e-3)
    assert gel.corner_radius == pytest.approx(3.0, abs=0.1)
    x, y = np.meshgrid(np.linspace(-8, 8, 33), np.linspace(-8, 8, 33))
    assert np.abs(np.asarray(gel.top(x, y)) - np.asarray(dome.top(x, y))).max() < 0.06
    box = FineBox(-3, 3, -3, 3, 1.0)
    assert np.abs(build_mesh(gel, box, 3).nodes - build_mesh(dome, box, 3).nodes).max() < 0.1


def test_an_stl_that_changes_is_another_gel(tmp_path):
    before, after = solid(tmp_path), solid(tmp_path, scale=1.01)
    assert gel_shape(before) != gel_shape(after)
    assert gel_shape(replace(before, name="other", file="elsewhere.stl")) == gel_shape(before)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[a]\nwidth = 20\nlength = 24\nthickness = 2\n", r"\[a\].*corner_radius is missing"),
        ("[a]\nwidth = 20\nlength = 24\nthickness = 2\ncorner_radius = 0.1", r"\[a\] corner_radius = 0.1"),
        ("[a]\nwidth = 20\nlength = 24\nthickness = 2\ncorner_radius = 11.0", "half of the short side is 10 mm"),
        ("[a]\nwidth = 20\nlength = 24\nthickness = 2\ncorner_radius = 1\napex = 0.95", "mm thick at its thinnest"),
        ("[a]\nwidth = 20\nlength = 24\nthickness = 4\ncorner_radius = 1\napex = 0.5\nedge_width = 2\nedge_drop = 0.9",
         "edges fall from a dome that is 1 mm below its apex"),
        ("[a]\nwidth = 20\nlength = 24\nthickness = 4\ncorner_radius = 1\nedge_drop = 1.0", "give edge_width, too"),
        ("[a]\nfile = 'no.stl'\nbase = '-z'", "there is no file"),
        ("[a]\nfile = '../x.stl'\nbase = '-z'", "copy the file into .* without `..`"),
        ("[a]\nfile = 'no.stl'\nbase = 'down'", "base = 'down'"),
        ("a = 3", "give a table"),
    ],
)  # fmt: skip
def test_a_table_that_makes_no_gel_is_refused_in_a_sentence(tmp_path, text, message):
    write_text(tmp_path / "gels.toml", text)
    with pytest.raises(BadInput, match=message):
        gel_of(tmp_path / "gels.toml", "a")


def test_a_solid_that_is_no_pad_is_refused(tmp_path):
    with pytest.raises(BadInput, match=r"its side \+z is not a flat base"):
        solid(tmp_path, base="+z")
    from gelforge.geometry.indenters import build

    ball = build("ball", {"kind": "sphere", "diameter": 10, "height": 10})
    write_stl(tmp_path / "ball.stl", *ball.surface())
    write_text(tmp_path / "gels.toml", "[a]\nfile = 'ball.stl'\nbase = '+z'")
    with pytest.raises(BadInput, match="is not a flat base|rectangles with rounded"):
        gel_of(tmp_path / "gels.toml", "a")


def test_the_catalogue_of_the_project_is_sound_and_takes_no_name_that_is_one():
    assert set(names_in(catalogue())) >= set(OWN) and all(map(is_gel, OWN)) and not is_gel("flat_3mm")
    assert load_gel("flat_2mm-3mm").height == 3.0


def test_a_solid_of_another_unit_is_told_so(tmp_path):
    """An STL in metres said "top -inf"."""
    with pytest.raises(BadInput, match=r"measures 0.005 x 0.018 x 0.018 mm, .* give scale.*1000 for metres"):
        solid(tmp_path, unit=1000.0)
    assert solid(tmp_path, unit=1000.0, scale=1000.0).height == pytest.approx(5.0, abs=1e-3)


WRONG = "\n[bad]\nwidth = 20\nlength = 24\nthickness = 2\ncorner_radius = 0.1\n"


def test_gels_are_read_beside_the_workflow_that_was_given(root, tmp_path, monkeypatch):
    """Not below the working folder; a wrong table harms only the datasets whose presses are on that gel."""
    workflow = shutil.copytree(
        root / "workflow", tmp_path / "theirs/workflow", ignore=shutil.ignore_patterns("meshes")
    )
    text = (workflow / "gels.toml").read_text()
    (workflow / "gels.toml").write_text(text.replace("[dome]", "[mine]") + WRONG)
    row = dict.fromkeys(COLUMNS, "0") | {"sample_id": "one", "sensor_id": "own", "indenter": "sphere_15", "image": ""}
    monkeypatch.chdir(tmp_path)

    def planned(gel):
        of = Layout(Path("theirs/results/d"))
        write_csv(of.log, COLUMNS, [row])
        write_text(of.data / "dataset.toml", DATASET.format(gel=gel))
        write_text(of.data / "sensors.toml", SENSOR.format(gel=gel))
        assert plan.main([str(of.root)]) == 0
        return read_json(of.parameters("gels"))

    before = planned("mine")
    assert before == {"mine": gel_shape(load_gel("mine"))} and planned("gelsight_mini") == {}
    (workflow / "gels.toml").write_text(text.replace("[dome]\nwidth = 18.0", "[mine]\nwidth = 19.0") + WRONG)
    assert planned("mine") != before  # what calibrate, meshes and charts are made of
    with pytest.raises(BadInput, match=r"gels.toml: \[bad\] corner_radius = 0.1: give a number from 0.2"):
        planned("bad")
    (workflow / "gels.toml").write_text("[gelsight_mini]\n")
    with pytest.raises(BadInput, match=r"\[gelsight_mini\]: this name is reserved"):
        planned("gelsight_mini")


def test_python_takes_gels_of_a_file_wherever_it_runs(root, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GELFORGE_GELS")
    ball = {"kind": "sphere", "diameter": 10, "height": 10}
    with pytest.raises(BadInput, match="'dome' is unknown; .* which gelforge.solve takes as gels"):
        gelforge.solve(ball, 0.3, gel="dome")
    own = gelforge.solve(ball, 0.3, gel="dome", gels=root / "workflow/gels.toml")
    usual = gelforge.solve(ball, 0.3)
    assert own.total[2] < 0.0 and own.total[2] != usual.total[2]
    assert gelforge.label(own).sum() < 0.0 and not is_gel("dome")


def test_a_scene_on_a_gel_of_ones_own_holds_its_numbers(root, tmp_path):
    """The chart's records are known by it: the gel may change under its name."""
    for name in ("indenters.toml", "scenes.toml"):
        shutil.copy(root / "workflow" / name, tmp_path)
    scenes = tmp_path / "scenes.toml"
    usual = read_tables(tmp_path)
    assert not any("gel_shape" in table for table in usual.values())
    scenes.write_text(scenes.read_text().replace("\ndepth", '\ngel = "dome"\ndepth', 1))
    first = next(iter(usual))
    assert read_tables(tmp_path)[first] == usual[first] | {"gel": "dome", "gel_shape": gel_shape(load_gel("dome"))}
