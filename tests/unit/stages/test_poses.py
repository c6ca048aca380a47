"""Stage 10 on small logs: what is written, what is refused."""

import csv
import json
import tomllib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelforge.flow.files import read_json, write_csv, write_json
from gelforge.flow.layout import Layout
from gelforge.geometry import touch, triangles
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build, load_catalogue
from gelforge.geometry.stlfile import read_stl
from gelforge.geometry.triangles import cropped
from gelforge.records import log
from gelforge.records.press import FORCES, Press, Rejection, parse, summarised
from gelforge.stages import poses
from tests.support.parameters import parameters, write_stage, write_used
from tests.support.press_records import press_record


@pytest.fixture
def lab(tmp_path, root):
    """A dataset folder, parameter files, and a function that runs the stage over rows."""
    of = Layout(tmp_path / "results/lab")
    (of.data / "images").mkdir(parents=True)
    cv2.imwrite(str(of.data / "images" / "a.png"), np.full((240, 320, 3), 90, np.uint8))
    for name in ("sensors", "indenters"):
        write_used(of, **{name: tomllib.loads((root / "workflow" / f"{name}.toml").read_text())})
    write_stage(of.params, "poses")

    def run(rows, *flags, without=()):
        shard = of.shard("0000")
        log.write_log(shard, rows)
        lines = [{name: cell for name, cell in row.items() if name not in without} for row in read(shard)]
        write_csv(shard, list(lines[0]), lines)
        assert poses.main([str(of.root), "0000", *flags]) == 0
        return read(of.poses("0000")), read(of.rejected("0000")), of.root / "10_poses/0000"

    run.sensors = lambda tables: write_used(of, sensors=tables)
    run.of = of
    return run


def read(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def sample(sample_id="a", **cells):
    return press_record(row=0, sample_id=sample_id, **(dict.fromkeys(FORCES) | cells))


def test_table_and_surfaces_are_written(lab):
    table, rejected, folder = lab([sample("a", x0_mm=1.0, rot_deg=30.0, fz_n=-5.5), sample("b", indenter="bar_5")])
    assert not rejected
    assert [row["stl"] for row in table] == ["0000/a.stl", "0000/b.stl"]
    assert tuple(table[0]) == log.POSED_COLUMNS
    assert (float(table[0]["fz_n"]), table[0]["fx_n"]) == (-5.5, "")
    vertices, faces = read_stl(folder / "a.stl")
    # STL holds float32: 1e-6 of a few mm
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-5)
    assert vertices[vertices[:, 2].argmin(), 0] == pytest.approx(1.0, abs=1e-5)
    # 1 mm of travel, 0.5 mm of bulge: the rest of the sphere cannot be reached
    assert vertices[:, 2].max() == pytest.approx(1.5, abs=1e-5)
    assert triangles.is_watertight(faces)


def test_posed_surface_is_the_body_turned_and_moved(lab, root):
    _, _, folder = lab([sample("a", indenter="cross_15_10_3", x0_mm=1.5, y0_mm=-2.0, z0_mm=0.1, rot_deg=77.0)])
    vertices, _ = read_stl(folder / "a.stl")
    body = load_catalogue(root / "workflow" / "indenters.toml", ["cross_15_10_3"])["cross_15_10_3"]
    rotation, shift = Press(1.5, -2.0, 0.1, 0, 0, -1, 77.0).pose(0.0, 0.0)
    local = (vertices - shift) @ rotation
    low = local[:, 2] < 1.3
    # chords and float32; the boolean cut puts corners on chords
    assert np.abs(body.distance(local[low])[0]).max() < 0.006


UNUSABLE = (
    ({"z0_mm": 1.5}, "dz_mm", "never touches"),
    ({"x0_mm": 25.0}, "dz_mm", "never touches"),
    ({"x0_mm": 10.0, "y0_mm": 12.0, "dz_mm": -0.2}, "dz_mm", "never touches"),
    ({"dz_mm": -3.5}, "dz_mm", "deeper than the gel"),
    ({"dz_mm": -900.0}, "dz_mm", "deeper than the gel"),
    ({"dx_mm": 30.0}, "dx_mm", "too far sideways"),
    ({"sensor_id": "nobody"}, "sensor_id", "no such sensor"),
    ({"indenter": "spoon"}, "indenter", "no such indenter"),
    ({"image": "images/b.png"}, "image", "cannot be read"),
    ({"image": "../a.png"}, "image", "leaves the dataset"),
)


