"""A network that learns from several datasets: what it is given of each, and what it is judged on."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelforge.learning.data import concatenate, data_version, open_data, press_keys, scales
from gelforge.learning.evaluate import evaluate, known_rows
from gelforge.learning.predictions import predict_rows
from gelforge.records.rowfile import ChainedRows
from gelforge.stages.train import train
from tests.support.parameters import with_values
from tests.support.refused import refused
from tests.support.small_networks import EVALUATE, GRID, IMAGE, LEARNING, SMALL
from tests.support.synthetic_presses import SETTINGS, write_dataset

SPLITS = {"own": 48, "other": 64, "third": 32}


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    """Three datasets of other presses, each of a sensor of the same name."""
    folder = tmp_path_factory.mktemp("joined")
    opened = [
        open_data(write_dataset(folder / name, n, IMAGE, GRID, seed))
        for seed, (name, n) in enumerate(SPLITS.items(), 1)
    ]
    return [replace(one, info=one.info | {"name": name}) for one, name in zip(opened, SPLITS, strict=True)]


@given(
    st.lists(st.integers(0, 8), max_size=3),
    st.one_of(st.integers(-8, 7), st.slices(8), st.lists(st.integers(-8, 7), max_size=9)),
)
def test_chained_rows_are_those_of_one_array(cuts, rows):
    whole = np.arange(6 * 8, dtype=np.uint16).reshape(8, 2, 3)
    chained = ChainedRows(np.split(whole, sorted(cuts)))
    assert (chained.shape, chained.dtype, len(chained)) == (whole.shape, whole.dtype, len(whole))
    expected = whole[np.array(rows, int) if isinstance(rows, list) else rows]
    assert chained[rows].dtype == expected.dtype and np.array_equal(chained[rows], expected)


def of_totals(data, name="sums"):
    """The same presses, of which only the total force is known."""
    labels, maps = data.labels[:].sum((2, 3), keepdims=True), np.zeros(len(data.table), bool)
    return replace(data, labels=labels, maps=maps, info=data.info | {"name": name})


def test_every_press_is_what_it_was_in_its_own_dataset(datasets):
    every = [*datasets, of_totals(datasets[1])]
    joined, at = concatenate(every[0], every[1:]), 0
    assert len(joined.table) == len(joined.maps) == sum(SPLITS.values()) + SPLITS["other"]
    for one in every:
        rows = range(len(one.table))
        there = [at + row for row in rows]
        assert np.array_equal(joined.seen(there, True), one.seen(rows, True))
        assert np.allclose(joined.totals(there), one.totals(rows), rtol=1e-5, atol=1e-6)
        assert np.array_equal(joined.maps[there], one.maps)
        at += len(rows)


def test_only_what_trains_and_validates_is_taken_of_others(datasets):
    own, *others = datasets
    joined = concatenate(own, others)
    assert joined.splits.keys() == own.splits.keys()
    for name, rows in joined.splits.items():
        taken = datasets if name in ("train", "val") else [own]
        assert len(rows) == len(set(rows.tolist())) == sum(len(one.splits[name]) for one in taken)
        assert {joined.table[row].split for row in rows} == {name}


def test_one_name_in_two_datasets_is_two_sensors(datasets):
    joined = concatenate(datasets[0], datasets[1:])
    assert sorted(joined.nocontact) == ["mini0", "other/mini0", "third/mini0"]
    grouped = [replace(one, table=[replace(row, group="g") for row in one.table]) for one in datasets]
    assert len(set(concatenate(grouped[0], grouped[1:]).presses(range(sum(SPLITS.values()))))) == 3


def test_scales_are_those_of_all_presses(datasets):
    labels = np.concatenate([one.labels[one.splits["train"]] for one in datasets]).astype(float)
    found = scales(concatenate(datasets[0], datasets[1:]))
    assert np.allclose(found["label"], np.sqrt((labels**2).mean((0, 2, 3))), rtol=1e-6)


def test_what_cannot_be_learnt_from_together_is_refused(datasets, tmp_path):
    own, other = datasets[:2]
    coarse = open_data(write_dataset(tmp_path / "coarse", 16, IMAGE, (3, 4)))
    small = open_data(write_dataset(tmp_path / "small", 16, (24, 32), GRID))
    for wrong, word in ((coarse, "grid of 3 x 4"), (small, "images of 32 x 24"), (own, "own is given twice")):
        refused(word, concatenate, own, [other, wrong])


@pytest.mark.slow
def test_a_network_reads_both_that_it_learnt_from_and_says_so(datasets):
    own, other = datasets[0], datasets[1]
    # their forces mean opposite things, so only who learnt from the other one reads it
    turned = replace(other, labels=-other.labels[:])
    settings = with_values(SETTINGS, **LEARNING)
    totals = of_totals(turned, "other")
    alone, both, summed = (train(own, "small", SMALL, settings, also=also) for also in ((), [turned], [totals]))
    rows = other.splits["train"]
    read = [predict_rows(one.model, turned, rows).forces for one in (alone, both, summed)]
    errors = [np.abs(forces.sum((2, 3)) - turned.totals(rows)).mean() for forces in read]
    assert max(errors[1:]) < 0.8 * errors[0]
    refused("total_weight = 0: only totals are known of other", train, own, "small", SMALL,
            with_values(settings, total_weight=0.0), also=[totals])  # fmt: skip
    assert alone.metadata["also"] == []
    reported = both.metadata["also"][0]
    assert both.metadata["data"] == alone.metadata["data"]
    assert (reported["name"], reported["version"], reported["simulated"]) == ("other", data_version(turned), True)
    assert reported["samples"] == {name: len(other.splits[name]) for name in ("train", "val")}


def test_presses_that_a_dataset_gained_are_new_to_a_network_and_the_others_stay_known(datasets):
    """A plan that grows changes its dataset's version, and no press of before."""
    own, other = datasets[0], datasets[1]
    model = train(own, "small", SMALL, with_values(SETTINGS, epochs=1)).model
    grown = concatenate(own, [other])
    table = [
        replace(one, press=replace(one.press, x0_mm=one.press.x0_mm + 50.0)) if n >= len(own.table) else one
        for n, one in enumerate(grown.table)
    ]
    known = known_rows(model, replace(grown, table=table, info=own.info))
    assert known[own.splits["train"]].all() and not known[len(own.table) :].any()
    assert not known[own.splits["test"]].all()


