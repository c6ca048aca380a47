"""Slopes by a sensor's own table, and the height that follows from slopes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.networks.balls.ballpresses import BallPress
from gelforge.networks.balls.imprint import Circle
from gelforge.networks.balls.slopefit import LEAST_PRESSES, fit_slope_table, known_slopes
from gelforge.networks.inference.sensorprofile import Gain, make_profile, read_profile, write_profile
from gelforge.networks.preprocess.slopetable import SlopeTable, height_of, light_change
from tests.benchmarks.balls import slope_gain

HEIGHT, WIDTH, PX_PER_MM = 120, 160, 8.0
BALL_PX = 3.0 * PX_PER_MM
# How a slope along u and v changes red, green and blue, as a fraction of their light.
LIGHTS = np.array([[0.6, -0.1], [-0.3, 0.5], [-0.35, -0.45]])


def nocontact() -> np.ndarray:
    """An image whose light falls off to the right, with a grid of markers."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    light = np.stack([150 - 0.3 * u, 110 + 0.1 * v, 130 - 0.2 * u + 0.1 * v], 2)
    light[(np.hypot(u % 20 - 10, v % 20 - 10) < 3)] *= 0.3
    return np.rint(light).astype(np.uint8)


def pressed(u: float, v: float, radius: float = 12.0) -> BallPress:
    """A ball at (u, v) px: its slope changes the light as LIGHTS tells, more in the upper half of the image."""
    down, along = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    du, dv = along - u, down - v
    distance = np.hypot(du, dv)
    steep = np.where(distance < radius, 1.0, 0.0) / np.sqrt(np.maximum(BALL_PX**2 - distance**2, 1.0))
    slope = np.stack([du * steep, dv * steep], 2)
    change = slope @ LIGHTS.T * (1.2 - 0.4 * down / HEIGHT)[..., None]
    image = np.clip(np.rint(nocontact() * (1 + change)), 0, 255).astype(np.uint8)
    return BallPress("", image, Circle(u, v, radius), 0.0, 2 * BALL_PX / PX_PER_MM)


@pytest.fixture(scope="module")
def table() -> SlopeTable:
    places = [(u, v) for u in (25, 60, 100, 135) for v in (25, 60, 95)]
    return fit_slope_table([pressed(*place) for place in places], nocontact(), PX_PER_MM)


@settings(max_examples=15, deadline=None)
@given(u=st.floats(20, 140), v=st.floats(20, 100), radius=st.floats(8, 14))
def test_a_table_gives_slopes_of_presses_that_it_did_not_learn_from(table, u, v, radius):
    press = pressed(u, v, radius)
    _, clear = light_change(press.image, nocontact(), PX_PER_MM)
    _, beyond, _ = known_slopes(press, clear, PX_PER_MM)
    assert slope_gain(table, press, nocontact()) == pytest.approx(1.0, abs=0.08)
    assert np.abs(table.slopes(press.image, nocontact())[:, beyond]).max() < 0.05


def test_without_a_change_of_light_there_is_no_slope(table):
    assert not table.slopes(nocontact(), nocontact()).any()


def test_too_few_presses_give_no_table():
    few = [pressed(40 + 10 * k, 60) for k in range(LEAST_PRESSES - 1)]
    with pytest.raises(BadInput, match=f"{LEAST_PRESSES - 1} presses of the ball are too few"):
        fit_slope_table(few, nocontact(), PX_PER_MM)


def test_a_profile_keeps_the_table_of_slopes(table, tmp_path):
    path, press = tmp_path / "mine.toml", pressed(70, 60)
    metadata = {"name": "net", "sha256": "ab" * 32}
    write_profile(path, make_profile("mine", nocontact(), 16.0, Gain(), metadata, table))
    again = read_profile(path).table
    assert again.px_per_mm == table.px_per_mm
    np.testing.assert_allclose(
        again.slopes(press.image, nocontact()), table.slopes(press.image, nocontact()), atol=1e-4
    )
    whole = path.read_text()
    for broken in (
        whole.replace("coefficients = [", "coefficients = [1.0, "),
        whole.replace("px_per_mm = 8", "px_per_mm = -8"),
    ):
        path.write_text(broken)
        with pytest.raises(BadInput, match="make the profile again with --balls"):
            read_profile(path)


@settings(max_examples=20, deadline=None)
@given(
    u=st.floats(40, 120), v=st.floats(40, 80), width=st.floats(6, 16), depth=st.floats(0.1, 2.0),
    mm_per_px=st.floats(0.05, 0.3),
)  # fmt: skip
def test_the_height_of_slopes_is_the_surface_that_has_them(u, v, width, depth, mm_per_px):
    down, along = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    height = -depth * np.exp(-((along - u) ** 2 + (down - v) ** 2) / (2 * width**2))
    slopes = np.stack([np.gradient(height, axis=1), np.gradient(height, axis=0)]) / mm_per_px
    assert np.abs(height_of(slopes, mm_per_px) - height).max() < 0.03 * depth
