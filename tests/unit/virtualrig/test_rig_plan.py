"""Plans of the virtual rig: what is refused before anything is written, and what growing keeps."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gelforge.flow.files import read_json
from gelforge.flow.params import with_content
from gelforge.geometry import triangles
from gelforge.geometry.indenters import build, load_catalogue, read_catalogue
from gelforge.stages import rig
from gelforge.stages.rig import by_press, check, run
from gelforge.virtualrig import streams
from gelforge.virtualrig.appearance import read_appearances
from gelforge.virtualrig.bench import load_cell_error
from gelforge.virtualrig.rigplan import generator, kind_of, orders, read_plan, with_indenters
from gelforge.virtualrig.writer import Dataset, describe, image_name, surface_name
from tests.support.refused import refused
from tests.support.sandbox import ROOT

DEMO = ROOT / "workflow" / "rig" / "demo.toml"
TRAIN = ROOT / "workflow" / "rig" / "train.toml"
PAPER = ROOT / "workflow" / "rig" / "paper.toml"
SHAPES = ROOT / "workflow" / "rig" / "shapes.toml"


def changed(tmp_path, source, *changes) -> Path:
    """A shipped file with text replaced, by its name."""
    text = source.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / source.name
    path.write_text(text, encoding="utf-8")
    return path


def test_bad_plan_is_refused_by_name_before_anything_is_written(tmp_path):
    depth, turn, frames = "depth_mm = [0.3, 1.5]", "rot_deg = [0, 360]", "presses = 23"
    for old, new, said in (
        ('"cylinder_8"', '"cylinder_88"', "unknown indenter cylinder_88"),
        ('sensors = ["mini_e"]', 'sensors = ["mini_z"]', "unknown sensor mini_z"),
        ('sensors = ["mini_e"]', 'sensors = ["gelsight_mini"]', "unknown sensor's appearance gelsight_mini"),
        ("x_mm = [-2.5, 2.5]", "x_mm = [-2.5, 9.0]", "the tip must stay within"),
        ("y_mm = [-4.0, 4.0]", "y_mm = [4.0, -4.0]", "the lower one first"),
        (depth, "depth_mm = [0.3, 4.5]", "the gel is 4.0 mm thick"),
        (depth, "depth_mm = [0.3, nan]", "depth_mm = .*nan.*give a list of 2, each a number from 1e-09"),
        ("weight = 4\n", "weight = 0\n", "weight = 0: give a number from 1e-09"),
        (frames, "presses = 0", "presses = 0: give a whole number from 1"),
        (frames, 'presses = "many"', "presses = 'many': give a whole number"),
        (frames, f"presses = {streams.EVERY_PRESS + 1}", "presses"),  # the number that stands for all
        *((frames, f"{frames}\nframes = {count}", "frames") for count in (0, -1, 100, 2.5)),
        ("seed = 20260112", "sead = 20260112", "sead: unknown key; did you mean seed"),
        ('dataset = "demo"', 'dataset = "../demo"', "give a name of letters"),
        ('gel = "gelsight_mini"', 'gel = "digit"', "gel 'digit' is unknown"),
        ("2026-01-12T09:00:00Z", "yesterday", "is not a time"),
        ("2026-01-12T09:00:00Z", "9999-12-31T23:59:59Z", "end after the year 9999"),
        (turn, "rot_deg = [-1e308, 1e308]", "each a number from -3600 to 3600 degrees"),
        ("nu = 0.475", "nu = 0.5", r"\[truth\] nu = 0.5: give a number"),
        ("c10_mpa = 0.0853", "c10_mpa = 85.3", r"\[truth\] c10_mpa = 85.3: give a number from 0.002 to 5 MPa"),
        ("presses = [0, 7, 18]", "presses = [0, 48]", "the plan has presses 0 to 22"),
        ('[film]\nsensor = "mini_a"', '[film]\nsensor = "mini_z"', "unknown sensor mini_z"),
        (
            "[params.train]\nepochs",
            "[params.train]\nepoks",
            r"\[params.train\] epoks: unknown key; did you mean epochs",
        ),
    ):
        plan = changed(tmp_path, DEMO, (old, new))
        assert str(plan) in refused(said, run, plan, tmp_path / "data", ROOT / "workflow")
    known, gels = read_plan(PAPER).units.known, re.search(r"known_gels = \[.*?\]", PAPER.read_text(), re.DOTALL)[0]
    many = [f"gelsight_mini-{3 + t / 100:g}mm" for t in range(known // 2 + 1)]
    for names, said in (
        (["gelsight_mini-9mm"], "gel 'gelsight_mini-9mm': give a thickness"),
        (["gelsight_mini-2.5mm"], "the gel is 2.5 mm thick"),
        (many, "seen_by = 2: give 1 to 1"),
    ):
        refused(said, read_plan, changed(tmp_path, PAPER, (gels, f"known_gels = {json.dumps(names)}")))
    assert not (tmp_path / "data").exists()


def test_bad_stl_is_refused_before_anything_is_written(tmp_path):
    """A cuboid one of whose corners is pulled through its other side, and one without a face."""
    vertices, faces = load_catalogue(ROOT / "workflow" / "indenters.toml", ["cuboid_7"])["cuboid_7"].surface()
    pulled = vertices.copy()
    pulled[np.argmax(vertices[:, 2])] = [0.0, 0.0, -5.0]
    (tmp_path / "rig").mkdir()
    (tmp_path / "shapes.toml").write_text('[mine]\nkind = "stl"\nfile = "mine.stl"\n')
    for name in ("sensors.toml", "rig/sensors.toml"):
        (tmp_path / name).write_text((ROOT / "workflow" / name).read_text())
    plan = changed(tmp_path, DEMO, ('"indenters.toml"', '"shapes.toml"'))
    plan.write_text(re.sub(r"indenters = \[.*\]", 'indenters = ["mine"]', plan.read_text()))
    for body, said in (((pulled, faces), "cut through"), ((vertices, faces[:-1]), "not closed")):
        triangles.write_stl(tmp_path / "mine.stl", *body)
        refused(f"mine.*{said}", run, plan, tmp_path / "data", tmp_path)
    assert not (tmp_path / "data").exists()


def test_plans_that_travel_with_the_project_are_good():
    for path in (DEMO, TRAIN, PAPER, SHAPES):
        check(path, ROOT / "workflow")


def test_training_plan_covers_the_papers_envelope():
    plan = read_plan(TRAIN)
    known, solids, broad, unseen, others, unit = plan.kinds
    assert len(known.indenters) == 19
    assert len(unseen.indenters) == 5
    trained = {name for kind in (known, solids, broad) for name in kind.indenters}
    assert not trained & {*unseen.indenters, *others.indenters}
    assert {unit for kind in (known, solids, broad) for unit in kind.sensors} == set(known.sensors)
    assert len(known.sensors) >= 48 and len(unit.sensors) >= 12
    assert set(unit.sensors) == set(plan.held_out_sensors)
    assert not set(known.sensors) & set(unit.sensors)
    assert (kind_of(plan, plan.presses)[0] == 0).sum() >= 600


def test_shapes_that_are_there_to_be_learnt_from_are_in_no_other_plan():
    """Each is pressed, and none is one of the standard catalogue by another name, of which some test networks."""
    shapes, standard = (read_catalogue(ROOT / "workflow" / name) for name in ("shapes.toml", "indenters.toml"))
    assert not set(shapes) & set(standard)

    def body(table: dict) -> dict:
        return {key: value for key, value in table.items() if key not in ("seen", "spare", "height")}

    known = [body(table) for table in standard.values()]
    assert [name for name, table in shapes.items() if body(table) in known] == []
    plan = with_indenters(read_plan(SHAPES), shapes)
    assert {kind.indenters for kind in plan.kinds} == {tuple(shapes)}
    assert not any("unseen" in name for kind in plan.kinds for name in kind.sensors)


def test_every_look_agrees_with_its_sensor():
    from gelforge.labelling.sensor import load_sensors

    sensors, appearances = (
        load_sensors(ROOT / "workflow" / "sensors.toml"),
        read_appearances(ROOT / "workflow/rig/sensors.toml"),
    )
    assert len(appearances) >= 5
    for name, appearance in appearances.items():
        markers = sensors[name].markers
        missing = markers["rows"] * markers["cols"] - len(appearance.markers)
        assert 0 <= missing <= 2
        # misprints of half a pixel average out; a missing outer marker shifts the mean by 4 pitches of 33 px in 62
        assert np.abs(appearance.markers.mean(axis=0) - markers["centre_px"]).max() < 0.5 + 2.2 * missing
        assert appearance.diameter == pytest.approx(markers["diameter_px"])


def test_a_look_that_no_sensor_has_is_refused(tmp_path):
    shipped = ROOT / "workflow/rig/sensors.toml"
    for old, new, said in (
        ("flecks = ", "specks = ", r"\[mini_a.markers\] specks: unknown key"),
        ("white_balance = [1.0, 1.0, 1.0]", "white_balance = [1.0, 1.0]", "white_balance .*a list of 3"),
        ("red = [137.4, ", "red = [", "red = .*15 of them"),
        ("noise = [1.45, 1.2, 2.1]", "noise = [nan, 1.2, 2.1]", "noise = .*from 0 to 255"),
        ("slope_limit = 0.5", "slope_limit = 0", "slope_limit = 0: give a number from 0.001 to 100"),
        ("gain = 1.0", "gain = inf", "gain = inf"),
        (
            "height_mm = 25.0",
            "height_mm = 3.0",
            r"\[mini_a.camera\] height_mm = 3.0: give a number from 5 to 10000 mm",
        ),
        ("height_mm = 25.0", "", r"\[mini_a.camera\] height_mm is missing; write it as in workflow/rig/sensors.toml"),
        ("rows = 7", "rows = 1", "rows = 1: give a whole number from 2"),
        ("seed = 1\n", "seed = 1\nmissing = [99]\n", "missing: there are 63 markers, counted from 0"),
        ("shadow_length_px = [2.2, 3.4, 3.0]", "shadow_length_px = [-2.2, 3.4, 3.0]", "shadow_length_px = "),
        ("[mini_a.background]", "loose = 3\n[mini_a.background]", "loose is outside any table"),
        ('base = "mini_a"', 'base = ["mini_a"]', "must be a table without a base of its own"),
        ("[mini_b.light]\n", "[mini_b]\nlight = 3\n[mini_b.other]\n", "sensors.toml"),
    ):
        refused(said, read_appearances, changed(tmp_path, shipped, (old, new)))
    (tmp_path / "sensors.toml").write_bytes("# Gerät\n[mini_a.light]\n".encode("latin-1"))
    refused("sensors.toml: not UTF-8 text .*save it as UTF-8", read_appearances, tmp_path / "sensors.toml")
    refused("absent.toml: not found", read_appearances, tmp_path / "absent.toml")


def test_a_plans_parameters_stand_in_the_dataset_it_writes():
    """Of any name and text; sizes of hexahedra are keys."""
    demo = read_plan(DEMO)
    unseen = {"dataset": demo.params["dataset"] | {"unseen_sensors": list(demo.held_out_sensors)}}
    assert tomllib.loads(describe(demo))["params"] == demo.params | unseen
    assert replace(demo, params={}).identity() == demo.identity()
    for table in (
        {"stability": {"layers": {"0.7": 5, "0.35": 9}}},
        {"meshes": {"regions": {"left half": [2.0, 3.5], 'a "word"': [1.0, 1.0]}}},
        {"calibrate": {"priors": {"nu": {"reason": 'measured \u00e4 \U0001f9ea \x7f \\ " by hand'}}}},
    ):
        plan = replace(demo, params=table, held_out_sensors=())
        assert tomllib.loads(describe(plan))["params"] == table
    drawn = replace(read_plan(DEMO.with_name("train.toml")), params={}, held_out_sensors=())
    assert tomllib.loads(describe(drawn))["params"] == {"poses": {"judge_images": False}}


def test_a_press_whose_truth_was_lost_is_repeated(tmp_path):
    """Its picture alone was drawn again, in every later run, because no row of the truth ever came back."""
    plan = read_plan(DEMO)
    order = orders(plan)[0]
    dataset = Dataset(tmp_path, plan)
    dataset.log[order.sample_id] = None
    for name in (image_name(order), surface_name(order)):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert by_press(dataset, [order]) == [([order], False)]
    dataset.truth[order.sample_id] = {"status": "OK"}
    assert by_press(dataset, [order]) == []
    (tmp_path / image_name(order)).unlink()
    assert by_press(dataset, [order]) == [([order], True)]


def test_the_shipped_demo_is_of_the_plan_the_indenters_and_the_sensors_of_today(root):
    """Else `make rig` would refuse the folder, or draw all its images anew."""
    plan = read_plan(DEMO)
    shapes, looks = rig.contents_of(plan, root / "workflow", *rig.units_of(plan, root / "workflow"))
    Dataset(root / "data/demo", plan).check_same_plan(shapes, looks)
    truth = read_json(root / "data/demo/truth/truth.json")
    assert (truth["shapes"], truth["looks"]) == (shapes, looks)


def test_corrupt_records_of_the_truth_are_refused(tmp_path):
    (tmp_path / "truth").mkdir()
    record, table = tmp_path / "truth/truth.json", tmp_path / "truth/presses.csv"
    for content in ("", '{"plan": "x', "[]", "{}"):
        record.write_text(content)
        dataset = Dataset(tmp_path, read_plan(DEMO))
        refused(r"truth.json: does not state which plan .* remove the folder", dataset.check_same_plan, {}, {})
    for content, said in (
        (b"a,b\n1,2\n", "column sample_id is missing, seen: a, b; remove it, and its presses are repeated"),
        (b"sample_id,status,x0_mm\ns-1,OK\n", "row 2 has another number of cells than the header, .*; remove it"),
        (b"\xff\xfe", "not UTF-8 text"),
    ):
        table.write_bytes(content)
        refused(f"presses.csv: {said}", Dataset, tmp_path, read_plan(DEMO))


def test_the_bench_and_the_calibration_read_the_stl_file_that_the_stages_read(tmp_path):
    """Paths start at workflow/, whichever folder in it the catalogue lies in: another file of that name is another body."""
    for folder, size in ((tmp_path, 6), (tmp_path / "mine", 4)):
        folder.mkdir(exist_ok=True)
        body = build("probe", {"kind": "cuboid", "size": [size, size], "fillet": 0.5, "height": 8})
        triangles.write_stl(folder / "probe.stl", *body.surface())
    (tmp_path / "mine/indenters.toml").write_text('[probe]\nkind = "stl"\nfile = "probe.stl"\n')
    tables = with_content(read_catalogue(tmp_path / "mine/indenters.toml"), tmp_path)
    demo = read_plan(DEMO)
    kind = replace(demo.kinds[0], indenters=("probe",), sensors=())
    plan = replace(demo, catalogue="mine/indenters.toml", kinds=(kind,))
    radius = build("probe", tables["probe"], folder=tmp_path).radius()
    assert load_catalogue(tmp_path / plan.catalogue, plan.indenters, tmp_path)["probe"].radius() == radius
    assert rig.contents_of(plan, tmp_path, {}, {})[0] == rig.digests(tables)


def test_orders_stay_in_their_ranges_and_share_out():
    plan = read_plan(DEMO)
    made, kinds = orders(plan), kind_of(plan, plan.presses)[0]
    for order, kind in zip(made, (plan.kinds[k] for k in kinds), strict=True):
        aside = np.hypot(*order.shear) / order.depth
        for value, (low, high) in ((order.x, kind.x_mm), (order.depth, kind.depth_mm), (aside, kind.shear)):
            assert low - 1e-12 <= value <= high + 1e-12
        assert order.indenter in kind.indenters and order.sensor in kind.sensors
    assert len({order.sample_id for order in made}) == plan.presses
    assert {order.indenter for order in made} == set(plan.indenters)


def test_orders_of_one_press_differ_in_what_sees_it_only():
    plan = read_plan(DEMO)
    plan = replace(plan, kinds=tuple(replace(kind, sensors=("mini_a", "mini_e")) for kind in plan.kinds))
    every = orders(replace(plan, kinds=tuple(replace(kind, seen_by=2) for kind in plan.kinds)))
    assert len(every) == 2 * plan.presses
    for one, other in zip(every[::2], every[1::2], strict=True):
        assert (one.sensor, other.sensor) == ("mini_a", "mini_e")
        assert replace(other, sample_id=one.sample_id, sensor=one.sensor, unit=one.unit) == one
    assert len({order.sample_id for order in every}) == len(every)
    # what is pressed where does not depend on who looks
    assert [order.x for order in every[::2]] == [order.x for order in orders(plan)]


GELS = tuple(f"gelsight_mini-{t}mm" for t in (3.6, 4.0, 4.4))


def on_gels(plan, gels=GELS):
    """The paper's plan with units on gels in turn."""
    return replace(plan, units=replace(plan.units, known_gels=gels, unseen_gels=gels), presses=400, frames=1)


