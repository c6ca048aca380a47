"""A scene of the chart through real solves: kept, resumed, drawn; figures of the fea benchmark's deck reader."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gelforge.flow.params import altered
from gelforge.geometry.gel import GELS
from gelforge.labelling.sensor import load_sensors
from gelforge.records.status import Status
from gelforge.stages import pareto, stability
from gelforge.sweeps import cases
from gelforge.sweeps.methods import Method, hex_method, prepare
from gelforge.sweeps.scenes import parse_scene
from gelforge.sweeps.trial import load_bench
from tests.support.parameters import stage_of

GEL = GELS["gelsight_mini"]
METHODS = [hex_method(2.0, 2, 1), hex_method(1.4, 3, 2), hex_method(1.0, 4, 4)]


@pytest.fixture
def bench(tmp_path):
    return load_bench(stage_of("pareto"), load_sensors("workflow/sensors.toml"), tmp_path / "records")


def scene(name, table):
    return parse_scene(name, {"depth": 0.5, **table}, 0.475)


@pytest.mark.slow
def test_a_scene_is_solved_once_resumed_and_drawn(bench, tmp_path, capfd):
    ball = scene("ball", {"indenter": {"kind": "sphere", "diameter": 15, "height": 10}})
    first = pareto.solve_scene(bench, ball, METHODS)
    assert capfd.readouterr().out.count("ball hex") == len(METHODS)
    (bench.records / "ball" / "hex-1.4-2.json").unlink()
    (bench.records / "ball" / "hex-2-1.json").write_text('{"key": "trunc')
    again = pareto.solve_scene(bench, ball, METHODS)
    out = capfd.readouterr().out
    assert out.count("ball hex") == 2 and "hex-1-4" not in out
    # the same solve on the same machine: sums in another order at most
    for name in first["methods"]:
        assert np.allclose(first["methods"][name]["total"], again["methods"][name]["total"], rtol=1e-9, atol=1e-9)
    coarse = again["methods"]["hex-2-1"]
    cells = np.array(coarse["cells"])
    # cells are rounded to 1e-7 N, 768 of them per axis
    assert np.allclose(cells.sum(axis=(1, 2)) + coarse["outside"], coarse["total"], atol=1e-4)
    assert 0 < coarse["errors"]["total"] < 0.5 and again["methods"]["hex-1-4"]["errors"]["total"] == 0.0

    found = pareto.publish_chart(tmp_path / "chart.json", [again])
    assert {p.suffix for p in tmp_path.glob("chart.*")} == {".json", ".csv", ".png"}
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert [row["method"] for row in found["rows"]] == ["hex-2-1", "hex-1.4-2"]
    assert any(row["frontier_total"] for row in found["rows"])
    assert json.loads((tmp_path / "chart.json").read_text())["failures"] == []


@pytest.mark.slow
def test_a_scene_that_cannot_be_solved_is_listed_with_its_reason(bench, tmp_path):
    far = scene("far", {"indenter": {"kind": "sphere", "diameter": 2, "height": 10}, "x0": 9.0, "depth": 0.1})
    ball = scene("ball", {"indenter": {"kind": "sphere", "diameter": 15, "height": 10}})
    solved = [pareto.solve_scene(bench, s, METHODS[:2]) for s in (far, ball)]
    found = pareto.publish_chart(tmp_path / "chart.json", solved)
    row = found["rows"][0]
    assert row["scenes"] == 2 and row["failed"] == 1 and not row["frontier_total"]


@pytest.mark.parametrize("solver", ["hex", pytest.param("ccx", marks=pytest.mark.slow)])
def test_every_solver_of_the_map_solves_with_what_its_branch_is_given(solver, ccx, tmp_path):
    params = stage_of("stability")
    # how long a case may take is the chart's matter: a loaded machine is no fault
    params = altered(params, stability=altered(params.stability, limit_s=3000.0))
    size = 0.7 if solver == "hex" else 3.0
    case = replace(cases.centre(params.stability, solver, "round"), depth=0.2, size=size, steps=2)
    record = stability.solve_case(case, params, tmp_path)
    assert record["status"] == "OK", record["reason"]
    # a sphere of this size at 0.2 mm; the mesh is coarse
    assert -1.0 < record["total"][2] < -0.2
    assert stability.solve_case(case, params, tmp_path) == record


@pytest.mark.slow
def test_a_density_of_tetrahedra_follows_the_press(ccx, tmp_path):
    pressed = scene("ball", {"indenter": {"kind": "sphere", "diameter": 5, "height": 5}, "x0": 2.0, "y0": -1.5}).scene
    sizes = []
    for size in (2.0, 0.7):
        result, mesh = prepare(
            Method(f"ccx-{size:g}-2", "ccx", size, steps=2), pressed, stage_of("pareto"), tmp_path
        )()
        assert result.status is Status.OK, result.evidence
        ends = mesh.nodes[mesh.faces[:, [[0, 1], [1, 2], [2, 0]]]].reshape(-1, 2, 3)
        near = np.hypot(*(ends.mean(axis=1)[:, :2] - [2.0, -1.5]).T) < 2.0
        sizes.append(np.linalg.norm(ends[near, 0] - ends[near, 1], axis=1).max())
    assert sizes[1] < 0.7 * sizes[0]
