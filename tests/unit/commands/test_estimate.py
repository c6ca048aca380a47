"""An estimate adds up, and its pilots stand for all presses."""

import os
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelforge.commands import estimate
from gelforge.commands.estimate import (
    Pace,
    image_bytes,
    later_costs,
    on_hexahedra,
    pilot_presses,
    training,
    with_stiffness,
)
from gelforge.flow.files import read_json, write_csv, write_json, write_text
from gelforge.flow.forecast import Cost, on_cores, pilots, presses_an_hour, size, table, wall_seconds
from gelforge.flow.layout import Layout
from gelforge.flow.params import plain
from gelforge.records.log import shard_text
from gelforge.records.press import COLUMNS, RawRow
from gelforge.records.solvetable import Solved, write_solves
from gelforge.records.status import Status
from tests.support.parameters import parameters, stage_of
from tests.support.refused import refused
from tests.support.synthetic_presses import write_dataset

ROWS = [RawRow(n, {"sensor_id": "mini_a", "fz_n": "-3.1"}) for n in range(900)]
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
    assert on_cores(1) == "on 1 core like this one" and on_cores(2) == "on 2 cores like these"


@given(st.floats(0, 9e17))
def test_a_size_is_reported_in_the_unit_of_its_three_digits(count):
    number, unit = size(count).split()
    reported = float(number) * 1000 ** ["B", "kB", "MB", "GB", "TB", "PB"].index(unit)
    assert reported == pytest.approx(count, rel=0.0051) or count < 1  # three digits
    assert "e" not in number or float(number) < 1
    assert [size(n) for n in (1e3, 999.6, 999_600, 1e9)] == ["1 kB", "1 kB", "1 MB", "1 GB"]  # not 1e+03 kB


def test_presses_an_hour_fall_with_what_each_takes_and_rise_with_the_cores():
    """What is spent once, or after the label, has no part in it."""
    costs = [Cost("30_fea", 3.0, 100.0), Cost("50_labels", 1.0), Cost("70_train", 50.0)]
    assert presses_an_hour(costs, 2) == 2 * 900.0
    assert presses_an_hour([*costs, Cost("10_poses", 4.0)], 2) == 900.0
    assert presses_an_hour([], 1) == float("inf")
    # a calibration fills the cores, whatever the number of shards
    assert wall_seconds([Cost("calibrate", cpu_once=100.0)], 5, 4, 1) == 25.0


def test_a_network_that_is_trained_is_counted_by_its_kind(tmp_path, root):
    """The shipped network learns nothing; a U-net takes several times a light network's time."""
    results = Layout(tmp_path)
    params = results.params
    write_json(params / "sensors.json", {})
    write_json(params / "poses.json", {"version": 1, "poses": plain(parameters().poses)})
    models = tomllib.loads((root / "workflow/models.toml").read_text(encoding="utf-8"))
    for name in ("grid_16", "unet", "pair_24_mirrored"):
        write_json(params / "models" / f"{name}.json", {name: models[name]})
    write_json(params / "train.json", {"version": 1, "train": plain(stage_of("train").train)})
    write_json(params / "report.json", {"version": 1, "report": plain(parameters().report) | {"branches": []}})
    costs = {
        name: {c.stage: c for c in later_costs(results, "24x32", name, ROWS)}
        for name in ("shipped", "grid_16", "unet")
    }
    assert "70_train" not in costs["shipped"]
    light, heavy = (costs[name]["70_train"].cpu_each for name in ("grid_16", "unet"))
    epochs = stage_of("train").train
    assert heavy / (epochs.epochs_of.unet or epochs.epochs) > 2 * light / epochs.epochs