def test_what_sees_one_press_sits_on_one_gel():
    plan = on_gels(read_plan(PAPER))
    every = orders(plan)
    seen: dict[int, list] = {}
    for order in every:
        assert order.gel == plan.gel_of(order.sensor)
        seen.setdefault(order.index, []).append(order)
    for index, of_press in seen.items():
        assert len({order.gel for order in of_press}) == 1, index
        assert len({order.sensor for order in of_press}) == len(of_press)
    assert {order.gel for order in every} == set(GELS)
    pressed = [of_press[0].gel for of_press in seen.values()]
    # of 400 presses a third each, within five standard deviations
    assert all(abs(pressed.count(gel) - 400 / 3) < 5 * np.sqrt(400 * 2 / 9) for gel in GELS)


def test_a_plan_of_one_gel_is_the_one_it_was():
    """What is pressed where, and who sees it, does not change because other plans have several gels."""
    plan = replace(on_gels(read_plan(PAPER), ()), presses=60, frames=read_plan(PAPER).frames)
    assert on_gels(plan).identity() != plan.identity()
    one = on_gels(plan, (plan.gel,))
    assert orders(replace(one, frames=plan.frames, presses=60)) == orders(plan)
    assert [order.x for order in orders(on_gels(plan)) if order.unit == 0][:60] == [
        order.x for order in orders(plan) if order.unit == 0 and order.frame == 0
    ]