def test_unusable_presses_are_rejected_and_the_others_go_on(lab, capsys):
    bad = [sample(f"bad{k}", **cells) for k, (cells, _, _) in enumerate(UNUSABLE)]
    table, rejected, folder = lab([*bad, sample("good")])
    said = capsys.readouterr().err
    assert [row["sample_id"] for row in table] == ["good"] and [p.name for p in folder.iterdir()] == ["good.stl"]
    for k, (row, (_, column, says)) in enumerate(zip(rejected, UNUSABLE, strict=True)):
        assert (row["sample_id"], row["column"], row["row"]) == (f"bad{k}", column, str(k + 2))
        assert says in row["reason"] and row["file"].endswith("data/lab/log.csv")
    assert "row 2, bad0: dz_mm" in said


def test_faults_that_do_not_depend_on_each_other_are_reported_together(lab):
    for cells, columns in (
        ({"sensor_id": "", "image": ""}, ["sensor_id", "image"]),
        ({"sensor_id": "nobody", "indenter": "spoon", "image": "b.png"}, ["sensor_id", "indenter", "image"]),
        ({"dz_mm": 1.0, "indenter": "spoon", "image": "images/b.png"}, ["dz_mm", "indenter", "image"]),
        ({"z0_mm": 1.5, "image": ""}, ["image", "dz_mm"]),
        ({"fz_n": 3.0, "image": ""}, ["image", "fz_n"]),
    ):
        table, rejected, _ = lab([sample("bad", **cells), sample("good")])
        assert [row["sample_id"] for row in table] == ["good"] and [row["column"] for row in rejected] == columns


def test_a_row_that_the_log_lost_leaves_no_body(lab):
    lab([sample("a"), sample("b")])
    table, _, folder = lab([sample("b")])
    assert len(table) == 1
    assert [p.name for p in folder.iterdir()] == ["b.stl"]


def test_a_log_without_a_column_of_images_is_reported_once_and_can_be_allowed(lab, tmp_path, capsys):
    rows = [sample(f"s{n}") for n in range(9)]
    table, rejected, _ = lab(rows, without=["image"])
    assert not table and len(rejected) == 9
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("rejected: ")]
    assert len(lines) == 1 and "[params.poses] images = false" in lines[0]
    assert lines[0].endswith("the same reason against 8 more rows: 3, 4, 5, 6, 7, …")
    write_stage(lab.of.params, "poses", poses={"images": False})
    for without in ([], ["image"]):
        table, rejected, _ = lab([replace(row, image="") for row in rows], without=without)
        assert not rejected and len(table) == 9


def test_rows_that_want_something_else_done_are_distinguished():
    expected = ["write 1", "write 2", "write 1"]
    kept_out = [
        Rejection("log.csv", 2 + k, f"s{k}", "x0_mm", "", "is empty", hint) for k, hint in enumerate(expected)
    ]
    lines = summarised(kept_out)
    assert lines == [f"{kept_out[0]}; the same reason against 1 more row: 4", str(kept_out[1])]


def test_users_shape_goes_through(lab, tmp_path, root):
    catalogue = load_catalogue(root / "workflow" / "indenters.toml", ["cuboid_7"])
    write_used(lab.of, indenters={"mine": {"kind": "stl", "file": "shapes/mine.stl", "spacing": 0.3}})
    (tmp_path / "workflow/shapes").mkdir(parents=True)
    mine = tmp_path / "workflow/shapes/mine.stl"
    triangles.write_stl(mine, *catalogue["cuboid_7"].surface())
    table, rejected, folder = lab([sample("a", indenter="mine"), sample("b", indenter="mine", z0_mm=3.0)])
    assert [row["sample_id"] for row in table] == ["a"]
    assert [row["column"] for row in rejected] == ["dz_mm"]
    assert read_stl(folder / "a.stl")[0][:, 2].max() == pytest.approx(1.5, abs=1e-5)
    mine.write_bytes(mine.read_bytes()[:500])
    table = read_json(lab.of.used("0000"))["indenters"]
    write_used(lab.of, indenters=table | {"ball": {"kind": "sphere", "diameter": 15.0, "height": 10.0}})
    table, rejected, _ = lab([sample("a", indenter="mine"), sample("b", indenter="ball")])
    assert [row["sample_id"] for row in table] == ["b"]  # a broken shape keeps out its own presses alone
    assert [(row["column"], "mine.stl" in row["hint"]) for row in rejected] == [("indenter", True)]


