"""What labels say of sensors: a projection by which presses lie outside of the images."""

from pathlib import Path

import numpy as np

from gelforge.evidence.labels import refuse_unseen
from tests.support.refused import refused


def test_a_sensor_that_does_not_look_where_it_is_pressed_is_refused():
    """Most of its presses must lie outside, and it must have enough of them."""
    sensors = ["a"] * 12 + ["b"] * 12
    total = np.full(24, -5.0)
    beyond = np.where(np.arange(24) < 12, 0.2, 0.0) * total
    refuse_unseen(sensors, total - beyond, beyond, Path("sensors.json"))
    beyond[12:20] = 0.8 * total[12:20]
    refused("sensor b, 8 of its 12 samples", refuse_unseen, sensors, total - beyond, beyond, Path("sensors.json"))
    few = slice(12, 21)
    refuse_unseen(sensors[few], (total - beyond)[few], beyond[few], Path("sensors.json"))
    beyond[12:20] = 0.8 * total[12:20] * (np.arange(8) < 6)
    refuse_unseen(sensors, total - beyond, beyond, Path("sensors.json"))
