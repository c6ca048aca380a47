"""An estimate is there at once, follows the records of this machine, and grows with what it counts."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelforge.commands import estimate
from gelforge.commands.estimate import (
    DRAGGED,
    MEASURED,
    SLIPPING,
    START,
    estimated,
    press_seconds,
    size,
    training,
    weights,
)
from gelforge.flow import layout
from gelforge.flow.files import write_json, write_text
from gelforge.flow.layout import Layout
from gelforge.flow.params import plain
from gelforge.records.log import shard_text
from gelforge.records.press import COLUMNS, RawRow
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import Solved, write_solves
from gelforge.records.status import Status
from tests.support.parameters import parameters, stage_of
from tests.support.refused import refused
from tests.support.synthetic_presses import write_dataset

GOOD = dict.fromkeys(COLUMNS, "0") | {"sensor_id": "mini_a", "indenter": "ball", "dz_mm": "-0.5"}


def rows_of(count, **cells):
    return [RawRow(k + 2, GOOD | cells | {"sample_id": f"s{k}"}) for k in range(count)]


def lay(folder, rows, method="draft", images=True, law="no_slip"):
    """A plan of one shard whose report shows a calibration."""
    of = Layout(folder)
    write_text(of.shard("0000"), shard_text(rows))
    write_json(of.params / "sensors.json", {})
    fea = {"fea": plain(parameters().fea) | {"method": method}, "interface": {"law": law, "mu": 0.5}}
    write_json(of.params / "fea.json", {"version": 1} | fea)
    write_json(
        of.params / "report.json", {"version": 1, "report": plain(parameters().report) | {"branches": ["calibrate"]}}
    )
    write_json(of.params / "poses.json", {"version": 1, "poses": plain(parameters().poses) | {"images": images}})
    return of


def solved(of, seconds):
    """Stage 30 of the only shard was run and took this."""
    write_text(of.fea("0000"), "")
    write_json(layout.metrics_of(of.fea("0000")), {"cpu_seconds": seconds})


@given(st.floats(0, 9e17))
def test_a_size_is_reported_in_the_unit_of_its_three_digits(count):
    number, unit = size(count).split()
    reported = float(number) * 1000 ** ["B", "kB", "MB", "GB", "TB", "PB"].index(unit)
    assert reported == pytest.approx(count, rel=0.0051) or count < 1  # three digits
    assert "e" not in number or float(number) < 1
    assert [size(n) for n in (1e3, 999.6, 999_600, 1e9)] == ["1 kB", "1 kB", "1 MB", "1 GB"]  # not 1e+03 kB


@pytest.mark.parametrize("method", MEASURED)
def test_seconds_of_a_press_are_those_of_this_machine_with_the_same_method(tmp_path, method):
    of = lay(tmp_path / "results/mine", rows_of(4), method)
    assert press_seconds(of) == (MEASURED[method], "table")
    dragged = lay(tmp_path / "results/older", rows_of(10, dx_mm="0.4"), method)
    solved(dragged, 60.0)
    solved(lay(tmp_path / "results/another", rows_of(20), "other"), 900.0)
    slips = lay(tmp_path / "results/slips", rows_of(30), method, law="coulomb")
    assert press_seconds(slips) == (MEASURED[method] * SLIPPING[method], "table")
    solved(slips, 900.0)
    assert press_seconds(of) == (pytest.approx(6.0 / DRAGGED), "records of older")
    solved(of, 8.0)
    assert press_seconds(of) == (2.0, "records of mine")


def test_what_was_run_is_what_is_estimated(tmp_path):
    """Of a dataset that is made whole the estimate of its solves is what they took, however it is spread."""
    for rows in (rows_of(4), rows_of(2) + rows_of(3, dy_mm="-1.0")):
        of = lay(tmp_path / "results/mine", rows)
        solved(of, 50.0)
        (fea,) = (cost for cost in estimated(of, "24x32", "shipped", rows) if cost.stage == layout.FEA)
        assert (
            fea.cpu - START == pytest.approx(50.0)
            and weights(rows) == len(rows) + (DRAGGED - 1) * (len(rows) == 5) * 3
        )


def test_solves_that_came_from_the_store_cost_what_they_took_when_they_were_made(tmp_path):
    """A rerun of stage 30 that solved nothing takes seconds; what is new in it counts."""
    of = lay(tmp_path / "results/mine", rows_of(4))
    store = SolveStore(of.solves)
    for name, seconds in (("s0", 90.0), ("s1", 110.0)):
        store.publish(f"key-{name}", {"evidence": {"cpu_seconds": seconds}}, {})
    solves = [Solved(f"s{k}", Status.OK, "", "draft", "m", f"key-s{k}", (0.0, 0.0, -1.0), {}) for k in range(4)]
    for spent, expected in ((2.0, 200.0), (260.0, 260.0)):
        solved(of, spent)
        write_solves(of.fea("0000"), solves)
        assert press_seconds(of) == (pytest.approx(expected / 4), "records of mine")


def test_more_cores_divide_what_is_made_by_shards(tmp_path):
    of = lay(tmp_path / "results/d", rows_of(4))
    write_text(of.shard("0001"), shard_text(rows_of(2)))
    spread = {cost.stage for cost in estimated(of, "24x32", "shipped", rows_of(6), cores=2) if cost.cores == 2}
    assert set(layout.OF_SHARDS) <= spread and not spread & {layout.IMAGES, layout.DATASET, layout.REPORT}


def test_what_the_log_cannot_feed_is_not_counted(tmp_path):
    later = [layout.IMAGES, layout.DATASET, layout.EVALUATE, layout.REPORT]
    for images, reading, counted in (
        (False, "-3.1", [layout.CALIBRATE]),
        (False, "", []),
        (True, "", later),
        (True, "-3.1", [layout.CALIBRATE, *later]),
    ):
        rows = rows_of(2, fz_n=reading)
        costs = estimated(lay(tmp_path / "results/d", rows, images=images), "24x32", "shipped", rows)
        assert [cost.stage for cost in costs][4:] == counted


def test_rows_that_will_be_rejected_are_not_counted_and_none_is_refused(tmp_path, monkeypatch):
    rows = rows_of(3)
    rows[1].cells["dz_mm"] = "deep"
    assert [row.row for row in estimate.planned_rows(lay(tmp_path / "results/d", rows))] == [2, 4]
    lay(tmp_path / "results/d", rows[1:2])
    refused("no row is left", estimate.main, [str(tmp_path / "results/d")])


def test_a_training_is_counted_by_its_images_and_epochs(tmp_path, root):
    of = lay(tmp_path / "results/d", rows_of(1))
    models = tomllib.loads((root / "workflow/models.toml").read_text(encoding="utf-8"))
    write_json(of.params / "models/unet.json", {"unet": models["unet"]})
    write_json(of.params / "train.json", {"version": 1, "train": plain(stage_of("train").train)})
    once, twice = (training(of, "24x32", "unet", count).cpu - START for count in (100, 200))
    assert twice == pytest.approx(2 * once) and once > 0.0
    write_json(
        of.params / "train.json", {"version": 1, "train": plain(stage_of("train").train) | {"also": ["other"]}}
    )
    write_dataset(Layout(of.root.parent / "other").dataset("24x32"), n=45, image=(24, 32), grid=(6, 8))
    assert training(of, "24x32", "unet", 55).cpu - START == pytest.approx(once)
    refused("no-such", training, of, "24x32", "no-such", 100)


def test_a_press_that_is_dragged_costs_as_much_whichever_way():
    ways = [{"dx_mm": "0.3"}, {"dx_mm": "-0.3"}, {"dy_mm": "0.3"}, {"dx_mm": "0.1", "dy_mm": "-0.2"}]
    straight = weights(rows_of(4))
    assert straight == 4.0 and {weights(rows_of(4, **way)) for way in ways} == {DRAGGED * straight}
