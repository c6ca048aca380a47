"""A press to a force: the depth is found, and the press of that depth has the force."""

import numpy as np
import pytest

import gelforge
from gelforge.errors import BadInput, GelforgeError
from gelforge.mechanics.toforce import CLOSE, DepthCurve


@pytest.mark.parametrize(
    ("name", "force", "more"),
    [
        ("sphere_10", 3.0, {"shear": (0.1, 0.2), "at": (2.0, -1.0), "c10": 0.09}),
        pytest.param("cuboid_7", 3.0, {"tilt": (1.0, 0.0)}, marks=pytest.mark.slow),
    ],
)
def test_a_press_to_a_force_has_this_force_at_the_depth_that_it_states(name, force, more):
    found = gelforge.solve(name, force=force, **more)
    assert -found.total[2] == pytest.approx(force, rel=CLOSE)
    again = gelforge.solve(name, depth=found.depth, **more)
    assert np.array_equal(again.forces, found.forces)


def test_a_force_that_the_gel_does_not_bear_is_refused_with_a_reason():
    with pytest.raises(GelforgeError, match="does not bear|was not solved"):
        gelforge.solve("sphere_10", force=4000.0)


@pytest.mark.parametrize("given", [{}, {"depth": 0.3, "force": 2.0}, {"force": 0.0}, {"force": float("nan")}])
def test_depth_or_force_is_given_not_both(given):
    with pytest.raises(BadInput, match="give one of both"):
        gelforge.solve("sphere_10", **given)


def test_a_curve_is_inverted_within_its_points_and_follows_its_power_beyond():
    below = np.linspace(0.0, 0.8, 9)
    curve = DepthCurve(0.1 + below, 6.0 * below**1.5)
    for depth in (0.2, 0.55, 0.9, 1.2):
        assert curve.depth_of(6.0 * (depth - 0.1) ** 1.5) == pytest.approx(depth, rel=0.01)