def lay(folder, images=True):
    """A plan whose report shows the branch calibrate."""
    results = Layout(folder)
    branches = plain(parameters().report) | {"branches": ["calibrate"]}
    write_json(results.params / "sensors.json", {})
    write_json(results.params / "report.json", {"version": 1, "report": branches})
    write_json(results.params / "poses.json", {"version": 1, "poses": plain(parameters().poses) | {"images": images}})
    for name in ("calibrate",):
        write_json(results.params / f"{name}.json", {"version": 1} | plain(stage_of(name)))
    return results


def test_what_the_log_cannot_feed_is_not_counted(tmp_path):
    for images, reading, counted in (
        (False, "-3.1", ["calibrate"]),
        (False, "", []),
        (True, "", ["60_dataset", "80_evaluate", "90_report"]),
        (True, "-3.1", ["60_dataset", "80_evaluate", "calibrate", "90_report"]),
    ):
        rows = [RawRow(2, {"sensor_id": "mini_a"}), RawRow(3, {"sensor_id": "mini_a", "fz_n": reading})]
        costs = later_costs(lay(tmp_path, images), "24x32", "shipped", rows)
        assert [cost.stage for cost in costs] == counted


def test_what_the_pilots_do_not_run_is_counted_at_their_pace(tmp_path):
    """Whatever the machine: solves of a calibration are as slow as the pilots' own."""
    results = lay(tmp_path)
    quick, slow = (later_costs(results, "24x32", "shipped", ROWS, pace) for pace in (Pace(0.4, 2.0), Pace(1.2, 6.0)))
    assert [cost.cpu(0) for cost in slow] == pytest.approx([3 * cost.cpu(0) for cost in quick]) and len(quick) == 4


def test_of_a_press_by_calculix_the_part_on_hexahedra_counts(tmp_path):
    def solved(name, seconds, kinematics):
        evidence = {"seconds": seconds, "kinematics_seconds": kinematics}
        return Solved(name, Status.OK, "", "ccx", "", "", (0.0, 0.0, -1.0), evidence)

    write_solves(tmp_path / "0.csv", [solved("a", 4.0, 1.0), solved("b", 1.0, "")])
    assert on_hexahedra(tmp_path / "0.csv") == pytest.approx(0.4)
    write_solves(tmp_path / "1.csv", [solved("a", "", "")])
    assert on_hexahedra(tmp_path / "1.csv") == 1.0


def test_pictures_count_by_the_size_that_their_sensor_takes(tmp_path, root):
    results = Layout(tmp_path)
    sensors = tomllib.loads((root / "workflow/sensors.toml").read_text(encoding="utf-8"))
    named = {
        name: sensors["mini_a"] | {"image": size} for name, size in (("mini_a", [320, 240]), ("own", [640, 480]))
    }
    write_json(results.params / "sensors.json", named)
    of = {name: image_bytes(results, [RawRow(1, {"sensor_id": name})]) for name in (*named, "unknown")}
    assert of == {"mini_a": 320 * 240 * 3, "own": 640 * 480 * 3, "unknown": 0}


def test_an_epoch_of_a_part_of_the_presses_costs_that_part(tmp_path):
    """Where epochs visit fewer presses than there are; where they would visit more, they visit all."""
    train = plain(stage_of("train").train)
    cpu = {}
    for images in (0, 300, 1200):
        results = Layout(tmp_path / str(images))
        params = results.params
        write_json(params / "models" / "net.json", {"net": {"kind": "unet", "widths": [4, 8]}})
        write_json(params / "train.json", {"version": 1, "train": train | {"epoch_images": images}})
        (params / "models" / ".net.4711.part.json").write_text('{"net": {"ki')  # left by a plan that was killed
        cpu[images] = training(results, "24x32", "net", 900).cpu_each
    assert cpu[300] == pytest.approx(cpu[0] / 3)
    assert cpu[1200] == cpu[0]