def test_no_network_is_judged_on_presses_that_it_learnt_from(datasets):
    own, other = datasets[0], datasets[1]
    both = train(own, "small", SMALL, with_values(SETTINGS, epochs=1), also=[other])
    assert "train" not in evaluate(other, both.model, EVALUATE)[0]["splits"]
    only = replace(other, splits={"train": other.splits["train"]})
    refused("which the network learnt from", evaluate, only, both.model, EVALUATE)


def test_two_presses_of_one_place_at_other_angles_are_two(datasets):
    """Depths and sensors are views of one press; another place, angle or indenter is another press."""
    data = datasets[0]
    place = {"x0_mm": 1.0, "y0_mm": -2.0, "z0_mm": 0.0, "dx_mm": 0.0, "dy_mm": 0.0, "dz_mm": -0.5, "rot_deg": 10.0}
    changes = [
        {},
        {"dz_mm": -1.0},
        {"sensor_id": "other"},
        {"rot_deg": 40.0},
        {"y0_mm": -2.1},
        {"x0_mm": 1.1},
        {"indenter": "cube"},
    ]
    table = [replace(data.table[0], press=replace(data.table[0].press, **place | change)) for change in changes]
    keys = press_keys(replace(data, table=table), range(len(table))).tolist()
    assert keys[0] == keys[1] == keys[2] and len(set(keys)) == 5
