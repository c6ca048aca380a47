"""What stands above both readers: what it sees of a press, what it learns, and where it has a say."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from parameters import with_values
from synthetic_presses import SETTINGS, write_dataset

from gelforge.errors import BadInput
from gelforge.networks import stackfit
from gelforge.networks.data import data_version, open_data
from gelforge.networks.evaluation import learnt_sensors
from gelforge.networks.fitting import kept_above
from gelforge.networks.modelcard import stacking_lines
from gelforge.networks.modelfile import lessons_of, load_model, save_model, tensor_digest, tensors_of
from gelforge.networks.stacking import HALF_SAID, MOST_LOG, OF_FORCES, StackedFactor, features, train_stacking
from gelforge.networks.use import TwoReadings, Untouched, load_for_use, predict_one, told_together
from gelforge.records.totals import LEAST_PRESS
from gelforge.stages.train import train

STACKING = with_values(SETTINGS, stacking_epochs=2)


def pressed(rng, force: float = 8.0, size: float = 2.0) -> np.ndarray:
    """Forces (3, 24, 32) N of a round contact."""
    v, u = np.mgrid[:24, :32]
    bump = np.exp(-((v - rng.uniform(8, 16)) ** 2 + (u - rng.uniform(10, 22)) ** 2) / (2 * size**2))
    return (np.array([0.1, -0.2, -1.0])[:, None, None] * force * bump / bump.sum()).astype(np.float32)


@given(
    row=st.integers(0, 23), col=st.integers(0, 31), force=st.floats(LEAST_PRESS, 1e3), dots=st.floats(-1e3, 1e3),
)  # fmt: skip
@settings(max_examples=50)
def test_what_is_seen_of_any_press_is_finite(row, col, force, dots):
    """Also of a single cell, which has no spread, and beside dots that tell a pull."""
    forces = np.zeros((3, 24, 32), np.float32)
    forces[2, row, col] = -force
    seen = features(forces, np.array([0.0, 0.0, dots]), 1.0, np.zeros(5, np.float32))
    assert seen.shape == (OF_FORCES + 5,) and seen.dtype == np.float32 and np.isfinite(seen).all()


def test_the_same_contact_pressed_harder_differs_in_its_force_alone():
    rng = np.random.default_rng(0)
    forces, by_dots, pooled = pressed(rng), np.array([0.5, 0.5, -7.0]), np.ones(3, np.float32)
    one, two = features(forces, by_dots, 0.9, pooled), features(2 * forces, 2 * by_dots, 0.9, pooled)
    changed = np.flatnonzero(~np.isclose(one, two, atol=1e-5))
    assert (two - one)[changed] == pytest.approx(math.log(2.0), abs=1e-5) and len(changed) == 2  # total and peak


def made_up(rng, count: int):
    """Presses whose readers tell too little where the first thing seen is large, and too much where it is small."""
    seen = rng.normal(size=(count, OF_FORCES + 4)).astype(np.float32)
    told = -rng.uniform(1.0, 30.0, count)
    return seen, told, told * np.exp(0.2 * np.tanh(seen[:, 0]) + rng.normal(0, 0.03, count))


def test_a_factor_that_follows_from_what_is_seen_is_learnt():
    rng = np.random.default_rng(0)
    net = train_stacking(*made_up(rng, 1500), epochs=20, seed=1)
    seen, told, true = made_up(rng, 500)
    found = told * np.array([net.factor(one) for one in seen])
    assert np.abs(found - true).mean() < 0.5 * np.abs(told - true).mean()


def test_nothing_is_made_up_where_nothing_follows():
    """Readers that err by chance alone are left nearly as they are."""
    rng = np.random.default_rng(0)
    seen, told, _ = made_up(rng, 1500)
    net = train_stacking(seen, told, told * np.exp(rng.normal(0, 0.1, len(told))), epochs=20, seed=1)
    factors = np.array([net.factor(one) for one in made_up(rng, 300)[0]])
    assert np.abs(np.log(factors)).mean() < 0.03


def test_the_same_seed_learns_the_same():
    lessons = made_up(np.random.default_rng(0), 200)
    one, two, other = (tensors_of(train_stacking(*lessons, epochs=2, seed=seed)) for seed in (1, 1, 2))
    assert tensor_digest(one) == tensor_digest(two) != tensor_digest(other)


def test_a_factor_stays_within_its_bounds_whatever_is_seen():
    net = StackedFactor(OF_FORCES).eval()
    with torch.no_grad():
        net.outer += 100.0
    for seen in (np.zeros(OF_FORCES), np.full(OF_FORCES, 1e30), np.full(OF_FORCES, -1e30)):
        assert abs(math.log(net.factor(seen.astype(np.float32)))) <= MOST_LOG + 1e-6


def test_the_farther_a_press_lies_from_those_it_learnt_from_the_less_it_says():
    net = StackedFactor(OF_FORCES + 3).eval()
    with torch.no_grad():
        net.bias += 0.2
    seen = [np.full(OF_FORCES + 3, apart, np.float32) for apart in (0.0, 0.5, HALF_SAID, 10.0, 1e6)]
    told = [math.log(net.factor(one)) for one in seen]
    assert told == sorted(told, reverse=True) and told[-1] == pytest.approx(0.0, abs=1e-6)
    assert told[0] == pytest.approx(0.2, rel=1e-5) and told[2] == pytest.approx(0.1, rel=1e-5)


@pytest.fixture(scope="module")
def fresh(root, tmp_path_factory):
    """Presses that the network which ships did not learn from, of sensors with dots."""
    from gelforge.records.image import read_image

    data = open_data(write_dataset(tmp_path_factory.mktemp("fresh") / "24x32", 24))
    rest = read_image(root / "data/demo/nocontact/mini_a.png")[..., :3]
    files = sorted((root / "data/demo/images").glob("*.png"))[:24]
    pictures = np.stack([read_image(path)[..., :3] for path in files])
    return replace(data, images=pictures, nocontact=dict.fromkeys(data.nocontact, rest))


@pytest.fixture(scope="module")
def stacked(fresh):
    """The network that ships with one above its readers that learnt from hardly any presses."""
    start = load_for_use(None)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(stackfit, "FEWEST_PRESSES", 4)
        return train(fresh, "stacked", start.about["model"], STACKING, start=start)


def test_network_and_readers_stay_as_they_are(stacked):
    start = load_for_use(None)
    for name in ("net", "dots", "places"):
        one, two = (tensor_digest(tensors_of(getattr(trained, name))) for trained in (start, stacked))
        assert one == two
    assert stacked.about["curve"] == start.about["curve"] and stacked.about["data"] == start.about["data"]


def test_only_normal_force_is_moved_and_only_where_something_presses(stacked):
    rng = np.random.default_rng(1)
    pooled = rng.normal(size=stacked.stacking.mean.shape[0] - OF_FORCES).astype(np.float32)
    alone = replace(stacked, stacking=None)
    for force, moves in ((0.5 * LEAST_PRESS, False), (8.0, True)):
        readings = TwoReadings(pressed(rng, force), np.array([0.1, 0.2, -0.9 * force]), 1.0, pooled)
        found, without = told_together(stacked, readings), told_together(alone, readings)
        np.testing.assert_array_equal(found[:2], without[:2])
        assert (found[2].sum() != without[2].sum()) == moves
        within = np.corrcoef(found[2].ravel(), without[2].ravel())[0, 1]
        assert within == pytest.approx(1.0, abs=1e-6)
    readings = replace(readings, by_dots=None)
    np.testing.assert_array_equal(told_together(stacked, readings), readings.forces)


def test_its_file_reads_back_and_tells_the_same(stacked, fresh, tmp_path):
    save_model(tmp_path / "m.pt", stacked)
    again = load_model(tmp_path / "m.pt")
    rest = next(iter(fresh.nocontact.values()))
    for image in fresh.images[:3]:
        one, two = (predict_one(Untouched(trained, rest), image)[1] for trained in (stacked, again))
        np.testing.assert_array_equal(one, two)
    (line,) = stacking_lines(again.about)
    assert f"{again.about['stacking']['presses']} presses" in line
    about = again.about | {"stacking": {"sha256": 64 * "0"}}
    save_model(tmp_path / "odd.pt", replace(stacked, about=about))
    with pytest.raises(BadInput, match="stacking"):
        load_model(tmp_path / "odd.pt")


def test_presses_that_the_network_knows_may_stand_beside_new_ones(fresh, monkeypatch):
    """They are learnt from as well, and told in file and card; whether they or the new ones are judged makes no difference."""
    start, seen = load_for_use(None), []
    known = replace(fresh, info=fresh.info | {"name": "known"}, labels=1.01 * np.array(fresh.labels))
    version = data_version(known)
    start = replace(start, about=start.about | {"data": start.about["data"] | {"version": version}})
    monkeypatch.setattr(stackfit, "FEWEST_PRESSES", 4)
    monkeypatch.setattr(
        stackfit, "train_stacking", lambda *given: seen.append(len(given[0])) or train_stacking(*given)
    )
    alone, both, turned = (
        train(data, "stacked", start.about["model"], STACKING, start=start, also=also)
        for data, also in ((fresh, ()), (fresh, (known,)), (known, (fresh,)))
    )
    assert seen[0] < seen[1] <= 2 * seen[0] + 4 and abs(seen[1] - seen[2]) <= 4  # each variant is drawn anew
    for found in (both, turned):
        every = {one["name"]: one for one in lessons_of(found.about)[-2:]}
        assert every["known"]["version"] == version and not every["known"]["new"]
        (line,) = stacking_lines(found.about)
        assert f" and from {every['known']['presses']} presses that it knew (known, version {version}" in line
    assert "that it knew" not in stacking_lines(alone.about)[0]
    assert turned.about["intervals"]["data"] == "known"
    with pytest.raises(BadInput, match="errs less on them .* name one in .train. also"):
        train(known, "stacked", start.about["model"], STACKING, start=start)


def test_the_units_that_it_learnt_from_count_as_learnt(stacked, fresh):
    assert learnt_sensors(stacked, fresh, data_version(fresh)) <= set(fresh.names("sensor_id").tolist())
    assert not learnt_sensors(load_for_use(None), fresh, data_version(fresh))


def test_what_cannot_be_learnt_from_is_refused(fresh):
    start = load_for_use(None)
    model = start.about["model"]
    with pytest.raises(BadInput, match="presses train; how both readers err is learnt from 250 or more"):
        train(fresh, "stacked", model, STACKING, start=start)
    known = replace(start, about=start.about | {"data": start.about["data"] | {"version": data_version(fresh)}})
    with pytest.raises(BadInput, match="errs less on them"):
        train(fresh, "stacked", model, STACKING, start=known)
    with pytest.raises(BadInput, match='say start = "shipped"'):
        train(fresh, "stacked", model, STACKING)
    with pytest.raises(BadInput, match="another network: width"):
        train(fresh, "stacked", model | {"width": 8}, STACKING, start=start)
    deaf = replace(start, dots=None, about=start.about | {"dots": None})
    with pytest.raises(BadInput, match="does not read dots"):
        train(fresh, "stacked", model, STACKING, start=deaf)


@pytest.mark.parametrize(("told", "kept"), [(MOST_LOG, True), (-MOST_LOG, False)])
def test_a_network_that_goes_on_keeps_it_only_where_it_serves(stacked, fresh, told, kept):
    """On presses that are half as heavy again as both readers tell."""
    alone = replace(stacked, stacking=None, about=stacked.about | {"stacking": None})
    rest, labels = next(iter(fresh.nocontact.values())), np.array(fresh.labels)
    for row in fresh.splits["val"]:
        labels[row] = math.exp(MOST_LOG) * predict_one(Untouched(alone, rest), fresh.images[row])[1]
    above = StackedFactor(len(stacked.stacking.mean)).eval()
    with torch.no_grad():
        above.bias += told
    found = kept_above(alone, replace(stacked, stacking=above), replace(fresh, labels=labels))
    assert (found.stacking is not None) == bool(found.about["stacking"]) == kept