def test_load_cell_drifts_slowly_about_its_bias():
    plan = read_plan(DEMO)
    error = np.array([load_cell_error(plan, i) for i in range(3000)])
    bias = np.array(plan.truth.force_bias_n)
    # three waves whose amplitudes sum to sqrt(3) of the drift
    assert np.abs(error - bias).max() <= np.sqrt(3.0) * plan.truth.drift_n + 1e-12
    # the fastest wave takes 80 presses, so no step is larger than 2 pi / 80 of the whole
    assert np.abs(np.diff(error, axis=0)).max() < 2 * np.pi / 80 * np.sqrt(3.0) * plan.truth.drift_n
    # a sine of that amplitude has 0.71 of it as standard deviation; waves of like periods add or cancel
    assert ((error.std(axis=0) > 0.3 * plan.truth.drift_n) & (error.std(axis=0) < 1.3 * plan.truth.drift_n)).all()


def test_frames_of_a_plan_are_rows_of_their_own(root, tmp_path):
    text = (root / "workflow/rig/demo.toml").read_text(encoding="utf-8")
    one = read_plan(root / "workflow/rig/demo.toml")
    assert not any(order.film_id for order in orders(one))
    (tmp_path / "p.toml").write_text(f"frames = 3\n{text}")
    filmed = read_plan(tmp_path / "p.toml")
    assert filmed.identity() != one.identity() and len(orders(filmed)) == 3 * len(orders(one))
    assert len({order.sample_id for order in orders(filmed)}) == len(orders(filmed))


