"""Evaluation of networks, its report, and the chart that sets errors against latency; on small networks."""

import csv
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelforge.flow.files import read_csv, read_json, write_csv, write_json
from gelforge.flow.layout import Layout
from gelforge.learning.data import concatenate, groups_of, open_data, press_keys
from gelforge.learning.evaluate import (
    FEWEST_DRAWN,
    another_of_each,
    contact_table,
    error_table,
    evaluate,
    known_rows,
    learnt_sensors,
    slope,
    what_errs_alike,
)
from gelforge.learning.pictures import write_pairs
from gelforge.learning.predictions import intervals_of, predict_rows
from gelforge.learning.start import Start
from gelforge.learning.start import shipped as shipped_start
from gelforge.reading.interval import half_widths
from gelforge.reading.reader import Reader
from gelforge.records.axes import CHANNELS
from gelforge.records.predictionfile import read_predictions
from gelforge.records.press import FORCE, FORCES
from gelforge.reporting.errortables import tables
from gelforge.reporting.modelcard import write_card
from gelforge.reporting.networkcharts import draw_curve, draw_predictions
from gelforge.stages import pareto_models
from gelforge.stages.evaluate import keep_predictions
from gelforge.stages.train import train
from tests.support.parameters import with_values
from tests.support.small_networks import EVALUATE, GRID, IMAGE, MODELS
from tests.support.synthetic_presses import SETTINGS, write_dataset


@pytest.fixture(scope="module")
def evaluated(data, models):
    """What `evaluate` gives of each network."""
    return {name: evaluate(data, trained.model, EVALUATE) for name, trained in models.items()}


@pytest.mark.parametrize("name", ["pair", "unet"])
def test_evaluation_holds_what_is_asked(data, evaluated, name):
    result, predictions = evaluated[name]
    assert set(result["splits"]) == {"val", "test", "test_unseen_indenter", "test_unseen_sensor"}
    test = result["splits"]["test"]
    rows, forces = predictions["test"]
    error = np.abs(forces.sum((2, 3), dtype=float) - data.totals(rows))
    assert test["total"]["fz"]["mae"] == pytest.approx(error[:, 2].mean())
    assert test["cell"]
    assert set(test["controls"]) == {"constant_guess", "shuffled_images", "linear_on_image_means"}
    # the page says whose they are: the shipped network is not called there as it was when it was trained
    assert not any(result["model"] in table["title"] for table in tables(result))


@pytest.fixture(scope="module")
def ten(tmp_path_factory):
    """Eighty presses, of which ten test; each has a part of its force outside the picture."""
    folder = write_dataset(tmp_path_factory.mktemp("ten") / "6x8", 80, IMAGE, GRID, seed=4)
    rows, rng = read_csv(folder / "samples.csv"), np.random.default_rng(6)
    for row in rows:
        for axis in ("fx_n", "fy_n", "fz_n"):
            outside = rng.normal(0.0, 0.3)
            row |= {f"outside_{axis}": outside, f"true_{axis}": float(row[axis]) * 1.1 + outside}
            row[f"measured_{axis}"] = float(row[axis]) + rng.normal(0.0, 0.2)
    write_csv(folder / "samples.csv", list(rows[0]), rows)
    return open_data(folder)


