"""A tilted press is a rigid rotation about the body's tip: in its pose, its surface, its forces."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.calibration.solves import centre_of
from gelforge.calibration.tilts import NODES, Tilts, response
from gelforge.geometry import touch
from gelforge.geometry.indenters import build
from gelforge.geometry.sampled import Sampled
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.press import Press
from tests.support.flat_pad import FlatPad

CUBOID = build("cuboid", {"kind": "cuboid", "size": [5.0, 5.0], "fillet": 0.5, "height": 8.0}, "test")
BALL = build("ball", {"kind": "sphere", "diameter": 12.0, "height": 8.0}, "test")
PAD = FlatPad("pad", 20.0, 20.0, 4.0)
DRAFT = HexSolver(replace(quality("draft"), size=0.6, across=0))


def force(body, press: Press) -> np.ndarray:
    found = DRAFT.solve(Scene(PAD, Material(0.475), body, press, Interface()))
    assert found.status.valid, found.evidence
    return found.total


def below_touch(body, press: Press, depth: float) -> Press:
    """The press that ends `depth` mm below its first touch."""
    lift = float(-(body.surface()[0] @ press.pose(1.0, 1.0)[0][2]).min())
    return replace(press, z0=lift, dz=-depth)


def test_a_press_without_tilt_has_the_pose_that_it_had():
    press = Press(0.3, -0.2, 0.1, 0.2, 0.1, -0.5, 33.0)
    assert not press.tilted
    c, s = np.cos(np.deg2rad(33.0)), np.sin(np.deg2rad(33.0))
    np.testing.assert_array_equal(press.pose(1.0, 1.0)[0], [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_tilt_turns_first_about_gel_x_and_then_about_gel_y_right_handed():
    rotation, tip = Press(1.0, 2.0, 3.0, 0.0, 0.0, -0.5, 20.0, 2.0, -3.0).pose(0.0, 0.0)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_array_equal(tip, [1.0, 2.0, 3.0])  # the tip stays where it is
    small = 1e-4
    x, y = (Press(0, 0, 0, 0, 0, -1, 0.0, *tilt).pose(0, 0)[0] for tilt in ((small, 0.0), (0.0, small)))
    turn = np.deg2rad(small)
    np.testing.assert_allclose(x @ [0, 1, 0], [0, 1, turn], atol=1e-10)  # about x, y rises
    np.testing.assert_allclose(y @ [1, 0, 0], [1, 0, -turn], atol=1e-10)  # about y, x falls


def test_a_tilted_body_is_the_turned_surface_pressed_upright():
    """Distances to the tilted cuboid are those to a measured surface that was tilted before."""
    tilted = Press(0.0, 0.0, 0.0, 0.0, 0.0, -0.5, 15.0, 2.5, -1.5)
    rotation, _ = tilted.pose(0.0, 0.0)
    vertices, faces = CUBOID.surface()
    turned = Sampled("turned", vertices @ rotation.T, faces, spacing=0.15, reach=1.0)  # moved to stand on z = 0
    upright = Press(0.0, 0.0, float((vertices @ rotation.T)[:, 2].min()), 0.0, 0.0, tilted.dz)
    points, _ = touch.under_path(PAD, CUBOID, tilted, 0.25)
    here = touch.gap(CUBOID, tilted, points, 1.0)
    near = np.abs(here) < 0.4
    assert near.sum() > 50
    there = touch.gap(turned, upright, points, 1.0)
    assert np.abs(here - there)[near].max() < 0.02


def test_a_turned_bench_gives_turned_forces():
    """Turned by 90 degrees about z, tilt about x becomes tilt about y, and the force turns along."""
    one = below_touch(CUBOID, Press(0.0, 0.0, 0.0, 0.0, 0.0, -0.3, 0.0, 2.0, 0.0), 0.3)
    other = replace(one, rot_deg=90.0, tilt_x_deg=0.0, tilt_y_deg=2.0)
    fx, fy, fz = force(CUBOID, one)
    assert abs(fy) > 5 * abs(fx)  # the slope pushes along y
    np.testing.assert_allclose(force(CUBOID, other), [-fy, fx, fz], atol=2e-3 * abs(fz))


def test_a_flat_body_loses_force_by_tilt_and_a_ball_does_not():
    flat, tilted = (below_touch(CUBOID, Press(0, 0, 0, 0, 0, -0.3, 0.0, tilt, 0.0), 0.3) for tilt in (0.0, 2.5))
    assert force(CUBOID, tilted)[2] > 0.85 * force(CUBOID, flat)[2]  # both are negative
    straight, leaning = (
        force(BALL, below_touch(BALL, Press(0, 0, 0, 0, 0, -0.4, 0.0, tilt, 0.0), 0.4)) for tilt in (0.0, 2.5)
    )
    np.testing.assert_allclose(leaning, straight, atol=0.01 * abs(straight[2]))


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (3.0, 0.0), (-1.0, 2.0)])
def test_first_touch_of_a_tilted_flat_body_is_where_its_lowest_edge_meets_the_gel(tilt):
    press = below_touch(CUBOID, Press(0.0, 0.0, 0.0, 0.0, 0.0, -0.4, 0.0, *tilt), 0.4)
    start = touch.first_touch(PAD, CUBOID, press)
    assert start is not None and abs(start * press.dz) < 0.02


def end_of(body, press: Press) -> dict:
    found = DRAFT.solve(Scene(PAD, Material(0.475), body, press, Interface()))
    assert found.status.valid, found.evidence
    return {"end": found.total, "centre": centre_of(found)}


@pytest.mark.parametrize(("body", "flat"), [(CUBOID, True), (BALL, False)], ids=["block", "ball"])
def test_three_solves_tell_force_and_centre_at_another_tilt_and_depth(body, flat):
    """Of a block and of a ball, which rolls aside by its radius times the tilt."""
    press = Press(0.0, 0.0, 0.0, 0.0, 0.0, -0.5, 10.0)
    ends = [end_of(body, replace(press, tilt_x_deg=x, tilt_y_deg=y)) for x, y in NODES]
    force, centre, moved = response(ends)
    tilts = Tilts(np.array([0.5]), np.array([flat]), force[None] * flat, centre[None], moved[None])
    tilt, depth = np.array([[[1.5, -1.0]]]), np.array([[0.8]])
    # a ball rolls, and its lowest point comes down
    sunk = 0.0 if flat else 6.0 * (1.0 - np.cos(np.deg2rad(np.hypot(*tilt[0, 0]))))
    leant = end_of(body, replace(press, dz=-0.8, tilt_x_deg=1.5, tilt_y_deg=-1.0))
    upright = end_of(body, replace(press, dz=-0.8 - sunk))
    # the linear part of the force and the third power of tilt are left out
    assert leant["end"][2] / upright["end"][2] == pytest.approx(tilts.factor(tilt, depth)[0, 0], abs=0.01)
    assert leant["centre"] == pytest.approx(tilts.centres(tilt, depth)[0, 0], abs=0.04)
    if not flat:
        assert moved == pytest.approx(6.0 * np.deg2rad([[0.0, 1.0], [-1.0, 0.0]]), abs=0.02)
