"""CalculiX' own contact: a press in equilibrium, near the contact solved in process where its penalty is hard."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.flow.schema import altered
from gelforge.geometry.gel import GELS
from gelforge.geometry.indenters import build
from gelforge.mechanics.ccx.deck import contact_deck
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solve import Solvers
from gelforge.mechanics.solvers import ccxcontact
from gelforge.mechanics.solvers.ccx import CcxSettings, CcxSolver
from gelforge.records.press import Press
from gelforge.records.status import Status
from tests.support.blocks import symmetric_block
from tests.support.flat_pad import FlatPad
from tests.support.parameters import parameters
from tests.support.waiting import HANG

BALL = build("ball", {"kind": "sphere", "diameter": 10, "height": 6})
SCENE = Scene(
    GELS["gelsight_mini"], Material(), BALL, Press(0.0, 0.0, 0.2, 0.0, 0.0, -0.8), Interface("frictionless")
)
PAD = FlatPad(name="pad", width=7.0, length=7.0, corner_radius=0.0, height=4.0)
COARSE = altered(parameters().fea, contact_mm=1.0)


def test_the_deck_has_feats_penalty_and_starts_where_the_indenter_touches():
    mesh = symmetric_block(GELS["gelsight_mini"], 4.0, 1)
    nodes, tets = np.vstack([np.zeros(3), np.eye(3)]), np.arange(4)[None]
    deck = contact_deck(mesh, (nodes, tets), [np.array([0.0, 0.0, -0.5])], 0.475, 50.0, None, 0.1)
    assert f"PRESSURE-OVERCLOSURE=LINEAR\n{50 * REFERENCE_C10:.9g}\n" in deck and "*FRICTION" not in deck
    assert "NINDENTER,3,3,-5.0" in deck and deck.count("*STEP") == 1 and deck.count("SINDENTER") == 2
    stuck = contact_deck(mesh, (nodes, tets), [np.zeros(3), np.ones(3)], 0.475, 1000.0, 0.7, 0.1)
    assert "*FRICTION\n0.7," in stuck and stuck.count("*STEP") == 2


@pytest.mark.slow
def test_a_hard_penalty_gives_the_force_of_the_contact_in_process(tmp_path, ccx):
    """On tetrahedra of 1.75 mm under a ball of 10 mm."""
    label = Solvers(tmp_path, COARSE).solve(SCENE, "label")
    hard = Solvers(tmp_path, altered(COARSE, contact_mm=1.75, contact_stiffness=1000.0)).solve(SCENE, "ccx-contact")
    assert hard.status is Status.OK and hard.evidence["method"] == "ccx-contact"
    assert hard.evidence["base_mismatch"] < ccxcontact.MOST_MISMATCH
    assert hard.total[2] == pytest.approx(label.total[2], rel=0.04)


@pytest.mark.slow
def test_under_feats_penalty_the_gel_gives_less_because_it_sinks_in(tmp_path, ccx):
    """On few tetrahedra, of which the same solver finds the contact in process."""
    mesh, pressed = symmetric_block(PAD, 1.75, 2), replace(SCENE, gel=PAD, press=Press(0.0, 0.0, 0.0, 0.0, 0.0, -0.5))
    exact = CcxSolver(mesh, tmp_path, CcxSettings.of(altered(COARSE, press_steps=3))).solve(pressed)
    soft = ccxcontact.solve_contact(pressed, mesh, tmp_path, ccxcontact.ContactSettings(1.0, 50.0, HANG))
    assert exact.status is soft.status is Status.OK and soft.evidence["base_mismatch"] < ccxcontact.MOST_MISMATCH
    assert 0.8 * -exact.total[2] < -soft.total[2] < 0.95 * -exact.total[2]
    assert soft.evidence["penetration_mm"] > 0.02


def test_a_run_past_its_time_is_stopped_and_says_so(tmp_path, ccx):
    mesh = symmetric_block(SCENE.gel, 2.0, 2)
    small = build("small", {"kind": "sphere", "diameter": 3, "height": 2})  # of few tetrahedra
    limit = ccxcontact.ContactSettings(1.0, 1000.0, 0.2)
    found = ccxcontact.solve_contact(replace(SCENE, indenter=small), mesh, tmp_path, limit)
    assert not found.status.valid and found.evidence["stopped_after_s"] == 0.2
    assert "raise timeout_s" in found.evidence["reason"]


def test_a_press_that_does_not_touch_has_no_force(tmp_path):
    high = Scene(SCENE.gel, SCENE.material, BALL, Press(0.0, 0.0, 2.0, 0.0, 0.0, -0.5), SCENE.interface)
    found = ccxcontact.solve_contact(
        high, symmetric_block(SCENE.gel, 4.0, 1), tmp_path, ccxcontact.ContactSettings(1.0, 50.0, 10.0)
    )
    assert found.status is Status.NO_CONTACT and not found.forces.any()