def test_every_figure_of_ten_presses_is_that_of_a_calculation_by_hand(ten, models):
    """From the predictions and the table as text, by numpy alone."""
    result, predictions = evaluate(ten, models["pair"].model, EVALUATE)
    rows, forces = predictions["test"]
    found, texts = result["splits"]["test"], read_csv(ten.folder / "samples.csv")
    assert len(rows) == 10 == found["n"] == found["presses"]
    label, train = np.load(ten.folder / "labels.npy").astype(float), ten.splits["train"]

    def column(name: str, of=rows) -> np.ndarray:
        return np.array([[float(texts[row][f"{name}{axis}_n"]) for axis in CHANNELS] for row in of])

    total, read = label.sum((2, 3)), forces.astype(float).sum((2, 3))
    error, spread = read - total[rows], np.ptp(total[train], axis=0)
    cells = np.array([[np.mean([abs(a - b) for a, b in zip(one[k].flat, label[row][k].flat)]) for k in range(3)]
                      for one, row in zip(forces.astype(float), rows)])  # fmt: skip
    means = np.array([image.reshape(-1, 3).mean(0) for image in np.load(ten.folder / "images.npy")])
    fit = np.linalg.lstsq(np.c_[means[train], np.ones(len(train))], total[train], rcond=None)[0]
    guesses = {"constant_guess": np.median(total[train], axis=0) + np.zeros((10, 3)),
               "linear_on_image_means": np.c_[means[rows], np.ones(10)] @ fit}  # fmt: skip
    for k, axis in enumerate(CHANNELS):
        sizes = sorted(abs(value) for value in error[:, k])
        mean = sum(sizes) / 10
        by_hand = {"mae": mean, "std": np.sqrt(sum((size - mean) ** 2 for size in sizes) / 10), "bias": sum(error[:, k]) / 10,
                   "rms": np.sqrt(sum(size**2 for size in sizes) / 10), "mae_percent_of_range": 100 * mean / spread[k]}  # fmt: skip
        assert {name: found["total"][axis][name] for name in by_hand} == pytest.approx(by_hand, rel=1e-5)
        assert sizes[0] < found["total"][axis]["mae_low"] < mean < found["total"][axis]["mae_high"] < sizes[-1]
        each = cells[:, k]
        assert found["cell"][axis] == pytest.approx({"mae": each.mean(), "std": each.std()}, rel=1e-5)
        for name, guess in guesses.items():
            off = np.abs(guess - total[rows])[:, k].mean()
            assert found["controls"][name][axis] == pytest.approx(off, rel=1e-5)
        for kind, what in (("sensor", "measured_"), ("truth", "true_")):
            known = column(what)[:, k] - column("outside_")[:, k]
            against = found["against"][kind]
            for who, values in (("network", read[:, k]), ("labels", total[rows, k])):
                off = values - known
                assert against[who][axis]["bias"] == pytest.approx(off.mean(), rel=1e-4)
                assert against[who][axis]["std"] == pytest.approx(np.abs(off).std(), rel=1e-4)
            through_zero = (known * total[rows, k]).sum() / (known * known).sum()
            assert against["labels_over"][axis] == pytest.approx(through_zero, rel=1e-5)
    groups = {
        "per_indenter": [texts[row]["indenter"] for row in rows],
        "per_sensor": [texts[row]["sensor_id"] for row in rows],
        "per_force": [next(name for name, most in (("00.0-05.0 N", 5), ("05.0-20.0 N", 20), ("20.0+ N", np.inf))
                           if abs(total[row, 2]) < most) for row in rows],
    }  # fmt: skip
    for kind, names in groups.items():
        assert set(found[kind]) == set(names)
        for name, table in found[kind].items():
            mine = error[[one == name for one in names]]
            assert table["n"] == len(mine)
            for k, axis in enumerate(CHANNELS):
                expected = {"mae": np.abs(mine[:, k]).mean(), "bias": mine[:, k].mean()}
                assert table[axis] == pytest.approx(expected, rel=1e-5)


def test_errors_of_contacts_are_those_of_two_bumps_by_hand():
    """Two contacts of 6 and 4 N, predicted with 5 and 5 N: a mean error of 1 N, of 1/6 and 1/4 of their forces."""
    label, predicted = np.zeros((2, 3, 12, 20)), np.zeros((2, 3, 12, 20))
    label[:, 2, 4:6, 3:5], label[:, 2, 4:6, 14:16] = -1.5, -1.0
    predicted[:, 2, 4:6, 3:5], predicted[:, 2, 4:6, 14:16] = -1.25, -1.25
    label[1, 2, :, 10:] = 0.0  # a press with one contact counts nothing
    found = contact_table(label, predicted)
    assert found == pytest.approx({"n": 2, "mae": 1.0, "percent": 100 * (1 / 6 + 1 / 4) / 2})


def test_sensor_and_truth_are_compared_on_the_right_axis(evaluated):
    against = evaluated["pair"][0]["splits"]["test"]["against"]
    for axis in CHANNELS:
        # The made-up force sensor reads 0.1 N too much, the made-up truth is the label (float32 sums).
        assert against["sensor"]["labels"][axis]["bias"] == pytest.approx(-0.1, abs=1e-5)
        assert against["truth"]["labels"][axis]["mae"] < 1e-5
    assert against["truth"]["labels_over"]["fz"] == pytest.approx(1.0, abs=1e-5)
    assert slope(np.full((4, 3), 0.98), np.ones((4, 3))) == pytest.approx(dict.fromkeys(CHANNELS, 0.98))


