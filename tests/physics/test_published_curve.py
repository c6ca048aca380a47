"""A force curve that others measured, on a gel of another thickness, by the parameters that the guide states for it."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.calibration.readings import Readings
from gelforge.calibration.solves import SolveCache, build_emulator, make_plan, refine, solve_all
from gelforge.geometry.indenters import build
from gelforge.mechanics.hexsettings import quality
from gelforge.records.press import POSE, TILT
from gelforge.stages.calibrate import solver_settings
from tests.support.calibration_law import one_mounting, true_values
from tests.support.parameters import parameters

# A ball of 4 mm pressed into the flat gel of a DIGIT, 2 mm thick: commanded depth (mm) and normal force (N).
DEPTH = np.array([0.344, 0.468, 0.782, 1.215, 1.461])
FORCE = np.array([0.236, 0.500, 1.495, 3.895, 6.290])
C10, OFFSET, COMPLIANCE = 0.077, -0.077, 0.015
SIZE, PRESS_STEPS = 0.4, 16  # of [calibrate.solver]: the usual hexahedra are as wide as the whole contact


@pytest.mark.slow
def test_a_ball_on_a_thin_pad_is_as_stiff_as_measured(root, tmp_path, monkeypatch):
    """Without slip; touch was set too low by as much as the offset, and the bench gave way under the force."""
    monkeypatch.setenv("GELFORGE_GELS", str(root / "workflow" / "gels.toml"))
    pose = np.zeros((len(DEPTH), len(POSE) + len(TILT)))
    pose[:, 5] = -DEPTH
    names, gels = np.array(["ball"] * len(DEPTH)), np.array(["flat_2mm"] * len(DEPTH))
    force = np.column_stack([np.full((len(DEPTH), 2), np.nan), -FORCE])
    readings = Readings(
        "published", np.arange(len(DEPTH)), names, names, pose, force, gels, *one_mounting(len(DEPTH))
    )
    ball = {"ball": build("ball", {"kind": "sphere", "diameter": 4.0, "height": 2.0})}
    table = parameters()
    coarse = replace(solver_settings(table.calibrate.solver), size=SIZE, press_steps=PRESS_STEPS)
    cache, plan = (
        SolveCache(tmp_path, ball, coarse, 1),
        make_plan(readings, 0.0, "no_slip", [1.0], table.material.nu),
    )
    assert not solve_all(plan, cache)
    emulator = refine(build_emulator(plan, cache), plan, cache, SolveCache(tmp_path, ball, quality("draft"), 1))
    values = true_values(c10=C10, offset=OFFSET, compliance=COMPLIANCE, mu=np.inf)
    np.testing.assert_allclose(-emulator.forces(DEPTH, values)[0][0, :, 2], FORCE, rtol=0.05)
