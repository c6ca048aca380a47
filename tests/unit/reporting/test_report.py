"""The page holds everything itself, and nothing that data says becomes markup."""

import base64
import json
import math
import re
import zlib
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pytest

from gelforge.flow.files import write_csv, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.runs import costs_of, last_runs, stages
from gelforge.geometry.gel import USUAL_GEL, load_gel
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.mechanics.mesh.hexmesh import FineBox
from gelforge.mechanics.mesh.hexname import HexMeshName
from gelforge.records.forcefile import ForceFile, SampleForces, write_forces
from gelforge.records.press import PosedPress
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import Solved, read_solves, write_solves
from gelforge.records.status import Status
from gelforge.reporting.explorer import Explorer, Resampler, Shard, grid_points
from gelforge.reporting.page import Section, render
from gelforge.reporting.parts import forget_parts, pack, place_parts, script_json
from gelforge.reporting.presses import as_columns, press_rows
from gelforge.stages import forces, report
from gelforge.stages.report import branch_section, calibration_section, failures_section, network_section, with_forces
from tests.support.explored import GELS, tables, write_page
from tests.support.parameters import write_stage
from tests.support.press_records import press_record
from tests.support.pressed_dataset import HEXAHEDRA, bump, make_mesh, write_pressed


def test_a_corrupt_record_of_a_target_keeps_no_page_from_being_written(tmp_path):
    """What the target cost is lost with it, and nothing else; also where it parses, but lacks what is asked for."""
    results = tmp_path / "results/lab"
    whole = {"started": 1.0, "seconds": 2.0, "cpu_seconds": 1.0, "peak_mib": 10.0}
    write_json(results / "metrics/10_poses/0000.json", whole)
    lacking = [json.dumps({key: value for key, value in whole.items() if key != gone}).encode() for gone in whole]
    broken = (b"", b'{"seconds": 1', b"\xff\xfe", b"[1]", json.dumps(whole | {"seconds": None}).encode(), *lacking)
    for at, content in enumerate(broken, 1):
        (results / f"metrics/10_poses/{at:04d}.json").write_bytes(content)
    costs = costs_of(last_runs(results))
    assert costs == {"10_poses/0000": whole} and [one["seconds"] for one in stages(results, costs)] == [2.0]


def test_an_indenter_is_drawn_as_far_up_as_the_gel_can_reach(tmp_path):
    """Beside the apex a press begins lower: where its tip ends shows how much of the indenter is there, not its way down."""
    rows = [
        {"id": name, "indenter": "ball", "stl": f"{name}.stl", "z0_mm": z0, "dz_mm": dz}
        for name, z0, dz in (("apex", 0.0, -1.5), ("rim", -1.0, -1.2), ("light", -1.0, -0.3))
    ]
    assert Explorer(tmp_path, "4x5", rows, {}, load_gel(USUAL_GEL)).deepest()["ball"]["id"] == "rim"


def test_text_from_data_is_escaped():
    section = Section("Failures").table(["sample"], [["<script>alert(1)</script>"]]).text("a < b & c")
    page = render("<b>lab</b>", "lead", [section])
    assert "<script>alert" not in page and "<b>lab" not in page
    assert "&lt;script&gt;" in page and "a &lt; b &amp; c" in page


def test_the_page_states_the_materials_forces_and_what_stage_40_refused(tmp_path):
    """A press without a picture has no place in the dataset: its force is the one that its label would have."""
    solves = [Solved(name, Status.OK, "", "hex", "mesh", "", (0.0, 0.0, -10.0), {}) for name in "abc"]
    nodes, force = np.array([0]), np.array([[0.0, 0.0, -20.0]])
    sound = SampleForces("a", "OK", "mesh", nodes, force, np.zeros((1, 3)))
    write_forces(tmp_path / "0000.npz", [sound, SampleForces.failed("b", "UNBALANCED", "mesh")], 0.145)
    a, b, c = with_forces(solves, tmp_path / "0000.npz")
    assert a.total == (0.0, 0.0, -20.0) and a.status is Status.OK and not a.reason
    assert b.status is Status.UNBALANCED and b.reason == Status.UNBALANCED.value
    assert c == solves[2]


def test_what_a_solve_cost_comes_from_its_record_in_the_store(tmp_path):
    """Its table holds none of it, because the same solve has other seconds each time."""
    of = Layout(tmp_path / "results/d")
    write_csv(of.shard("0000"), ["sample_id"], [])
    solves = [
        Solved(name, Status.OK, "", "label", "m", f"key-{name}", (0.0, 0.0, -1.0), {"seconds": 9.0}) for name in "ab"
    ]
    write_solves(of.fea("0000"), solves)
    assert math.isnan(report.read_solved(of.root)["a"].number("seconds"))
    SolveStore(of.solves).publish("key-a", {"evidence": {"seconds": 3.25, "peak_mib": 77.0}}, {})
    found = report.read_solved(of.root)
    assert (found["a"].number("seconds"), found["a"].number("peak_mib")) == (3.25, 77.0)
    assert math.isnan(found["b"].number("seconds"))
    (table,) = report.fidelities_section(found).items
    assert table["rows"] == [["label", "1", "3.25", "3.25"]]


