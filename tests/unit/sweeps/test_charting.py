"""Errors, frontiers, keys and verdicts behind the charts of the mechanics; solves in processes of their own."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gelforge.flow.files import write_json
from gelforge.flow.params import altered
from gelforge.labelling.sensor import load_sensors
from gelforge.stages import stability
from gelforge.stages.pareto import summarise
from gelforge.sweeps import cases
from gelforge.sweeps.deviation import cell_error, errors, frontier, total_error
from gelforge.sweeps.isolate import cpu_seconds, isolated
from gelforge.sweeps.methods import LARGE_REFERENCE, Method, every_method, method_of
from gelforge.sweeps.scenes import parse_scene, read_tables, resolve
from gelforge.sweeps.trial import kept, load_bench
from tests.support.parameters import parameters, stage_of
from tests.support.refused import refused
from tests.support.waiting import HANG, wait_until

pytestmark = pytest.mark.processes

NUMBERS = st.floats(-50, 50, allow_nan=False)
CELLS = arrays(float, (3, 4, 5), elements=NUMBERS)


@pytest.fixture(scope="module")
def params():
    return stage_of("pareto")


@pytest.fixture(scope="module")
def scenes(params):
    nu = params.material.nu
    return {name: parse_scene(name, table, nu) for name, table in read_tables("workflow").items()}


@settings(max_examples=30)
@given(CELLS, CELLS)
def test_cells_err_at_least_as_much_as_their_sum(cells, reference):
    """Errors of cells may cancel in the total, never the other way round."""
    total = np.array([0.0, 0.0, -10.0])
    difference = np.linalg.norm((cells - reference).sum(axis=(1, 2))) / 10.0
    # rounding of 20 summed cells of size 50
    assert cell_error(cells, reference, total) >= difference - 1e-12
    assert cell_error(cells, cells, total) == 0.0


@given(arrays(float, 3, elements=NUMBERS), st.floats(0.1, 10))
def test_total_error_has_no_unit(total, scale):
    reference = np.array([1.0, -2.0, -30.0])
    assert total_error(scale * total, scale * reference) == pytest.approx(total_error(total, reference), abs=1e-12)


def test_no_error_where_either_is_no_result():
    good = {"total": [0, 0, -1.0], "cells": np.ones((3, 2, 2))}
    assert errors(good, {"total": [0, 0, 0], "cells": None}) is None
    assert errors({"status": "DIVERGED"}, good) is None
    assert errors(good, good) == {"total": 0.0, "cells": 0.0}


@given(st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9)), min_size=1, max_size=12))
def test_frontier_beats_every_other_point(points):
    best = [p for p, good in zip(points, frontier(points), strict=True) if good]
    assert best
    for p in points:
        assert any(q[0] <= p[0] and q[1] <= p[1] for q in best)
    assert frontier([(1, 3), (1, 4), (2, 2), (3, 2), (4, 1)]) == [True, False, True, False, True]


def test_a_method_that_failed_on_a_scene_takes_no_other_off_the_frontier():
    def record(seconds, error):
        return {
            "method": {"solver": "hex", "size": 1.0, "steps": 10},
            "cpu_seconds": seconds,
            "errors": error and {"total": error, "cells": error},
        }

    scenes = [
        {
            "scene": name,
            "reference": "fine",
            "methods": {"sound": record(2.0, 0.02), "failing": record(1.0, error)},
        }
        for name, error in (("easy", 0.01), ("hard", None))
    ]
    scenes[0]["methods"]["seldom"] = record(0.5, 0.001)
    found = {
        row["method"]: (row["failed"], row["frontier_total"], row["frontier_cells"]) for row in summarise(scenes)
    }
    assert found == {"sound": (0, True, True), "failing": (1, False, False), "seldom": (0, False, False)}


def test_scenes_are_many_shapes(scenes):
    assert len(scenes) >= 12
    assert len({str(scene.table["indenter"]) for scene in scenes.values()}) >= 10


def test_a_scene_that_is_wrong_is_named():
    sphere = {"indenter": {"kind": "sphere", "diameter": 15, "height": 10}, "depth": 1.0}
    for change, named in (
        ({"indenter": "spheer"}, "spheer"), ({"indenter": ["ball"]}, "ball"), ({"gel": 5}, "gel '5'"),
        ({"detph": 1.0}, "detph"), ({"depth": -1.0}, "depth"), ({"x0": "1"}, "x0"),
    ):  # fmt: skip
        refused(named, lambda change=change: parse_scene("wrong", resolve("wrong", sphere | change, {}), 0.475))


def test_the_chart_holds_what_was_asked(params):
    methods = every_method(params.pareto, params.pareto.contact_scenes[0])
    assert len({m.name for m in methods}) == len(methods)
    for solver in ("hex", "ccx"):
        own = [m for m in methods if m.solver == solver and m.size]
        # one factor at a time: a full product would be hours
        assert len({m.size for m in own}) >= 2 and len({m.steps for m in own}) >= 2
        assert len(own) == len({m.size for m in own}) + len({m.steps for m in own}) - 1
    usual = {m.name for m in every_method(params.pareto, "punch")}
    assert {"draft", "label", "fine", "ccx", "auto", "reference"} <= usual
    assert {m.name for m in methods} - usual == {"ccx-contact"}


def test_a_key_follows_what_the_method_depends_on_and_nothing_else(params, scenes, tmp_path):
    def key(method, **changed):
        bench = load_bench(altered(params, **changed), load_sensors("workflow/sensors.toml"), tmp_path)
        return bench.key(scenes["punch"], method)

    stiffer = altered(params.fea, stiffness=1.0)
    loose = replace(params.fea, tolerance=0.5)
    hexahedron, ccx = Method("hex-1-8", "hex", 1.0, 4, 8), Method("ccx-1-8", "ccx", 1.0, steps=8)
    auto, label, tets = method_of("auto"), method_of("label"), method_of("ccx")
    assert key(hexahedron) == key(hexahedron, fea=stiffer)
    assert key(ccx) != key(ccx, fea=stiffer)
    assert key(hexahedron) == key(hexahedron, fea=loose)
    assert key(auto) != key(auto, fea=loose)
    assert key(hexahedron) != key(hexahedron, material=altered(params.material, nu=0.49))
    assert key(label) == key(label, fea=stiffer) and key(tets) != key(tets, fea=stiffer)
    # hours of solves: what a reference is one of, and nothing of how others solve
    moved = replace(params.pareto.reference, edge_mm=0.2)
    assert key(LARGE_REFERENCE) == key(LARGE_REFERENCE, fea=stiffer)
    assert key(LARGE_REFERENCE) != key(LARGE_REFERENCE, pareto=replace(params.pareto, reference=moved))


def doing(text):
    """Work that a process of its own can be given without importing this module, which costs seconds."""
    return partial(exec, text)


BEGINS_ONE_THAT_WORKS = """
import signal, subprocess, sys
from functools import partial
subprocess.run([sys.executable, "-c", "while True: pass"], preexec_fn=partial(die_with_parent, signal.SIGKILL))
"""


def test_a_solve_is_stopped_by_its_processor_time():
    for work in ("while True: pass", BEGINS_ONE_THAT_WORKS):
        before = cpu_seconds()
        found = isolated(doing(work), 0.5)
        # of a processor that others fill it may get less than that in ten times as long
        assert found["status"] == "TIMED_OUT" and found["reason"].startswith(
            ("stopped after 0.5 s", "stopped after 5")
        )
        assert cpu_seconds() - before > 0.5 or "by the clock" in found["reason"]  # a cost of this process


def test_a_solve_fails_in_its_own_process():
    refusing = doing("from gelforge.errors import BadInput; raise BadInput('too deep')")
    assert isolated(refusing, HANG) == {"status": "REFUSED", "reason": "too deep"}
    assert isolated(doing("1 / 0"), HANG)["status"] == "CRASHED"
    found = isolated(partial(signal.raise_signal, signal.SIGKILL), HANG)
    assert found["status"] == "CRASHED" and "-9" in found["reason"]
    hung = isolated(partial(time.sleep, HANG), 0.05)
    assert hung["status"] == "TIMED_OUT" and hung["reason"].startswith("stopped after 0.5 s by the clock")
    refused("free space", isolated, doing("raise OSError(28, 'No space left on device')"), HANG)
    refused("make setup", isolated, doing("import no_such_module"), HANG)


BESIDE_TORCH = """
from gelforge.sweeps.isolate import isolated