def test_evaluation_is_of_what_predict_gives(data, models, evaluated):
    model, found = models["pair"].model, evaluated["pair"][0]["splits"]["test"]
    rows = data.splits["test"]
    names = data.names("sensor_id")[rows]
    forces = [
        Reader(data.nocontact[name], model=model)(np.asarray(data.images[row])).total
        for row, name in zip(rows, names, strict=True)
    ]
    error = np.array(forces) - data.totals(rows)
    for k, axis in enumerate(CHANNELS):
        assert found["total"][axis]["mae"] == pytest.approx(np.abs(error[:, k]).mean(), rel=1e-5)


def test_a_dataset_of_few_presses_is_read_by_a_network_that_did_not_learn_from_it(models, tmp_path):
    """The first presses of a bench are all of one split; their report shows them all the same."""
    few = open_data(write_dataset(tmp_path / "6x8", 3, IMAGE, GRID, seed=9))
    assert set(few.splits) == {"train"}
    result, predictions = evaluate(few, models["pair"].model, EVALUATE)
    assert set(result["splits"]) == {"train"} and len(predictions["train"][0]) == 3
    keep_predictions(tmp_path / "p.npz", few, models["pair"].model, predictions)
    assert read_predictions(tmp_path / "p.npz")


def test_pictures_and_card_are_written(data, models, evaluated, tmp_path):
    about, (result, predictions) = models["pair"].metadata, evaluated["pair"]
    draw_curve(tmp_path / "curve.png", about["curve"], about["best_epoch"], "small")
    draw_predictions(tmp_path / "predictions.png", data, predictions)
    for name in ("curve", "predictions"):
        assert cv2.imread(str(tmp_path / f"{name}.png")).std() > 5
    assert "virtual rig" in write_card(about, result) and f"dataset {data.name}" in write_card(about, result)
    over = f"in a split of {FEWEST_DRAWN} sensors or more, none of which it learnt from, over sensors"
    assert over in write_card(about, result) and "interval over presses" not in write_card(about, result)
    left = [{"readings": 5, "factor_percent": 1.62, "factor_between": [0.3, 3.1], "force_n": 0.7, "force_between": [0.4, 1.1],
             "held_percent": 99.6}]  # fmt: skip
    assert "| 5 | 1.6 (0.3 to 3.1) | 0.70 (0.40 to 1.10) | 100 |" in write_card(about, result, readings=left)
    missed = {
        "name": "slope",
        "value": 1.234,
        "unit": "%",
        "compare": "<=",
        "goal": 1.0,
        "met": False,
        "note": "of 3",
    }
    card = write_card(about, result, [missed, missed | {"name": "noted", "compare": ""}])
    assert "| slope | 1.23 % | <= 1, **missed** | of 3 |" in card and "| noted | 1.23 % |  | of 3 |" in card
    for drawn, also, said in (
        (True, True, "no real sensor"), (False, False, "recorded presses."), (False, True, "and from simulated"),
    ):  # fmt: skip
        lessons = [
            about["data"] | {"name": name, "simulated": one} for name, one in (("own", drawn), ("other", also))
        ]
        card = write_card(about | {"data": lessons[0], "also": lessons[1:]}, result)
        assert said in card and "- Data: own, version" in card and "- Also learnt from: other, version" in card
    assert "Fine-tuned from" not in write_card(about, result)
    start = {"name": "small", "sha256": 64 * "0", "data": "train", "simulated": True, "fraction": 0.5}
    reported = write_card(about | {"start": start}, result)
    assert "Fine-tuned from the network small, which learnt from simulated presses" in reported
    assert "Its weights lie 50 % of the way from that network's to those learnt here" in reported


