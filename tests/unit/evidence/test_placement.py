"""Where contacts lie together, as one turn, scale and shift of where they were expected."""

import numpy as np
import pytest

from gelforge.evidence.placement import _similarity


@pytest.mark.parametrize(
    "turn, scale, shift", [(0.0, 1.0, (0.0, 0.0)), (7.0, 1.0, (0.4, -0.2)), (-25.0, 1.3, (2.0, 3.0))]
)
def test_a_common_move_of_contacts_is_found_and_leaves_nothing_but_what_moved_otherwise(turn, scale, shift):
    at = np.random.default_rng(1).uniform(-8.0, 8.0, (12, 2))
    way = np.deg2rad(turn)
    seen = scale * at @ np.array([[np.cos(way), -np.sin(way)], [np.sin(way), np.cos(way)]]).T + shift
    found_turn, found_scale, offset, left = _similarity(at, seen - at)
    assert (found_turn, found_scale) == pytest.approx((turn, scale), abs=1e-9)
    assert offset == pytest.approx(shift, abs=1e-9) and left.max() < 1e-9
    seen[3] += (1.0, 0.0)
    left = _similarity(at, seen - at)[3]
    assert left.argmax() == 3 and 0.5 < left[3] < 1.0