def solved():
    from gelforge.sweeps.methods import warm_up
    warm_up.__wrapped__()
    return {"status": "OK"}

if __name__ == "__main__":
    import torch
    torch.set_num_threads(2)
    (torch.rand(2000, 2000) @ torch.rand(2000, 2000)).exp()
    print(isolated(solved, 600))  # tests.support.waiting.HANG
"""


@pytest.mark.slow
def test_a_solve_does_not_hang_where_torch_has_run(tmp_path):
    """A process that is forked beside torch's threads waits for ever at its first factorisation with two threads."""
    (tmp_path / "beside.py").write_text(BESIDE_TORCH)
    environment = os.environ | {"OMP_NUM_THREADS": "2", "MKL_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "beside.py"], cwd=tmp_path, env=environment, check=True, capture_output=True, text=True
    )
    assert done.stdout == "{'status': 'OK'}\n"


WAITING = """
import os
import time
from pathlib import Path
from gelforge.sweeps.isolate import isolated

def wait():
    Path("started").write_text(str(os.getpid()))
    os.rename("started", "pid")
    time.sleep(3600)

if __name__ == "__main__":
    isolated(wait, 3600)
"""


def test_a_solve_dies_with_the_process_that_asked_for_it(tmp_path):
    (tmp_path / "waiting.py").write_text(WAITING)
    asking = subprocess.Popen([sys.executable, "waiting.py"], cwd=tmp_path)
    pid = tmp_path / "pid"
    wait_until(pid.exists, of=asking)
    asking.kill()
    asking.wait()
    wait_until(lambda: not Path(f"/proc/{pid.read_text()}").exists())