# All of the first sensors, those about the end of the short numbers, and the last that `seen_by` allows.
UNITS = (*range(200), *range(990, 1010), *range(9_990, 10_010), *range(99_990, 100_010), 999_999)


def test_no_two_things_of_a_press_are_drawn_from_one_stream():
    """A picture of the eleventh frame once had the noise that the load cell had at another one."""
    frames = range(streams.MOST_FRAMES)
    cameras = [streams.camera(unit, frame) for unit in UNITS for frame in frames]
    purposes = [streams.ORDER, streams.BENCH, streams.WHO_SEES, *map(streams.load_cell, frames), *cameras]
    assert len(set(purposes)) == len(purposes)
    with pytest.raises(ValueError, match="frame = 99"):
        streams.camera(0, streams.MOST_FRAMES)


def test_streams_are_those_that_datasets_were_drawn_with():
    """Carried out again, a plan gives the presses and pictures it gave: the numbers of ten frames stay what they were."""
    assert (streams.ORDER, streams.BENCH, streams.WHO_SEES) == (0, 1, 20_000)
    assert [streams.load_cell(frame) for frame in range(99)] == [10_000 + frame for frame in range(99)]
    for frame in range(10):
        assert [streams.camera(unit, frame) for unit in range(998)] == [2 + u + 1000 * frame for u in range(998)]
    plan = read_plan(DEMO)
    drift = np.random.default_rng([plan.seed, 999_999_999])  # two numbers: numpy fills up with zeros
    assert (generator(plan, streams.EVERY_PRESS, streams.ORDER).random(9) == drift.random(9)).all()


