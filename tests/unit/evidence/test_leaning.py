"""The tilt of a mounting in its images: found from drawn slopes under any light, and said where labels assume another."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.evidence.imprints import COLS, ROWS, Window
from gelforge.evidence.leaning import Leaning, Shaded, leaning, leant, sentence
from gelforge.geometry.indenters import build
from gelforge.geometry.solids import feels_tilt
from gelforge.labelling.sensor import load_sensors
from gelforge.records.press import Press

BLOCK = build("block", {"kind": "cuboid", "size": [8.0, 8.0], "fillet": 0.5, "height": 8.0}, "test")
BALL = build("ball", {"kind": "sphere", "diameter": 15.0, "height": 8.0}, "test")
PLACES = ((0.0, 0.0, 0.0), (1.5, -2.0, 30.0), (-1.0, 2.5, 70.0), (1.0, 1.0, 45.0))


@pytest.fixture(scope="module")
def sensor(root):
    return load_sensors(root / "workflow/sensors.toml")["mini_a"]


def drawn(window, body, press, tilt, light, rng) -> Shaded:
    """What a camera shows of a press that leans: slopes under a light that changes across the image, and noise."""
    along, down, contact = window.slopes(body, leant(press, *tilt))
    v, u = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLS), indexing="ij")
    change = sum(
        slope[..., None] * (a[0] + a[1] * u[..., None] + a[2] * v[..., None])
        for slope, a in zip((along, down), light, strict=True)
    )
    change = change - 0.02 * contact[..., None] + 0.004 * rng.standard_normal((ROWS, COLS, 3))
    return Shaded(change, window, body, press)


def session(sensor, tilt, seed=0):
    rng, window = np.random.default_rng(seed), Window(sensor)
    light = rng.normal(0.0, [[[0.4], [0.1], [0.1]]] * 2, (2, 3, 3))
    poses = [Press(x, y, 0.0, 0.0, 0.0, -0.5, turn) for x, y, turn in PLACES]
    flat = [drawn(window, BLOCK, press, tilt, light, rng) for press in poses]
    return flat, [drawn(window, BALL, replace(press, dz=-0.9), tilt, light, rng) for press in poses]


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (2.0, 0.0), (-0.5, -2.5), (1.5, 1.5)])
def test_a_tilt_is_found_under_any_light(sensor, tilt):
    found = leaning(*session(sensor, tilt))
    assert np.abs(found.tilt - tilt).max() < 0.4
    assert found.error.min() >= 0.5 and found.differs((0.0, 0.0)) == (np.hypot(*tilt) > 1.0)
    assert not found.differs(tilt)


def test_balls_are_not_needed(sensor):
    found = leaning(session(sensor, (0.0, 2.5))[0], [])
    assert np.abs(found.tilt - [0.0, 2.5]).max() < 0.6


def test_the_sentence_names_the_side_that_touches_first(sensor):
    """About y the side at +x sinks; about x that at -y."""
    ends = sensor.project(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]]))
    for tilt, way in (((0.0, 2.0), ends[1] - ends[0]), ((2.0, 0.0), ends[2] - ends[0])):
        across, down = way
        side = ("right" if across > 0 else "left") if abs(across) > abs(down) else ("lower" if down > 0 else "upper")
        said = sentence(Leaning(np.array(tilt), np.array([0.4, 0.5])), (0.0, 0.0), sensor)
        assert f"with their {side} side first" in said and "labels assume 0.0 and 0.0" in said
        assert f"about x {tilt[0]:.1f} +- 0.4" in said and f"about y {tilt[1]:.1f} +- 0.5" in said


def test_a_flat_body_feels_tilt_and_a_ball_does_not():
    assert feels_tilt(BLOCK) and not feels_tilt(BALL)