def _record(case, status="OK", fz=-5.0):
    return {"case": case.describe(), "status": status, "total": [0, 0, fz], "reason": "" if status == "OK" else "why"}


def test_verdicts_against_the_finest_of_the_row():
    base = cases.Case("hex", "round", 1.0, 0.0, "centre", 0.475, 1.0, 8)
    sizes = [cases.Case(**(base.describe() | {"size": size})) for size in (1.4, 1.0, 0.5)]
    records = [_record(sizes[0], fz=-6.0), _record(sizes[1], fz=-5.1), _record(sizes[2])]
    judged = stability.judge_row("size", records, stage_of("stability"))
    assert [line["verdict"] for line in judged] == ["drifts", "good", "good"]
    assert judged[0]["error"] == pytest.approx(0.2)
    records[0] = _record(sizes[0], "DIVERGED", 0.0)
    judged = stability.judge_row("size", records, stage_of("stability"))
    assert judged[0]["verdict"] == "failed" and judged[0]["reason"] == "why"
    assert "DIVERGED" in "\n".join(stability.reading(judged))


def test_a_place_at_label_setting_stands_beside_the_finest_hexahedra():
    press = {"kind": "flat", "depth": 3.5, "shear": 0.0, "place": "rim", "nu": 0.475}
    solvers = ("hex", "ccx", cases.FINEST)
    records = [
        _record(cases.Case(solver, **press), fz=fz) for solver, fz in zip(solvers, (-5.1, -6, -5), strict=True)
    ]
    judged = stability.judge_row("depth", records, stage_of("stability"))
    assert [(line["level"], line["against"], line["verdict"]) for line in judged] == [
        (3.5, "fine", "good"), (3.5, "fine", "drifts"), (3.5, None, "good")]  # fmt: skip
    assert judged[0]["error"] == pytest.approx(0.02)


def test_bodies_and_laws_of_the_map_are_those_of_its_rows():
    table = parameters().stability
    tilt, ridge, friction = (cases.row_cases(table, row) for row in ("tilt", "ridge", "friction"))
    assert {case.scene.interface.law for case in friction} == {"frictionless", "coulomb"}
    # a ridge is as wide as its level says; the steeper the tilt, the farther is the gel from the block's middle
    assert min(case.scene.indenter.radius() for case in ridge) == pytest.approx(np.hypot(3.0, 0.1), rel=0.02)
    gaps = [case.scene.indenter.distance(np.zeros((1, 3)))[0][0] for case in tilt if case.solver == "hex"]
    assert gaps == sorted(gaps) and gaps[0] < 0.2 < gaps[-1]


def test_the_map_covers_what_was_asked():
    table = parameters().stability
    rows = {row: cases.row_cases(table, row) for row in cases.ROWS}
    every = [case for row in rows.values() for case in row]
    assert {case.kind for case in every} == {"round", "flat", "sharp", "several", "tilted", "ridge"}
    depths, shears, nus = ([getattr(c, f) for c in every] for f in ("depth", "shear", "nu"))
    steps = [c.steps for c in rows["steps"]]
    assert (min(depths), max(depths)) == (0.02, 3.5) and (min(shears), max(shears)) == (0.0, 0.5)
    assert (min(nus), max(nus)) == (0.45, 0.499) and (min(steps), max(steps)) == (1, 40)
    assert rows["random"] == cases.row_cases(table, "random")
    rim = next(c for c in every if c.place == "rim" and c.kind == "flat")
    assert min(case.shape for case in rows["ridge"]) < 0.5
    assert rim.scene.press.x0 + rim.scene.indenter.radius() > rim.scene.gel.width / 2


def test_records_of_what_may_be_mended_are_made_again(tmp_path):
    path = tmp_path / "record.json"
    for record, limit, stays in (
        ({"status": "OK"}, 9.0, True),
        ({"status": "DIVERGED"}, 9.0, True),
        ({"status": "REFUSED"}, 9.0, False),  # a mesh that was missing, a disk that was full
        ({"status": "CRASHED"}, 9.0, False),
        ({"status": "TIMED_OUT", "limit_s": 9.0}, 9.0, True),
        ({"status": "TIMED_OUT", "limit_s": 9.0}, 10.0, False),
        ({"status": "TIMED_OUT"}, 9.0, False),
    ):
        write_json(path, {"key": "k"} | record)
        assert (kept(path, "k", limit) is not None) == stays, record
        assert kept(path, "another", limit) is None
