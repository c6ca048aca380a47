"""Laws of the error tables."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.learning import evaluate as metrics
from gelforge.records.axes import CHANNELS

errors = st.integers(2, 40).flatmap(
    lambda n: st.builds(lambda seed: np.random.default_rng(seed).normal(size=(n, 3)), st.integers(0, 2**32 - 1))
)


@settings(max_examples=30)
@given(errors, st.floats(0.01, 100))
def test_errors_scale_with_the_unit_of_force(error, unit):
    one = metrics.error_table(error, np.random.default_rng(0), 50)
    other = metrics.error_table(unit * error, np.random.default_rng(0), 50)
    for axis in CHANNELS:
        for key, value in one[axis].items():
            # The resampling is the same, so only rounding differs.
            assert other[axis][key] == pytest.approx(unit * value, rel=1e-9, abs=1e-12)


@settings(max_examples=30)
@given(errors)
def test_interval_holds_the_mean_and_lies_within_the_errors(error):
    size = np.abs(error)
    low, high = metrics.bootstrap_mean(size, np.random.default_rng(0), 400)
    # A mean outside a 95 % percentile interval of its own resampling needs a skew that 400 draws do not show.
    assert (low <= size.mean(0) + 1e-12).all() and (size.mean(0) <= high + 1e-12).all()
    assert (size.min(0) <= low + 1e-12).all() and (high <= size.max(0) + 1e-12).all()


@settings(max_examples=30)
@given(errors, st.integers(1, 4))
def test_groups_average_to_the_whole(error, groups):
    names = [f"g{i % groups}" for i in range(len(error))]
    table = metrics.by_group(error, names)
    assert sum(row["n"] for row in table.values()) == len(error)
    for i, axis in enumerate(CHANNELS):
        whole = sum(row["n"] * row[axis]["mae"] for row in table.values()) / len(error)
        assert whole == pytest.approx(np.abs(error[:, i]).mean(), rel=1e-12)


@given(st.lists(st.floats(-80, 0), min_size=1, max_size=30))
def test_every_force_has_a_bin_that_holds_it(forces):
    for edges in ([0.0, 2.0, 5.0, 10.0, 40.0], [2.0, 5.0], [10.0]):
        for force, name in zip(forces, metrics.force_bins(np.array(forces), edges)):
            low, _, high = name.removesuffix(" N").partition("-")
            assert float(low.rstrip("+")) <= abs(force) and (not high or abs(force) < float(high))


def test_bootstrap_interval_covers_at_its_rate():
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(200):
        low, high = metrics.bootstrap_mean(rng.normal(2.0, 1.0, (30, 1)), rng, 100)
        hits += low[0] <= 2.0 <= high[0]
    # 95 % nominal; the percentile bootstrap of 30 values covers about 93 %, and 200 trials scatter by 1.8 %.
    assert 0.87 <= hits / 200 <= 0.99


@settings(max_examples=30)
@given(errors, st.integers(2, 5))
def test_views_of_one_press_that_err_alike_count_no_more_than_one(error, views):
    size = np.abs(error)
    once = metrics.bootstrap_mean(size, np.random.default_rng(0), 100)
    seen = metrics.bootstrap_mean(
        np.repeat(size, views, 0), np.random.default_rng(0), 100, np.repeat(range(len(size)), views)
    )
    np.testing.assert_allclose(seen, once, rtol=1e-9)


def test_linear_control_is_exact_on_linear_data():
    rng = np.random.default_rng(2)
    weights, means = rng.normal(size=(3, 3)), rng.uniform(0, 255, (20, 3))
    totals = means @ weights + [1, 2, 3]
    found = metrics.linear_on_means(means[:10], totals[:10], means[10:])
    np.testing.assert_allclose(found, totals[10:], rtol=1e-8)  # least squares of an exact system


def test_constant_guess_minimises_the_absolute_error():
    totals = np.random.default_rng(3).exponential(size=(101, 3))
    best = np.abs(totals - metrics.constant_guess(totals, 101)).mean(0)
    for shift in (-0.1, 0.1):
        assert (np.abs(totals - metrics.constant_guess(totals, 101) - shift).mean(0) >= best).all()
