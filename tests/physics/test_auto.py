"""Method "auto": the first method whose stated error is within the tolerance."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.flow.schema import altered
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.mechanics import solve
from gelforge.mechanics.material import Material
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solve import Solvers
from gelforge.records.press import Press
from gelforge.records.status import Status
from tests.support.parameters import parameters

BALL = build("ball", {"kind": "sphere", "diameter": 15, "height": 10})


def scene(depth: float) -> Scene:
    return Scene(Gel(), Material(), BALL, Press(0, 0, 0, 0, 0, -depth))


@pytest.fixture
def solvers(tmp_path) -> Solvers:
    return Solvers(tmp_path, parameters().fea)


def test_what_touches_nothing_is_within_any_tolerance(solvers):
    solvers.settings = replace(solvers.settings, tolerance=1e-9)
    found = solvers.solve(replace(scene(0.5), press=Press(0, 0, 3.0, 0, 0, -0.5)), "auto")
    assert (found.status, found.evidence["method"]) == (Status.NO_CONTACT, "draft")
    assert found.error_n == found.error_share == 0.0


def test_a_result_without_a_force_or_a_statement_is_within_no_tolerance(solvers):
    found = solvers.solve(scene(0.2), "draft")
    assert replace(found, evidence={}).error_share == replace(found, status=Status.DIVERGED).error_share == np.inf


class Stating(Solvers):
    """Solvers whose methods solve nothing: each states an error, as a fraction of a force of 10 N."""

    def __init__(self, folder, settings, states: dict[str, float]):
        super().__init__(folder, settings)
        self.states, self.asked = states, []

    def solve_frames(self, scenes, method):
        if method == "auto":
            return super().solve_frames(scenes, method)
        self.asked.append(method)
        force = np.array([[0.0, 0.0, -10.0]])
        # of a press with frames the last counts: the first states the worst
        shares = [0.9] * (len(scenes) - 1) + [self.states[method]]
        return [Result(Status.OK, force, 0 * force, {"method": method, "error_n": 10.0 * one}) for one in shares]


@pytest.mark.parametrize(
    "states, right, asked",
    [
        ({"draft": 0.03, "label": 0.01, "ccx": 0.02}, "draft", ["draft"]),
        ({"draft": 0.05, "label": 0.04, "ccx": 0.02}, "label", ["draft", "label"]),
        # none is within: the least error of all, whichever method states it; CalculiX is spared where it cannot win
        ({"draft": 0.07, "label": 0.06, "ccx": 0.05}, "ccx", ["draft", "label", "ccx"]),
        ({"draft": 0.07, "label": 0.06, "ccx": 0.08}, "label", ["draft", "label", "ccx"]),
        ({"draft": 0.06, "label": 0.07, "ccx": np.inf}, "draft", ["draft", "label", "ccx"]),
    ],
)
def test_where_no_method_is_within_the_tolerance_the_least_error_is_taken(tmp_path, states, right, asked):
    stating = Stating(tmp_path, replace(parameters().fea, tolerance=0.04), states)
    for scenes in ([scene(0.4)], [scene(depth) for depth in (0.2, 0.4)]):
        stating.asked.clear()
        found = stating.solve_frames(scenes, "auto")
        assert {one.evidence["method"] for one in found} == {right} and len(found) == len(scenes)
        assert stating.asked == asked


def test_calculix_is_left_out_where_hexahedra_state_less_than_it_can(tmp_path):
    stating = Stating(
        tmp_path, replace(parameters().fea, tolerance=0.001), {"draft": 0.03, "label": 0.01, "ccx": 0.0}
    )
    assert stating.solve(scene(0.4), "auto").evidence["method"] == "label" and "ccx" not in stating.asked


def test_no_try_of_a_press_repeats_an_earlier_one(tmp_path, monkeypatch, ccx):
    """Each later one takes more load steps or more contact iterations, also where the depth decides their number."""
    taken = []

    def failing(kind, steps_of):
        class Failing:
            def __init__(self, *words):
                self.settings = words[-1]

            def solve(self, one, finer=1, **_):
                return self.solve_frames([one], finer)[0]

            def solve_frames(self, scenes, finer=1):
                taken.append((kind, *steps_of(self.settings, scenes[-1], finer)))
                none = np.zeros((1, 3))
                return [replace(Result(Status.DIVERGED, none, none, {}), mesh=None) for _ in scenes]

        return Failing

    def of_tetrahedra(settings, one, finer):
        path = settings.path(one, 0.0, finer)
        return path.press_steps, path.shear_steps, path.settle_rounds

    settings = altered(parameters().fea, press_steps=2, step_mm=0.1)
    deep = scene(1.5)
    solvers = Solvers(tmp_path, settings)
    solvers.guide = type("NoGuide", (), {"coarse_path": staticmethod(lambda scenes: [None] * len(scenes))})()
    mesh = type("Mesh", (), {"name": "mesh", "mesh": staticmethod(lambda: None)})
    monkeypatch.setattr(solve, "mesh_of", lambda *_: mesh)
    monkeypatch.setattr(solve, "CcxSolver", failing("ccx", of_tetrahedra))
    hexahedra = failing("hex", lambda settings, *_: (settings.press_steps, settings.shear_steps, settings.size))
    hexahedra.solve_frames = lambda self, scenes, whole=hexahedra.solve_frames: [
        type("Failed", (Result,), {"mesh_name": None})(one.status, one.forces, one.displacement, {})
        for one in whole(self, scenes)
    ]
    monkeypatch.setattr(solve, "HexSolver", hexahedra)
    for method in ("ccx", "label"):
        taken.clear()
        found = solvers.solve(deep, method)
        assert found.status is Status.DIVERGED and len(found.evidence["failed_attempts"]) == len(taken) > 1
        same = [entry for entry in taken if entry[0] == taken[0][0]]
        assert len(set(same)) == len(same) > 1, same
        for before, after in zip(same, same[1:]):
            assert all(b >= a for a, b in zip(before[1:], after[1:])) and before != after, same
        assert same[1][1] >= 3 * same[0][1], "the first fallback takes smaller load steps"
