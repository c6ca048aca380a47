"""An estimate adds up, and its pilots stand for all presses."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gelforge.flow.forecast import Cost, pilots, presses_an_hour, size, table, wall_seconds

COSTS = [
    Cost("10_poses", 0.1, bytes_each=10.0),
    Cost("20_meshes", cpu_once=50.0, bytes_once=1e6),
    Cost("30_fea", 7.0),
]


@given(st.lists(st.floats(0, 2), min_size=1, max_size=200))
def test_pilots_are_different_presses_of_every_strength(depths):
    chosen = pilots(depths)
    assert len(set(chosen)) == len(chosen) == min(5, len(depths))
    assert [depths[k] for k in chosen] == sorted(depths[k] for k in chosen)


def test_the_mean_of_the_pilots_is_that_of_all_where_cost_rises_with_depth():
    depths = np.random.default_rng(1).uniform(0.2, 1.5, 500).tolist()
    cost = [3 + 4 * depth for depth in depths]
    assert abs(np.mean([cost[k] for k in pilots(depths)]) / np.mean(cost) - 1) < 0.05


@given(st.integers(1, 20000), st.integers(1, 64))
def test_more_cores_never_take_longer_and_never_less_than_their_share(presses, cores):
    one, many = (wall_seconds(COSTS, presses, n, 1000) for n in (1, cores))
    total = sum(cost.cpu(presses) for cost in COSTS)
    assert many <= one * (1 + 1e-12) and many >= total / cores * (1 - 1e-12) and one == total


def test_the_table_sums_its_stages():
    text = table(COSTS, 100)
    assert text[-1].split() == ["all", f"{(50 + 710) / 3600:.3f}", "1", "MB"]
    assert [size(n) for n in (0, 999, 2.5e9)] == ["0 B", "999 B", "2.5 GB"]


def test_presses_an_hour_fall_with_what_each_takes_and_rise_with_the_cores():
    """What is spent once, or after the label, has no part in it."""
    costs = [Cost("30_fea", 3.0, 100.0), Cost("50_labels", 1.0), Cost("70_train", 50.0)]
    assert presses_an_hour(costs, 2) == 2 * 900.0
    assert presses_an_hour([*costs, Cost("10_poses", 4.0)], 2) == 900.0
    assert presses_an_hour([], 1) == float("inf")
