"""Method "auto": the first method whose stated error is within the tolerance."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solve import Solvers
from gelforge.records.press import Press
from gelforge.records.status import Status
from tests.support.parameters import parameters

BODIES = {
    "round": build("ball", {"kind": "sphere", "diameter": 15, "height": 10}),
    "sharp": build("block", {"kind": "cuboid", "size": [5, 5], "fillet": 0.1, "height": 10}),
}


def scene(shape: str, depth: float, x: float = 0.0) -> Scene:
    return Scene(Gel(), Material(), BODIES[shape], Press(x, 0, 0, 0, 0, -depth))


@pytest.fixture
def solvers(tmp_path) -> Solvers:
    return Solvers(tmp_path, parameters().fea)


@pytest.mark.parametrize("shape", ["round", pytest.param("sharp", marks=pytest.mark.slow)])
def test_a_press_is_solved_by_the_first_method_that_states_no_more_than_the_tolerance(solvers, shape):
    draft, label = (solvers.solve(scene(shape, 0.4), method) for method in ("draft", "label"))
    assert 0.0 < label.error_share < draft.error_share < 0.05
    for tolerance, right in ((1.01 * draft.error_share, draft), (1.01 * label.error_share, label)):
        solvers.settings = replace(solvers.settings, tolerance=tolerance)
        found = solvers.solve(scene(shape, 0.4), "auto")
        assert found.evidence["method"] == right.evidence["method"]
        # the same solve, but for the order in which several threads add
        assert np.linalg.norm(found.forces - right.forces) < 1e-6 * np.linalg.norm(right.forces)


def test_what_touches_nothing_is_within_any_tolerance(solvers):
    solvers.settings = replace(solvers.settings, tolerance=1e-9)
    found = solvers.solve(replace(scene("round", 0.5), press=Press(0, 0, 3.0, 0, 0, -0.5)), "auto")
    assert (found.status, found.evidence["method"]) == (Status.NO_CONTACT, "draft")
    assert found.error_n == found.error_share == 0.0


def test_a_result_without_a_force_or_a_statement_is_within_no_tolerance(solvers):
    found = solvers.solve(scene("round", 0.2), "draft")
    assert replace(found, evidence={}).error_share == replace(found, status=Status.DIVERGED).error_share == np.inf