def test_sensors_without_their_facts_keep_out_their_presses(lab, root):
    """What labels need of a sensor is asked before anything is solved, and one sensor's fault is its own presses'."""
    tables = tomllib.loads((root / "workflow/sensors.toml").read_text())
    wrong = {
        "no_image": ({"image": None}, "image"),
        "no_gel": ({"gel": None}, "gel"),
        "jelly": ({"gel": "jelly"}, "jelly"),
        "words": ({"image": "320x240"}, "image"),
        "mirror": ({"projection": [[0.0, 14.0, 160.0], [-14.0, 0.0, 120.0], [0.0, 0.0, 1.0]]}, "mirrored"),
    }
    for name, (table, _) in wrong.items():
        changed = {key: value for key, value in (tables["gelsight_mini"] | table).items() if value is not None}
        tables[name] = changed
    lab.sensors(tables)
    good, rejected, _ = lab([*(sample(name, sensor_id=name) for name in wrong), sample("b")])
    assert [row["sample_id"] for row in good] == ["b"]
    assert [(row["sample_id"], row["column"]) for row in rejected] == [(name, "sensor_id") for name in wrong]
    for row, (_, says) in zip(rejected, wrong.values(), strict=True):
        assert says in row["hint"] and "workflow/sensors.toml" in row["hint"]


def test_nearest_finds_a_grazing_touch(root):
    sphere = load_catalogue(root / "workflow" / "indenters.toml", ["sphere_10"])["sphere_10"]
    # at the apex the tip is the only point to touch; the finer samples miss it by 0.0125 mm at most, which is
    # 2e-5 mm of height
    for depth in (-0.01, -0.001):
        assert touch.nearest(Gel(), sphere, Press(0.07, 0.11, 0.0, 0, 0, depth - 0.001)) < 0.0
    assert touch.nearest(Gel(), sphere, Press(0.0, 0.0, 0.02, 0, 0, -0.01)) == pytest.approx(0.01, abs=1e-4)


def test_nearest_sees_a_touch_that_only_the_shear_brings(root):
    bar = load_catalogue(root / "workflow" / "indenters.toml", ["bar_5"])["bar_5"]
    aside = Press(0.0, 15.5, 0.0, 0.0, -3.0, -1.5)
    assert touch.nearest(Gel(), bar, Press(0.0, 15.5, 0.0, 0.0, 0.0, -1.5)) > 0.0
    assert touch.nearest(Gel(), bar, aside) < 0.0


def test_a_ring_thinner_than_the_points_of_the_gel_touches(root):
    """A wall of 0.02 mm, which passes between places that are 0.025 mm apart."""
    ring = build("ring", {"kind": "cylinder", "diameter": 10, "hole": 9.96, "fillet": 0.01, "height": 5})
    gel = Gel()
    for x in (0.0, 0.013, 0.31):
        assert touch.nearest(gel, ring, Press(x, 0.0, 0.0, 0, 0, -0.5)) < 0.0
        assert touch.first_touch(gel, ring, Press(x, 0.0, 0.0, 0, 0, -0.5)) is not None
    assert touch.nearest(gel, ring, Press(0.0, 0.0, 1.0, 0, 0, -0.5)) > 0.0


def test_a_body_that_would_vanish_in_the_gel_is_reported_with_its_size(lab, tmp_path, root):
    """A file in inches: the gel closes above a body that is lower than the press is deep."""
    vertices, faces = load_catalogue(root / "workflow" / "indenters.toml", ["sphere_15"])["sphere_15"].surface()
    (tmp_path / "workflow").mkdir()
    triangles.write_stl(tmp_path / "workflow/ball.stl", vertices / 25.4, faces)
    mine = {"kind": "stl", "file": "ball.stl", "spacing": 0.1}
    write_used(lab.of, indenters={"mine": mine})
    deep = sample("deep", indenter="mine", dz_mm=-1.2)
    table, rejected, _ = lab([deep, sample("light", indenter="mine", dz_mm=-0.2)])
    assert [row["sample_id"] for row in table] == ["light"]
    (row,) = rejected
    size = " x ".join(f"{side / 25.4:.3g}" for side in np.ptp(vertices, axis=0))
    assert row["column"] == "indenter" and f"{size} mm large; is its file in inches (scale = 25.4)" in row["hint"]


