"""Parts of the presses that a network learns from."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.networks.data.arrays import open_data
from gelforge.networks.data.loader import epoch_order
from gelforge.networks.data.subset import as_many_passes, parse_subset, take_subset
from tests.support.parameters import parameters
from tests.support.synthetic_presses import write_dataset


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return open_data(write_dataset(tmp_path_factory.mktemp("part") / "6x8", 48, (48, 64), (6, 8)))


@pytest.mark.parametrize("name", ["presses_6", "units_1"])
def test_a_part_has_what_it_is_asked_for_and_leaves_the_rest(data, name):
    part = parse_subset(name)
    taken = take_subset(data, part, seed=1)
    rows = taken.splits["train"]
    of_row = data.presses(rows) if part.what == "presses" else data.names("sensor_id")[rows]
    assert len(np.unique(of_row)) == part.count
    assert set(rows) <= set(data.splits["train"])
    judged = taken.splits["val"]
    if part.what == "units":
        # the epoch that is kept is chosen by the units that are there, and by all their pictures
        names = data.names("sensor_id")
        judged = data.splits["val"][np.isin(names[data.splits["val"]], np.unique(names[rows]))]
    assert len(judged)
    for split in set(data.splits) - {"train"}:
        assert np.array_equal(taken.splits[split], judged if split == "val" else data.splits[split])


def test_a_press_is_taken_whole_and_parts_grow(data):
    last: set[int] = set()
    for count in (4, 8, 16):
        rows = take_subset(data, parse_subset(f"presses_{count}"), seed=3).splits["train"]
        presses = data.presses(data.splits["train"])
        whole = data.splits["train"][np.isin(presses, data.presses(rows))]
        assert set(whole) == set(rows)
        assert last <= set(rows)
        last = set(rows)


@pytest.mark.parametrize(
    "name", ["presses", "presses_", "presses_0", "units_-1", "rows_3", "units_1.5", "presses_\u0663"]
)
def test_what_is_no_part_is_refused(name):
    with pytest.raises(BadInput, match="presses_N or units_N"):
        parse_subset(name)


@pytest.mark.parametrize("most", [0, 5, 17, 10**6])
@pytest.mark.parametrize("epochs", [6, 30])
def test_every_part_is_passed_over_as_often_as_the_whole(data, most, epochs):
    """Whatever an epoch shows of it, to the rounding of one picture an epoch."""
    settings = replace(parameters().train, epoch_images=most)

    def passes(of, settings):
        rows = of.splits["train"]
        return sum(len(epoch_order(rows, 1, epoch, settings.epoch_images)) for epoch in range(epochs)) / len(rows)

    whole = passes(data, settings)
    for count in (4, 8, 16):
        taken = take_subset(data, parse_subset(f"presses_{count}"), seed=3)
        assert (
            0 <= passes(taken, as_many_passes(settings, taken, data)) - whole <= epochs / len(taken.splits["train"])
        )


def test_more_than_there_is_is_refused(data):
    with pytest.raises(BadInput, match="asks for more presses than the"):
        take_subset(data, parse_subset("presses_100000"), seed=1)