def test_a_network_or_a_resolution_that_there_is_not_is_named(tmp_path):
    params = lay(tmp_path).params
    write_json(params / "train.json", {"version": 1, "train": plain(stage_of("train").train)})
    refused("MODEL=grid16", training, Layout(tmp_path), "24x32", "grid16", 900)
    write_json(params / "models" / "net.json", {"net": {"kind": "transformer"}})
    refused("'transformer': use one of grid", training, Layout(tmp_path), "24x32", "net", 900)
    for resolution in ("24", "24x", "fine", "24x32x3"):
        refused("write ROWSxCOLS", later_costs, Layout(tmp_path), resolution, "shipped", ROWS)


def test_presses_of_other_datasets_cost_what_its_own_do(tmp_path):
    """90 presses and 45 of [train] also take as long as 135; a dataset that is not made yet is named."""
    results, alone = Layout(tmp_path / "one"), plain(stage_of("train").train)
    write_json(results.params / "models" / "net.json", {"net": {"kind": "unet"}})

    def cost(presses, also):
        write_json(results.params / "train.json", {"version": 1, "train": alone | {"also": also}})
        return training(results, "24x32", "net", presses).cpu(presses)

    refused("make dataset DATASET=other RES=24x32 first", cost, 90, ["other"])
    write_dataset(Layout(tmp_path / "other").dataset("24x32"), n=45, image=(24, 32), grid=(6, 8))
    assert cost(90, ["other"]) == pytest.approx(cost(135, []))


def test_pilots_need_no_posterior(tmp_path):
    """c10 = "calibrated" is found by the very run that is estimated."""
    work = Layout(tmp_path)
    table = {"version": 1, "forces": {}, "material": {"c10": "calibrated", "nu": 0.475}}
    write_json(work.parameters("forces"), table)
    with_stiffness(work)
    made = read_json(work.parameters("forces"))
    assert made["material"]["nu"] == 0.475 and isinstance(made["material"]["c10"], float)


def filmed(presses: int, frames: int) -> list[RawRow]:
    """Rows of presses that end one deeper than the other, shuffled, each seen at frames of equal steps."""
    rows = [
        RawRow(row, {"press_id": f"p{press}", "dz_mm": f"{-(press + 1) / presses * (frame + 1) / frames}"})
        for row, (press, frame) in enumerate((p, f) for p in range(presses) for f in range(frames))
    ]
    return [rows[k] for k in np.random.default_rng(2).permutation(len(rows))]


def test_pilots_of_a_film_are_whole_presses_of_every_depth():
    chosen = pilot_presses(filmed(20, 6))
    assert [len(press) for press in chosen] == [6] * 5
    ids = [{row.cells["press_id"] for row in press} for press in chosen]
    assert ids == [{f"p{n}"} for n in (2, 6, 10, 14, 18)]
    alone = [RawRow(n, {"dz_mm": f"-0.{n}", **press}) for n in range(1, 10) for press in ({}, {"press_id": ""})]
    assert [len(press) for press in pilot_presses(alone)] == [1] * 5


def test_rows_that_were_or_will_be_rejected_are_not_counted(tmp_path):
    """A row of the log whose depth is no number, and one whose image stage 10 refused, cost no solve."""
    of, good = (
        Layout(tmp_path / "results/d"),
        dict.fromkeys(COLUMNS, "0") | {"sensor_id": "mini_a", "indenter": "ball", "dz_mm": "-0.5"},
    )
    rows = [RawRow(k + 2, good | {"sample_id": f"s{k}"}) for k in range(4)]
    rows[1].cells["dz_mm"] = "deep"
    write_text(of.shard("0000"), shard_text(rows))
    assert [row.row for row in estimate.planned_rows(of.root)] == [2, 4, 5]
    write_csv(of.rejected("0000"), ["row", "column"], [{"row": 4, "column": "image"}])
    assert [row.row for row in estimate.planned_rows(of.root)] == [2, 5]
    os.utime(of.rejected("0000"), (1e9, 1e9))  # of other rows
    assert [row.row for row in estimate.planned_rows(of.root)] == [2, 4, 5]
