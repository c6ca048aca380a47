"""How trainings ended, and where they would end, from their curves."""

import numpy as np
import pytest

from gelforge.records.learningcurve import FURTHER, has_ended, learning_of, power_law

PLATEAU = {"schedule": "plateau", "plateau_patience": 2, "least_rate": 1e-5, "epochs": 100}


def rows(errors, rates) -> list[dict]:
    """A curve of these validation errors and learning rates."""
    return [{"val_total": error, "learning_rate": rate} for error, rate in zip(errors, rates, strict=True)]


@pytest.mark.parametrize(
    "errors, rates, ended",
    [
        ([3, 2, 1, 1, 1, 1], [1e-3] + 5 * [1e-5], True),
        ([3, 2, 1, 1, 1, 1], 3 * [1e-3] + 3 * [1e-5], True),
        ([3, 2, 1, 1, 1, 1], 4 * [1e-3] + 2 * [1e-5], False),  # waited too short at the lowest rate
        ([3, 2, 1, 1, 0.9, 1], [1e-3] + 5 * [1e-5], False),  # still falls
        ([1, 1, 1], 3 * [1e-5], False),  # nothing to hold the last three against
    ],
)
def test_a_plateau_ends_where_the_lowest_rate_no_longer_helps(errors, rates, ended):
    assert has_ended(rows(errors, rates), PLATEAU) == ended


def test_a_cosine_ends_with_its_last_epoch():
    settings = PLATEAU | {"schedule": "cosine", "epochs": 3}
    curve = rows([3, 2, 1], [1e-3] * 3)
    assert has_ended(curve, settings) and not has_ended(curve[:2], settings)


@pytest.mark.parametrize("floor, fall", [(0.0, 0.3), (0.5, 0.5), (1.0, 1.5)])
def test_a_power_law_is_read_further_on(floor, fall):
    hours = np.linspace(0.1, 2.0, 12)
    error = floor + 0.8 * hours**-fall
    assert power_law(hours, error, 20.0) == pytest.approx(floor + 0.8 * 20.0**-fall, rel=1e-3)


def test_hours_scale_nothing():
    rng = np.random.default_rng(3)
    hours = np.linspace(0.1, 2.0, 12)
    error = np.minimum.accumulate((0.3 + 0.8 * hours**-0.6) * rng.uniform(0.95, 1.05, 12))
    expected = power_law(hours, error, FURTHER * 2.0)
    assert power_law(7 * hours, error, 7 * FURTHER * 2.0) == pytest.approx(expected, rel=1e-6)
    assert power_law(hours, 5 * error, FURTHER * 2.0) == pytest.approx(5 * expected, rel=1e-3)
    assert expected < error[-1]


def test_more_of_the_same_never_makes_it_worse():
    rng = np.random.default_rng(4)
    for _ in range(30):
        hours = np.cumsum(rng.uniform(0.1, 1.0, 8))
        error = np.minimum.accumulate(rng.uniform(0.5, 2.0, 8))
        assert 0 <= power_law(hours, error, FURTHER * hours[-1]) <= error[-1]


def test_what_ended_is_not_read_further_and_what_holds_no_times_has_no_course():
    curve = rows([3, 2, 1.5, 1.2, 1.1], [1e-3] * 5)
    about = {"curve": curve, "train": PLATEAU, "cost": {"epoch_seconds": [3600.0 * n for n in range(1, 6)]}}
    going = learning_of(about)
    assert going is not None and not going.ended and 0 < going.expected < 1.1
    assert list(going.hours) == [1, 2, 3, 4, 5]
    done = learning_of(about | {"train": PLATEAU | {"schedule": "cosine", "epochs": 5}})
    assert done is not None and done.ended and done.expected is None
    assert learning_of(about | {"cost": {}}) is None