def test_cropped_is_closed_ends_where_asked_and_is_what_an_exact_cut_leaves(root):
    """Of every kind of indenter; the exact cut is libigl's, with a box."""
    catalogue = load_catalogue(root / "workflow" / "indenters.toml")
    for k, (name, body) in enumerate(catalogue.items()):
        whole, height = body.surface(), (0.5, 1.5, 2.5)[k % 3]
        vertices, faces = cropped(body, height)
        assert triangles.is_watertight(faces), name
        assert vertices[:, 2].max() == pytest.approx(min(height, whole[0][:, 2].max()), abs=1e-9)
        assert 0.0 < triangles.volume(vertices, faces) <= triangles.volume(*whole)
    box = triangles.stacked(
        [np.array([[[-50, -50], [50, -50], [50, 50], [-50, 50]]] * 2, float)], np.array([-1.0, 1.5])
    )
    for name in ("zelda_15", "pyramid_10", "cylinder_10_7", "cuboid_2_5_3", "solid_01", "key"):
        exact = triangles.boolean(catalogue[name].surface(), box, "intersection")
        assert triangles.volume(*cropped(catalogue[name], 1.5)) == pytest.approx(
            triangles.volume(*exact), rel=1e-9
        ), name


RIGID = replace(parameters().poses, touch_offset_mm=0.0, compliance_mm_per_n=0.0, shear_compliance_mm_per_n=0.0)
YIELDING = replace(RIGID, compliance_mm_per_n=0.01, shear_compliance_mm_per_n=0.02)


def test_the_paths_of_a_yielding_bench_are_those_the_tip_took(root):
    """The rig's own truth: with its compliance and touch offsets, logged paths are the real ones to its tolerances."""
    truth = json.loads((root / "data/demo/truth/truth.json").read_text())
    bench, mountings = truth["truth"], truth["mountings"]
    params = {name: bench[name] for name in ("compliance_mm_per_n", "shear_compliance_mm_per_n")}
    params["touch_offset_mm"] = -bench["touch_offset_mm"]  # the rig counts heights, [poses] depths
    params["mounting_touch_offset_mm"] = {name: -one["touch_offset_mm"] for name, one in mountings.items()}
    table = replace(parameters().poses, **params)
    real = {row["sample_id"]: row for row in read(root / "data/demo/truth/presses.csv")}
    off, uncorrected = [], []
    for row in log.read_log(root / "data/demo/log.csv"):
        logged, _ = parse(row, "log.csv")
        path, wrong = poses.yielded(logged, "log.csv", table)
        assert not wrong
        true = real[path.sample_id]
        away = [getattr(path, name) - float(true[name]) for name in ("dx_mm", "dy_mm")]
        away.append(path.z0_mm + path.dz_mm - float(true["z0_mm"]) - float(true["dz_mm"]))
        off.append(away)
        uncorrected.append(logged.z0_mm + logged.dz_mm - float(true["z0_mm"]) - float(true["dz_mm"]))
    spread = 4 * (bench["touch_scatter_mm"] + 3 * bench["cnc_um"] * 1e-3) + 1e-3
    assert np.abs(off).max() < spread
    assert np.abs(uncorrected).max() > 5 * spread


def test_a_rigid_bench_moves_nothing():
    press = sample(dx_mm=0.1, fx_n=3.0, fz_n=-20.0)
    assert poses.yielded(press, "log.csv", RIGID) == (press, [])


@pytest.mark.parametrize(("column", "readings"), [("fz_n", {"fx_n": 1.0, "fy_n": 1.0}), ("fx_n", {"fz_n": -9.0})])
def test_a_press_without_the_reading_that_compliance_takes_is_rejected(column, readings):
    _, wrong = poses.yielded(sample(**readings), "log.csv", YIELDING)
    assert (wrong[0].column, wrong[0].value) == (column, "")
    assert "force reading" in wrong[0].reason


def test_a_touch_found_too_high_is_a_deeper_press():
    path, _ = poses.yielded(sample(), "log.csv", replace(RIGID, touch_offset_mm=0.05))
    assert (path.z0_mm, path.dz_mm) == (-0.05, -1.0)


def test_tilt_is_that_of_the_row_then_of_its_mounting_then_of_the_bench():
    table = replace(RIGID, tilt_deg=(1.0, 0.0), mounting_tilt_deg={"again": (0.0, -2.0)})
    for cells, tilt in (
        ({}, (1.0, 0.0)),
        ({"mounting": "other"}, (1.0, 0.0)),
        ({"mounting": "again"}, (0.0, -2.0)),
        ({"mounting": "again", "tilt_y_deg": 0.5}, (0.0, 0.5)),
        ({"mounting": "again", "tilt_x_deg": 0.5, "tilt_y_deg": 0.0}, (0.5, 0.0)),
    ):
        path, wrong = poses.yielded(sample(**cells), "log.csv", table)
        assert path.tilt == tilt and not wrong


