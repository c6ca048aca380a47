"""In-plane motion of the surface as a property of a unit."""

from dataclasses import replace

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.reading.markers import markers_in
from gelforge.records.press import Press
from gelforge.virtualrig.appearance import read_appearances
from gelforge.virtualrig.bench import SETTINGS
from gelforge.virtualrig.fields import Surface, body_of, field_of, surface_of
from gelforge.virtualrig.render import Pressed, Renderer
from tests.support.sandbox import ROOT


def pressed_ball():
    """A ball pressed down and then sideways: its body, and its surfaces at the end of the way down and at the end."""
    gel, ball = Gel(), build("ball", {"kind": "sphere", "diameter": 8, "height": 8}, "a test")
    end = Press(0.4, 0.3, float(gel.top(0.4, 0.3)), 0.3, 0.2, -1.0, 0.0)
    bottom = replace(end, dx=0.0, dy=0.0)
    results = HexSolver(SETTINGS).solve_frames([Scene(gel, Material(), ball, press) for press in (bottom, end)])
    down = results[0].displacement
    surfaces = (
        surface_of(results[0].solved_mesh, down, bottom),
        surface_of(results[1].solved_mesh, results[1].displacement, end, down),
    )
    return gel, body_of(ball, 0.0, 0.6, 0.0), surfaces


def test_a_units_factor_scales_what_the_way_down_moves_and_nothing_else(tmp_path):
    gel, body, (bottom, end) = pressed_ball()
    end.save(tmp_path / "end.npz")
    end = Surface.load(tmp_path / "end.npz")
    for surface in (bottom, end):
        np.testing.assert_array_equal(surface.down, bottom.moved[..., :2])
    whole, half = field_of(gel, end), field_of(gel, end).scaled(0.5)
    travel = whole.values[..., :2] - whole.down
    np.testing.assert_allclose(half.values[..., :2] - 0.5 * whole.down, travel, atol=1e-6)
    np.testing.assert_array_equal(half.values[..., 2], whole.values[..., 2])

    looks = read_appearances(ROOT / "workflow/rig/sensors.toml")["mini_a"]
    projection = load_sensors(ROOT / "workflow/sensors.toml")["mini_a"].projection
    moved, heights = {}, {}
    for factor in (1.0, 0.5, 0.0):
        # a camera far away shows motion in the plane alone
        eye = Renderer(replace(looks, camera_mm=1e4, normal_motion=factor), projection, gel)
        field, pressed = field_of(gel, bottom), Pressed(body, bottom.press)
        before, after = markers_in(eye.image()).points, markers_in(eye.image(field)).points
        outward = []
        apex = eye.seen(np.array([[0.4, 0.3]]), np.zeros((1, 3)))[0]
        for marker in before:
            there = after[np.linalg.norm(after - marker, axis=1).argmin()]
            if 30 < np.linalg.norm(marker - apex) < 90:
                outward.append((there - marker) @ (marker - apex) / np.linalg.norm(marker - apex))
        moved[factor], heights[factor] = float(np.sum(outward)), eye.height(field, pressed)
    assert moved[1.0] > 5.0  # px, of a dozen markers
    assert abs(moved[0.5] / moved[1.0] - 0.5) < 0.05 and abs(moved[0.0] / moved[1.0]) < 0.05
    np.testing.assert_array_equal(heights[0.5], heights[1.0])
