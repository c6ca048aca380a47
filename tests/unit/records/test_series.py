"""What a series of readings says of itself, beside a path or pictures: faults are found, good recordings are not accused."""

import numpy as np
import pytest

from gelforge.records import series
from tests.support.refused import refused
from tests.support.simulated_bench import draw_bench, draw_change, draw_gauge, draw_path

DRAWS = 8


def drawn(fault="", shift="", late=0.0):
    """Sessions with their recordings on one clock; every one from its own seed."""
    for seed in range(DRAWS):
        rng = np.random.default_rng([seed, 41])
        bench = draw_bench(rng, 4)
        path, _ = draw_path(rng, bench, shift)
        yield bench, draw_gauge(rng, bench, fault), path, draw_change(rng, bench, late)


def test_readings_that_their_neighbours_contradict_are_left_out():
    """4 of 5520 readings at 84 N made rows 5.9 N wrong."""
    for _, gauge, _, _ in drawn():
        assert not series.wild(gauge.force).any()
    for bench, gauge, _, _ in drawn("wild"):
        off = series.wild(gauge.force)
        error = gauge.force - gauge.true
        assert np.abs(error - np.median(error))[~off].max() < 0.25 * bench.force.max()
        assert off.any()


def test_many_wild_readings_are_refused_and_a_few_are_counted():
    force = np.maximum(np.sin(np.arange(4000) / 150.0), 0.0) * 20 + np.random.default_rng(0).normal(0, 0.02, 4000)
    force[[500, 1700]] = 84.0
    times = np.arange(4000) / 80.0
    kept, notes = series.confirmed("gauge.csv", times, force[:, None])
    assert (~kept).sum() == 2 and "2 of 4000 readings are contradicted" in notes[0]
    assert series.confirmed("gauge.csv", 10.0 * times, force[:, None])[0].all()  # each may be a press
    force[::40] = -83.9
    refused("loose cable", series.confirmed, "gauge.csv", times, force[:, None])


def test_the_end_of_a_sensors_range_is_found_by_what_goes_on_beyond():
    """Clipped at 3, 8 or 10 N, labels were short by up to 27 N."""
    for fault in ("", "clipped"):
        found = []
        for bench, gauge, _, change in drawn(fault):
            depth = np.interp(gauge.times, bench.times, bench.depth)
            seen = np.interp(gauge.times, change.times, change.values)
            found.append([series.at_end(gauge.force, other).any() for other in (depth, seen)])
        assert np.mean(found) >= 0.9 if fault else not np.any(found)


def test_a_gauge_that_records_during_presses_only_has_no_rest():
    """Its flanks were taken for rest: `drifts by 1.3 N; this was subtracted`."""
    assert not any(series.triggered(gauge.times, gauge.force) for _, gauge, _, _ in drawn())
    assert sum(series.triggered(gauge.times, gauge.force) for _, gauge, _, _ in drawn("triggered")) >= DRAWS - 1