def test_the_pose_table_names_the_mounting_and_holds_its_tilt(lab):
    write_stage(lab.of.params, "poses", poses={"mounting_tilt_deg": {"b": [0.0, -2.0]}})
    table, _, _ = lab([sample("first", mounting="a"), sample("again", mounting="b")])
    assert [(row["mounting"], row["tilt_y_deg"]) for row in table] == [("a", ""), ("b", "-2.0")]


def test_a_bench_that_gives_way_by_more_than_the_press_is_rejected():
    _, wrong = poses.yielded(sample(dz_mm=-0.2, fx_n=0.0, fy_n=0.0, fz_n=-40.0), "log.csv", YIELDING)
    assert [(r.column, "times the bench compliance exceeds the depth" in r.reason) for r in wrong] == [
        ("dz_mm", True)
    ]


def test_a_bench_that_gives_way_sideways_by_more_than_the_press_moves_is_rejected():
    """The path that is left would go the other way: no press goes there, whatever drags the gel."""
    for way, force, column in (
        ((0.1, 0.0), (6.0, 0.0), "dx_mm"),
        ((0.0, -0.1), (0.0, -5.0), "dy_mm"),
        ((0.3, 0.1), (20.0, 0.0), "dx_mm"),
    ):
        cells = {"dx_mm": way[0], "dy_mm": way[1], "fx_n": force[0], "fy_n": force[1], "fz_n": -9.0}
        _, (row,) = poses.yielded(sample(**cells), "log.csv", YIELDING)
        assert row.column == column and "times the bench compliance exceeds the sideways travel" in row.reason
        assert "shear_compliance_mm_per_n = 0.02" in row.hint and "sign of fx_n, fy_n" in row.hint
        # a third of it leaves a press, and a way that no axis can distinguish from none is none
        third = {"fx_n": force[0] / 3, "fy_n": force[1] / 3}
        for change in (third, {"dx_mm": 0.005, "dy_mm": 0.0}):
            assert poses.yielded(sample(**cells | change), "log.csv", YIELDING)[1] == []


def test_frames_that_go_back_are_rejected_and_the_table_says_which_press(lab):
    film = [sample(f"f{k}", press_id="film", dz_mm=depth) for k, depth in enumerate((-0.4, -0.8, -0.6, -1.0))]
    table, rejected, _ = lab([*film, sample("alone")])
    assert [(row["sample_id"], row["press_id"]) for row in table] == [
        ("f0", "film"), ("f1", "film"), ("f3", "film"), ("alone", ""),
    ]  # fmt: skip
    assert [(row["sample_id"], row["row"]) for row in rejected] == [("f2", "4")]


@pytest.mark.parametrize("params", [YIELDING, RIGID])
def test_a_press_whose_reading_pulls_is_rejected(params):
    """It would mislead whoever compares with it, whatever the bench does; near touch a force sensor errs by as much."""
    for fz_n, rejected in ((-3.0, False), (0.1, False), (3.0, True)):
        wrong = poses.pulling(sample(fx_n=0.0, fy_n=0.0, fz_n=fz_n), "log.csv", params)
        assert [r.column for r in wrong] == ["fz_n"] * rejected
    near = sample(z0_mm=0.5, dz_mm=-0.7, fx_n=0.0, fy_n=0.0, fz_n=0.8)
    assert bool(poses.pulling(near, "log.csv", params)) == (params is YIELDING)


def test_a_log_with_its_forces_turned_round_says_so_once_with_the_likely_cause(lab, capsys):
    turned = [sample(name, x0_mm=x, fz_n=5.5 + x) for x, name in enumerate("abc")]
    table, rejected, _ = lab(turned)
    assert not table and [(r["column"], float(r["value"])) for r in rejected] == [("fz_n", 5.5 + x) for x in range(3)]
    said = capsys.readouterr().err
    assert said.count("multiply the force columns by -1") == 1 and "2 more rows: 3, 4" in said


def test_presses_that_show_one_picture_are_named_and_kept(lab, tmp_path, capsys):
    rows = [sample("a"), sample("b", image="images/b.png", y0_mm=1.0), sample("c", y0_mm=2.0)]
    cv2.imwrite(str(lab.of.data / "images/b.png"), np.full((240, 320, 3), 91, np.uint8))
    write_json(lab.of.pictures("0000"), {"repeated": {"2": "row 4, c,", "4": "row 2, a,"}})
    good, rejected, _ = lab(rows)
    said = capsys.readouterr().err
    assert [row["sample_id"] for row in good] == ["a", "b", "c"] and rejected == []
    assert said.count("kept, in one split") == 2 and "a: image = 'images/a.png': row 4, c, shows a picture" in said