def test_a_mounting_has_its_own_tilt_touch_and_stiffness(tmp_path):
    """Presses of one mounting share them; they are drawn in the plan's ranges and stay when the plan grows."""
    table = "[mountings]\npresses = 5\ntilt_deg = [1, 3]\ntouch_offset_mm = [-0.15, 0.0]\nseating = 0.1\n\n[truth]"
    plan = replace(read_plan(changed(tmp_path, SHAPES, ("[truth]", table))), presses=200)
    truths = [plan.truth_of(f"mounting_{index // 5 + 1:02d}") for index in range(200)]
    tilts = np.array([truth.tilt_deg for truth in truths])
    sizes, offsets = np.hypot(*tilts.T), np.array([truth.touch_offset_mm for truth in truths])
    assert len(np.unique(tilts, axis=0)) == len(np.unique(offsets)) == 40
    assert (tilts.reshape(40, 5, 2) == tilts[::5, None]).all()
    assert sizes.min() >= 1.0 and sizes.max() <= 3.0 and {*np.sign(tilts[:, 0]), *np.sign(tilts[:, 1])} == {-1.0, 1.0}
    added = offsets - plan.truth.touch_offset_mm
    assert -0.15 <= added.min() < added.max() <= 0.0
    stiffer = np.log([truth.c10_mpa / plan.truth.c10_mpa for truth in truths[::5]])
    assert abs(stiffer.std() - 0.1) < 5 * 0.1 / np.sqrt(2 * 40)
    assert replace(plan, presses=9).truth_of("mounting_02") == truths[9]
    names = {order.index: order.mounting for order in orders(plan)}
    assert [names[k] for k in range(6)] == [*5 * ["mounting_01"], "mounting_02"]


def test_a_sensor_may_be_a_mounting(tmp_path):
    plan = read_plan(DEMO)
    none = read_plan(SHAPES)
    assert none.truth_of("") is none.truth and "mountings" not in none.identity()
    assert {order.mounting for order in orders(none)} == {""}
    named = {(order.sensor, order.mounting) for order in orders(plan)}
    assert named == {("mini_a", ""), ("mini_e", ""), ("mini_b", "mini_b")}
    assert plan.truth_of("") is plan.truth and plan.truth_of("mini_b").tilt_deg != (0.0, 0.0)
    for old, new, said in (
        ('sensors = ["mini_b"]\ntilt', "tilt", "give either presses"),
        ('sensors = ["mini_b"]\ntilt', 'presses = 3\nsensors = ["mini_b"]\ntilt', "give either presses"),
        ('sensors = ["mini_b"]\ntilt', 'sensors = ["mini_z"]\ntilt', "unknown sensor mini_z"),
        ("max_force_n = 40\n", "max_force_n = 40\nseen_by = 2\n", "a press is of one mounting"),
    ):
        refused(said, check, changed(tmp_path, DEMO, (old, new)), ROOT / "workflow")
