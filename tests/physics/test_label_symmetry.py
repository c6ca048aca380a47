"""The label of a mirrored press is the mirrored label: solver, binning and axes share one frame."""

import math

import numpy as np
import pytest

import gelforge

BALL = {"kind": "sphere", "diameter": 10, "height": 8}
AT, SHEAR = (1.7, -2.3), (0.25, 0.15)
# Factors of x and y. Rows of an image run against gel x, columns against gel y.
CASES = {"mirrored in x": (-1, 1), "mirrored in y": (1, -1)}  # turned by 180 degrees: both
SMOOTH = 1e-6  # of the largest cell: smooth scenes do not depend on rounding beyond it


@pytest.fixture(scope="module")
def original():
    return gelforge.label(gelforge.solve(BALL, 0.6, AT, SHEAR, friction=math.inf))


@pytest.mark.parametrize("case", CASES)
def test_a_press_and_its_image_have_the_same_label(original, case):
    x, y = CASES[case]
    press = gelforge.solve(BALL, 0.6, (x * AT[0], y * AT[1]), (x * SHEAR[0], y * SHEAR[1]), friction=math.inf)
    found = (gelforge.label(press) * np.array([x, y, 1])[:, None, None])[:, ::x, ::y]
    largest = np.abs(original).max(axis=(1, 2))
    assert (np.abs(found - original).max(axis=(1, 2)) <= SMOOTH * largest).all()
    assert (np.abs(found[:, ::x, ::y] - original).max(axis=(1, 2)) > 0.3 * largest).all()  # it is not its own image
