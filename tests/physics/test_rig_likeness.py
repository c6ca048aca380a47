"""The rig's pictures against real ones, and lights where the real ones stand."""

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.virtualrig.fields import STEP, unloaded
from tests.benchmarks.rig import Rig, likeness
from tests.conftest import ROOT


def test_reference_unit_looks_like_the_real_one(reference):
    rig = Rig.of(ROOT / "workflow/rig/demo.toml", ROOT / "workflow")
    for figure in likeness(rig, reference):
        assert figure.met, f"{figure.name}: {figure.value} {figure.compare} {figure.goal}"


def test_a_dent_is_lit_from_the_three_sides():
    rig = Rig.of(ROOT / "workflow/rig/demo.toml", ROOT / "workflow")
    eye = rig.camera("mini_a")
    field = unloaded(Gel())
    y, x = np.mgrid[: field.values.shape[0], : field.values.shape[1]]
    r2 = (field.x0 + STEP * x) ** 2 + (field.y0 + STEP * y) ** 2
    field.values[..., 2] = -np.exp(-r2 / (2 * 1.5**2))
    change = eye.image(field).astype(float) - eye.image().astype(float)
    above, below, right, left = (
        np.median(change[rows, cols], axis=(0, 1))
        for rows, cols in (
            (np.s_[92:102], np.s_[145:175]),
            (np.s_[138:148], np.s_[145:175]),
            (np.s_[105:135], np.s_[178:188]),
            (np.s_[105:135], np.s_[132:142]),
        )
    )
    # the gel bulges towards the camera: each light brightens the flank that faces it
    assert above[0] > 5 > -5 > below[0]
    assert right[1] > 5 > -5 > left[1]
    assert below[2] > 5 > -5 > above[2]