def test_a_stated_error_is_the_same_part_of_the_force_from_solve_to_page(tmp_path):
    """Whatever C10 the labels have: a solve of 10 N +- 0.3 N becomes 20 N +- 0.6 N where the gel is twice as stiff."""
    of, mesh = Layout(tmp_path / "results/lab"), make_mesh()
    force = bump(mesh, 0.0, 0.0, 3.0, (0.0, 0.0, -10.0))[mesh.surface_nodes]
    SolveStore(of.solves).publish("a", {"status": "OK"}, {"force": force, "displacement": 0 * force})
    stated = {"error_n": 0.3, "cells_error_n": 0.9, "friction_error_n": 0.5}
    write_solves(of.fea("0000"), [Solved("s", Status.OK, "", "draft", HEXAHEDRA, "a", (0.0, 0.0, -10.0), stated)])
    pressed = PosedPress(
        **{key: value for key, value in vars(press_record(sample_id="s")).items() if key != "time_utc"}
    )
    for stiffer in (1.0, 2.0, 0.5):
        write_stage(of.params, "forces", material={"c10": stiffer * REFERENCE_C10})
        forces.main([str(of.root), "0000"])
        with ForceFile(of.forces("0000")) as shard:
            assert shard.total[0] == pytest.approx([0.0, 0.0, -10.0 * stiffer], abs=1e-9)
            found = [shard.numbers[name][0] for name in stated]
        assert found == pytest.approx([0.3 * stiffer, 0.9 * stiffer, 0.5 * stiffer])
        solved = {one.sample_id: one for one in with_forces(read_solves(of.fea("0000")), of.forces("0000"))}
        row = press_rows([("0000", pressed)], [], solved, {}, {}, {pressed.sensor_id: USUAL_GEL})[0]
        assert row["label_fz"] == pytest.approx(-10.0 * stiffer) and row["error_n"] == pytest.approx(0.3 * stiffer)
        assert row["friction_error_n"] == pytest.approx(0.5 * stiffer)


def test_the_page_asks_nothing_from_outside(tmp_path):
    page = write_page(tmp_path, 20).read_text(encoding="utf-8")
    sources = re.findall(r'<[^>]*(?:src|href)="([^"]{0,30})', page)
    assert sources and all(source.startswith(("data:", "#")) for source in sources)
    assert "fetch(" not in page and "XMLHttpRequest" not in page.split("var THREE")[0]


def test_text_in_a_script_cannot_end_it():
    text = "</script><!-- \u2028 &amp;"
    held = script_json({"a": text})
    assert not set("<>&\u2028") & set(held) and json.loads(held) == {"a": text}