def test_the_choice_is_faster_and_nowhere_worse():
    errors = {f"{what}_{axis}": 1.0 for what in ("total", "cell") for axis in CHANNELS}
    base = {"model": "unet", "cpu1_median_ms": 10.0, "percent": 5.0, **errors}
    fast = {"model": "fast", "cpu1_median_ms": 1.0, "percent": 4.0, **errors, "cell_fz": 1.1}
    light = {"model": "light", "cpu1_median_ms": 1.5, "percent": 4.5, **errors}
    good = {"model": "good", "cpu1_median_ms": 2.0, "percent": 4.0, **errors, "total_fy": 0.9}
    best = {"model": "best", "cpu1_median_ms": 2.1, "percent": 3.0, **errors}
    totals = {"model": "totals", "cpu1_median_ms": 0.5, "percent": 2.0, **errors, "cell_fz": None}
    assert pareto_models.choose([base, fast, light, good, best, totals])["model"] == "good"
    assert pareto_models.choose([base, fast, best]) is None and pareto_models.choose([fast]) is None


def test_chart_of_models_against_latency(data, models, evaluated, paths, tmp_path, monkeypatch):
    of = Layout(tmp_path / "results/made")
    of.dataset("6x8").parent.mkdir(parents=True)
    of.dataset("6x8").symlink_to(data.folder)
    for name in models:
        write_json(of.evaluation("6x8", name), evaluated[name][0])
        of.network("6x8", name).parent.mkdir(parents=True, exist_ok=True)
        of.network("6x8", name).symlink_to(paths[name])
    write_json(of.parameters("networks"), [*models])
    monkeypatch.setattr(pareto_models, "SECONDS", 0.05)
    assert pareto_models.main([str(of.root), "6x8"]) == 0
    out = of.network_chart("6x8")
    with out.with_suffix(".csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["model"] for row in rows} == set(MODELS) and all(float(row["cpu2_median_ms"]) > 0 for row in rows)
    assert out.with_suffix(".png").exists()


def test_shuffling_leaves_no_press_a_prediction_of_its_own(data, models):
    """Also where one press was filmed so often that most rows are its own; of one press alone there is no other."""
    for names in ("ab", "aabb", "abacbc", "babbbbbb"):
        press, drawn = np.array(list(names)), set()
        for seed in range(100):
            other = another_of_each(press, np.random.default_rng(seed))
            assert (press[other] != press).all(), names
            drawn |= set(zip(range(len(press)), other.tolist(), strict=True))
        assert drawn == {(k, j) for k in range(len(press)) for j in range(len(press)) if press[k] != press[j]}, names
    assert another_of_each(np.array(["a"] * 4), np.random.default_rng(0)) is None
    one = replace(data, splits={"train": data.splits["train"], "test": data.splits["test"][:1]})
    result, _ = evaluate(one, models["pair"].model, EVALUATE)
    assert set(result["splits"]["test"]["controls"]) == {"constant_guess", "linear_on_image_means"}


def test_force_outside_the_picture_is_no_error_of_label_or_network(data, models):
    """The truth is of the whole gel; what fell outside is reported beside the label, and no picture shows it."""
    beyond, turned = np.array([0.3, -0.2, -1.5, 0.01, -0.02, 0.001]), np.array([0.004, -0.003, 0.0002])  # N, N m
    table = []
    for each in data.table:
        wrench = np.concatenate([each.total, turned])
        true = np.concatenate([[float(each.truth[name]) for name in FORCE], turned]) + beyond
        truth = {name: str(value) for name, value in zip(FORCES, true.tolist(), strict=True)}
        table.append(replace(each, wrench=wrench, outside=beyond, truth=truth))
    against = evaluate(replace(data, table=table), models["pair"].model, EVALUATE)[0]["splits"]["test"]["against"][
        "truth"
    ]
    assert against["labels"]["fz"]["mae"] == pytest.approx(0.0, abs=1e-6)
    assert against["labels_over"]["fz"] == pytest.approx(1.0, abs=1e-6)
    moments = against["moment"]["labels"]
    assert moments["n"] == against["n"] and moments["mx"]["mae"] == pytest.approx(0.0, abs=1e-6)  # N mm
    assert against["moment"]["network"]["my"]["mae"] > 0.0


def test_the_error_on_sensors_that_training_never_saw_is_as_uncertain_as_they_differ(data):
    """Of few of them, and of sensors that it saw, it is as uncertain as presses differ."""
    unseen, test = data.splits["test_unseen_sensor"], data.splits["test"]
    assert len(unseen) > FEWEST_DRAWN
    for sensors in (FEWEST_DRAWN, 2):
        table = list(data.table)
        for n, row in enumerate(unseen):
            table[row] = replace(table[row], press=replace(table[row].press, sensor_id=f"other{n % sensors}"))
        other = replace(data, table=table)
        drawn = sensors if sensors == FEWEST_DRAWN else len(set(other.presses(unseen)))
        assert len(set(what_errs_alike(other, unseen, {"mini0"}))) == drawn
        assert np.array_equal(what_errs_alike(other, test, {"mini0"}), other.presses(test))


def test_sensors_are_drawn_whole_where_a_network_learnt_from_other_data_or_sensors(data, models):
    """The training presses of the dataset that judges it are nothing that it learnt from."""
    table = [
        replace(one, press=replace(one.press, sensor_id=f"unit{n % FEWEST_DRAWN}"))
        for n, one in enumerate(data.table)
    ]
    nocontact = {f"unit{n}": data.nocontact["mini0"] for n in range(FEWEST_DRAWN)}
    other, model = replace(data, table=table, nocontact=nocontact), models["pair"].model
    name, rows = next((name, rows) for name, rows in other.splits.items() if name != "train" and len(rows))
    other = replace(other, splits={"train": other.splits["train"], name: rows})
    units = sorted(set(other.names("sensor_id").tolist()))
    here = model.metadata | {"known_sensors": units, "sensors": units}
    elsewhere = here | {"data": here["data"] | {"name": "elsewhere", "pressed": ["0123456789"]}}

    def interval(metadata: dict) -> tuple[float, float]:
        found = evaluate(other, replace(model, metadata=metadata), EVALUATE)[0]["splits"][name]["total"]["fz"]
        return found["mae_low"], found["mae_high"]

    def drawing(alike) -> tuple[float, float]:
        forces = predict_rows(model, other, rows).forces
        error = forces.sum((2, 3), dtype=np.float64) - other.totals(rows)
        drawn = error_table(error, np.random.default_rng(EVALUATE.seed), EVALUATE.bootstrap, alike=alike)["fz"]
        return drawn["mae_low"], drawn["mae_high"]

    by_press, by_sensor = drawing(other.presses(rows)), drawing(other.names("sensor_id")[rows])
    assert by_press != by_sensor
    assert learnt_sensors(replace(model, metadata=here), other) == set(units)
    assert interval(here) == by_press and interval(elsewhere | {"also": [here["data"]]}) == by_press
    assert interval(elsewhere) == by_sensor
    assert interval(here | {"sensors": units[:1]}) == by_press  # of a part of the sensors, which this split has too
    assert interval(here | {"sensors": ["gone"]}) == by_sensor


@pytest.fixture(scope="module")
def seen_by_three(tmp_path_factory):
    """Many presses, of which two sensors that training did not see show some."""
    folder = write_dataset(tmp_path_factory.mktemp("three") / "6x8", 416, IMAGE, GRID)
    rows = [row | {"group": ""} for row in read_csv(folder / "samples.csv")]
    for n, row in enumerate(row for row in rows if row["split"] == "test_unseen_sensor"):
        row["sensor_id"] = "mini1" if n % 2 == 0 else "mini2"
    write_csv(folder / "samples.csv", list(rows[0]), rows)
    reported = read_json(folder / "dataset.json") | {"nocontact": ["mini0", "mini1", "mini2"]}
    write_json(folder / "dataset.json", reported)
    rest, images = np.load(folder / "nocontact.npy")[0], np.load(folder / "images.npy")
    write_pairs(folder, images, [row["sensor_id"] for row in rows], dict.fromkeys(reported["nocontact"], rest))
    return open_data(folder)


@pytest.fixture(scope="module")
def learnt(seen_by_three):
    """A network that learnt from them for one epoch."""
    return train(seen_by_three, "pair", MODELS["pair"], with_values(SETTINGS, epochs=1))


def test_intervals_are_set_and_judged_on_presses_and_sensors_that_chose_nothing(seen_by_three, learnt):
    """Half of validation chooses epoch and scale, the other half and a half of the unseen sensors set the size."""
    data = seen_by_three
    groups = groups_of(data, data)
    chose, size_on = groups.choose, groups.calibrate
    for of in (chose, size_on):
        assert 0 < np.isin(data.splits["val"], of).sum() < len(data.splits["val"])
    parts = [set(press_keys(data, rows).tolist()) for rows in (groups.train, chose, size_on, data.splits["test"])]
    assert sum(map(len, parts)) == len(set.union(*parts))  # no press in two of them
    model = learnt.model
    sensors = set(data.names("sensor_id")[size_on])
    assert model.metadata["intervals"]["sensors"] == sorted(sensors)

    def held(rows):
        found = predict_rows(model, data, rows)
        return np.abs(found.forces.sum((2, 3), dtype=float) - data.totals(rows)) <= found.half_widths

    assert (held(size_on).mean(axis=0) >= 0.89).all()
    rows = data.splits["test_unseen_sensor"]
    others = ~np.isin(press_keys(data, rows), model.metadata["intervals"]["presses"])
    assert others.any()
    judged = replace(data, splits={"train": data.splits["train"], "test_unseen_sensor": rows})
    split = evaluate(judged, model, EVALUATE)[0]["splits"]["test_unseen_sensor"]
    assert list(split["held"].values()) == pytest.approx(held(rows)[others].mean(axis=0).tolist())


def test_groups_of_presses_stay_where_they_are_alone_and_joined(seen_by_three):
    """Presses of two datasets together chose what was then measured by 15 of 20 of them."""
    own = seen_by_three
    other = replace(own, info=own.info | {"name": "other"}, table=[
        replace(one, press=replace(one.press, x0_mm=one.press.x0_mm + 50.0, sample_id=f"q{at}")) for at, one in enumerate(own.table)
    ])  # fmt: skip
    alone, both = groups_of(own, own), groups_of(own, concatenate(own, [other]))
    assert np.array_equal(alone.calibrate, both.calibrate)
    assert np.array_equal(alone.choose, both.choose[both.choose < len(own.table)])
    joined = concatenate(own, [other])
    used = press_keys(joined, np.concatenate([both.train, both.choose]))
    assert not np.isin(press_keys(joined, both.calibrate), used).any()


def test_a_press_that_the_start_of_a_network_learnt_from_is_not_tested(seen_by_three, learnt):
    """A fine-tuned network is judged on presses that neither it nor the network that it began as has learnt from."""
    data = seen_by_three
    swapped = replace(data, splits=data.splits | {"train": data.splits["test"], "test": data.splits["train"]})
    further = train(
        swapped, "pair", MODELS["pair"], with_values(SETTINGS, epochs=1), start=Start(learnt.net, learnt.metadata)
    )
    known = known_rows(further.model, data)
    assert known[data.splits["train"]].all() and known[data.splits["test"]].all()
    assert "test" not in evaluate(swapped, further.model, EVALUATE)[0]["splits"]


def test_a_fine_tuned_network_keeps_what_widens_the_intervals_of_its_start_on_real_sensors(seen_by_three, learnt):
    """Only sideways intervals grow, by the fraction of the force's magnitude in quadrature."""
    data, real = seen_by_three, {"unprofiled": 0.0, "profiled": 0.0, "sideways": 0.2}
    wider = learnt.metadata | {"intervals": learnt.metadata["intervals"] | {"real": real}}
    groups, force = groups_of(data, data), np.array([0.0, 3.0, -4.0])
    own, kept = (intervals_of(learnt.model, data, groups, start) for start in (learnt.metadata, wider))
    assert "real" not in own["intervals"] and kept["intervals"]["real"] == real
    fx, fy, fz = half_widths(kept, force) ** 2 - half_widths(own, force) ** 2
    assert (fx, fy, fz) == pytest.approx((1.0, 1.0, 0.0))
    further = train(data, "pair", MODELS["pair"], with_values(SETTINGS, epochs=1), start=Start(learnt.net, wider))
    assert further.metadata["intervals"]["real"] == real


def test_the_shipped_network_starts_with_the_intervals_of_its_model_file(shipped):
    """Its weights were written before real sensors were measured."""
    begun = shipped_start().metadata["intervals"]
    assert begun == shipped.metadata["intervals"]
    assert begun["real"]["sideways"] > 0.0