@pytest.mark.parametrize("each", [2, 3.3, 10])
def test_a_gauge_whose_driver_repeats_its_readings_rests_and_stands_still_as_any_other(each):
    """At 300 Hz, renewed 30 times a second, it `never rests`: its noise, from neighbours that are equal, was 0."""
    for seed in range(DRAWS):
        times, force = presses(np.random.default_rng(seed))
        again = (np.arange(int(len(times) * each)) // each).astype(int)
        often, held = times[0] + np.arange(len(again)) * (times[1] / each), force[again]
        new = series.renewed(held[:, None])
        assert new.sum() == pytest.approx(len(times), rel=0.35)
        assert not series.triggered(often[new], held[new])
        held[len(held) // 2 :] = held[len(held) // 2]
        new = series.renewed(held[:, None])
        kept, (note,) = series.confirmed("gauge.csv", often[new], held[new, None])
        assert (~kept).sum() > 0.4 * new.sum() and "to its end" in note
    for steps in (0.001, 0.02, 0.1, 0.5):
        assert series.renewed(np.round(force / steps)[:, None] * steps).all()


def test_an_average_shows_in_force_beside_the_path():
    """Means over 0.5 to 1.5 s made peaks 14 to 30 % low."""
    named = {}
    for fault in ("", "averaged"):
        named[fault] = 0
        for bench, gauge, path, _ in drawn(fault):
            spans = [(float(a), float(b)) for a, b in bench.presses]
            found = series.averaging((gauge.times, gauge.force), (path.true, np.maximum(path.values, -0.1)), spans)
            named[fault] += found.width >= series.LEAST_WIDTH_S and found.gain > series.LEAST_GAIN
    assert named[""] == 0 and named["averaged"] >= 0.8 * DRAWS


def test_forces_of_another_clock_are_found_beside_the_pictures():
    """Stamps 0.2 to 0.5 s off made up to 122 of 177 rows wrong by 1 to 35 N."""
    for late in (0.0, 0.15, -0.4):
        for bench, gauge, _, change in drawn(late=late):
            spans = [(float(a), float(b)) for a, b in bench.presses]
            lag = series.lag_of_pictures((gauge.times, gauge.force), (change.times, change.values), spans)
            assert lag.of_clocks == (late != 0.0)
            assert lag.seconds == pytest.approx(-late, abs=0.045)


def test_a_path_that_shifts_shows_where_force_begins():
    """Lost steps of 0.05 to 0.4 mm: `align` wrote dz -1.60 for -1.20."""
    rng = np.random.default_rng(5)
    good = [rng.normal(-0.05, 0.006, rng.integers(3, 12)) for _ in range(200)]
    assert sum(len(series.shifted_heights(each)[1]) > 0 for each in good) <= 4
    step = np.array([0.0, 0.004, -0.003, 0.16, 0.155])
    change, where = series.shifted_heights(step)
    assert change == pytest.approx(0.157, abs=0.01) and where.tolist() == [3, 4]
    change, where = series.shifted_heights(np.linspace(0.0, 0.3, 7))
    assert change == pytest.approx(0.3, abs=0.01) and len(where) == 3


def test_where_samples_were_dropped_nothing_is_said_of_the_height():
    times = np.arange(0.0, 4.0, 0.02)
    height = 1.0 - 0.5 * times
    force = np.maximum(-height, 0.0) * 5.0
    heights = [
        series.onsets((times[kept], force[kept]), (times, height), [(2.0, 3.9)], 0.3)[0]
        for kept in (times > -1.0, (times < 1.95) | (times > 2.4))
    ]
    assert heights[0] == pytest.approx(-0.06, abs=0.002) and np.isnan(heights[1])


def test_pictures_that_repeat_while_the_tip_moves_are_found():
    rng = np.random.default_rng(6)
    depth = np.concatenate([np.linspace(0, 1, 40), np.full(20, 1.0), np.linspace(1, 0, 30)])
    pictures = (100 + 20 * depth[:, None, None] + rng.normal(0, 0.3, (90, 6, 8))).astype(np.float32)
    places = np.column_stack([0 * depth, 0 * depth, -depth])
    assert not series.repeats(pictures, places, depth > 0).any()
    pictures[10:15] = pictures[9]  # stands still while the tip moves
    pictures[45:50] = pictures[44]  # while it is held: the same state
    assert np.flatnonzero(series.repeats(pictures, places, depth > 0)).tolist() == [10, 11, 12, 13, 14]


def test_equal_largest_readings_of_a_scale_are_named():
    """Five of twelve readings at the end of a scale's range: a factor of 0.86 for 0.98."""
    rng = np.random.default_rng(7)
    accused = 0
    for _ in range(100):
        true = rng.uniform(1.0, 12.0, 12)
        predicted = true * np.exp(rng.normal(0.1, 0.1, 12))
        accused += series.equal_largest(np.round(true, 1), predicted) is not None
    assert accused == 0
    said = series.equal_largest(np.minimum(true, np.quantile(true, 0.5)), true * 1.1)
    assert "the largest" in said and "end of its range" in said


def presses(rng, noise=0.02):
    """Times (n,) s at 60 Hz and a gauge's force (n,) N in four presses, with noise."""
    times = np.arange(0.0, 40.0, 1.0 / 60.0)
    depth = np.maximum(np.sin(2.0 * np.pi * times / 10.0), 0.0)
    return times, 4.0 * depth**1.6 + noise * rng.standard_normal(len(times))


def test_a_sensor_that_stands_still_is_left_out_there_and_one_of_coarse_resolution_is_not_accused():
    """Whatever it stands at, 0 too: a driver repeats its last value, and rows had the force of another moment."""
    times, force = presses(np.random.default_rng(0))
    for still in (slice(130, 180), slice(1500, 2400)):
        for value in (force[still.start], 0.0):
            held = force.copy()
            held[still] = value
            kept, (note,) = series.confirmed("gauge.csv", times, held[:, None])
            lost = np.flatnonzero(~kept)
            assert (
                still.start <= lost[0] <= still.start + 1
                and lost[-1] == still.stop - 1
                and "repeats one reading" in note
            )
    for resolution in (0.0, 0.05, 0.2):
        coarse = np.round(force / resolution) * resolution if resolution else force
        assert series.confirmed("gauge.csv", times, coarse[:, None])[0].all()
    refused(
        "all 2400 readings are 0 N, to the last digit", series.confirmed, "gauge.csv", times, 0.0 * force[:, None]
    )


def test_a_channel_that_copies_another_is_refused_and_one_that_never_changes_is_told():
    rng = np.random.default_rng(0)
    times, values = np.arange(200) * 0.01, rng.normal(size=(200, 3))
    values[:, 1] = values[:, 0]
    refused("two channels hold the same numbers", series.confirmed, "gauge.csv", times, values)
    values[:, 1] = 0.0
    kept, (note,) = series.confirmed("gauge.csv", times, values)
    assert kept.all() and "a channel never changes" in note


def test_two_channels_in_one_column_are_refused_and_a_sensor_that_hides_small_forces_is_told():
    times, force = presses(np.random.default_rng(1))
    mixed = np.where(np.arange(len(force)) % 2, force, 0.5 * force)
    refused("readings alternate between two levels", series.confirmed, "gauge.csv", times, mixed[:, None])
    kept, (note,) = series.confirmed("gauge.csv", times, np.maximum(force - 0.5, 0.0)[:, None])
    assert kept.all() and "dead band" in note
    assert series.confirmed("gauge.csv", times, force[:, None])[1] == []