def unpacked(packed: dict) -> dict:
    """What the page's `unpack` reads."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8).reshape(2, -1)
    values, at, found = (planes[0] | planes[1].astype(np.uint16) << 8).view(np.int16), 0, {}
    for name, length, unit in packed["arrays"]:
        found[name], at = values[at : at + length] * unit, at + length
    return found


def test_packed_arrays_come_back_to_half_a_unit():
    rng = np.random.default_rng(1)
    maps, points = rng.normal(0, 0.1, (3, 24, 32)), rng.uniform(-12, 12, (50, 3))
    found = unpacked(pack({"maps": maps, "points": (points, 1e-3), "none": np.zeros((0, 3))}))
    assert np.abs(found["maps"] - maps.ravel()).max() <= np.abs(maps).max() / 32767
    assert np.abs(found["points"] - points.ravel()).max() <= 0.5e-3 + 1e-9
    assert found["none"].size == 0 and unpacked(pack({})) == {}


def test_parts_lie_beside_the_page_only_where_they_are_large(tmp_path):
    texts = [(k, "x" * 100) for k in range(5)]
    assert place_parts(tmp_path, texts, 1000) == ("", ["x" * 100] * 5) and not list(tmp_path.iterdir())
    folder, held = place_parts(tmp_path, texts, 250)
    assert not held and sorted(path.name for path in (tmp_path / folder).iterdir()) == [f"{k}.js" for k in range(5)]
    other, _ = place_parts(tmp_path, [(0, "y" * 900)], 250)
    forget_parts(tmp_path, other)
    assert [path.name for path in tmp_path.iterdir()] == [other] != [folder]


def test_a_linear_displacement_is_carried_to_the_grid_exactly():
    gel = load_gel("gelsight_mini")
    mesh = HexMeshName(gel.name, FineBox(-3, 3, -4, 4, 0.8), 3, 1.2, 1.3, 2.0).mesh()
    resampler = Resampler(mesh, gel)
    slope = np.array([[0.01, 0.02, -0.03], [0.0, -0.01, 0.02]])
    moved = resampler(resampler.places[:, :2] @ slope)
    points = grid_points(gel)[2]
    inside = gel.edge_distance(points[:, 0], points[:, 1]) < -0.5
    assert np.abs(moved - points[:, :2] @ slope)[inside].max() < 1e-6


def test_every_press_and_every_rejected_row_is_in_the_table():
    rows = press_rows(*tables(25))
    table = as_columns(rows)
    assert len(table["id"]) == 26 and table["id"][-1] == "row 7"
    reason = table["reason"]["names"][table["reason"]["at"][-1]]
    assert reason == "dz_mm: not a number; write a number of millimetres"
    assert table["label_fz"][9] is None and table["label_fz"][-1] is None
    assert table["network_fx"][0] == 0.3 and table["network_fy"][0] == -0.08
    json.dumps(table, allow_nan=False)


def test_a_rejected_row_shows_nothing_of_the_press_whose_name_it_bears(tmp_path):
    """A log may name two presses alike: the later one is rejected, and has neither mesh nor label."""
    results = write_pressed(tmp_path, count=2)["results"]
    shard = replace(Shard.read(results, "4x5", "0000"), labels={"s000": np.zeros((3, 4, 5), np.float32)})
    twin = {"id": "s000", "status": "REJECTED", "reason": "sample_id: stands twice", "shard": "0000"}
    explorer = Explorer(results, "4x5", [twin], {}, load_gel(USUAL_GEL))
    assert explorer.press(twin, shard) == pack({}) != explorer.press(twin | {"status": "OK"}, shard)


def test_a_press_is_drawn_on_the_mesh_of_its_forces(tmp_path):
    """The table of its shard's solves may be gone or not made again yet; one that failed has nothing to draw."""
    made = write_pressed(tmp_path, count=2, failed=[1])
    good, failed = ({"id": name, "status": "PENDING", "shard": "0000"} for name in ("s000", "s001"))
    one, other = Explorer(made["results"], "4x5", [good, failed], {}, load_gel(USUAL_GEL)).presses()
    assert {name for name, _, _ in one["arrays"]} == {"gel", "points", "forces"} and other == pack({})


def test_every_press_names_the_gel_of_its_sensor(tmp_path):
    rows = press_rows(*tables(12))
    assert {(row["sensor"], row["gel"]) for row in rows if "sensor" in row} == set(GELS.items())
    assert Explorer(tmp_path, "4x5", rows, {}, load_gel(USUAL_GEL)).shared()["heights"] == {
        "gelsight_mini": 4.0,
        "gelsight_mini-2.6mm": 2.6,
    }


def test_stages_know_what_they_read(tmp_path):
    cost = {"started": 1.0, "seconds": 2.0, "cpu_seconds": 1.0, "peak_mib": 10.0, "inputs": []}
    inputs = [str(tmp_path / "10_poses" / "0000.csv"), str(tmp_path / "00_plan" / "params" / "fea.json")]
    costs = {"10_poses/0000": cost, "30_fea/0000": cost | {"started": 2.0, "inputs": inputs, "peak_mib": 99.0},
             "30_fea/0001": cost | {"started": 3.0}}  # fmt: skip
    poses, fea = stages(tmp_path, costs)
    assert fea["reads"] == ["10_poses"] and fea["targets"] == 2 and fea["seconds"] == 4.0 and fea["peak_mib"] == 99.0
    assert poses["reads"] == []


def test_failures_are_listed_with_their_reasons(tmp_path):
    failed = Solved("s1", Status.DIVERGED, "why", "ccx", "", "", (0.0, 0.0, 0.0), {})
    section = failures_section(tmp_path, {"s1": failed})
    assert any(["s1", "DIVERGED", "why", "ccx"] in item.get("rows", []) for item in section.items)
    assert "None" in failures_section(tmp_path, {}).items[0]["text"]


def test_versions_are_reported_where_a_package_is_missing_and_of_the_calculix_that_solves(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "PACKAGES", (*report.PACKAGES, "no-such-package"))
    monkeypatch.setenv("CCX", str(tmp_path / "no_such_ccx"))
    found = dict(report.versions_section(tmp_path).items[0]["rows"])
    name = "opencv-contrib-python-headless"
    assert found[name] == version(name)
    assert found["no-such-package"] == found["CalculiX"] == "not installed"


def test_what_was_not_made_is_reported_with_what_makes_it_of_this_dataset(tmp_path):
    of = tmp_path / "results/mylab"
    sections = [
        calibration_section(of),
        network_section(of, "24x32", "pair_16"),
        branch_section(of, "", "pareto", "", of / "none.png"),
    ]
    for section, goal in zip(sections, ("calibrate", "evaluate", "pareto"), strict=True):
        assert f"make {goal} DATASET=mylab" in str(vars(section))
