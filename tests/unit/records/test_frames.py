"""Frames of one press: checked, kept together in shards and splits, carried into every file."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.flow.files import read_csv, write_csv
from gelforge.flow.layout import Layout
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.learning.split import group_presses, split_presses
from gelforge.mechanics.material import Material
from gelforge.mechanics.path.loadpath import frame_time
from gelforge.mechanics.scene import Scene
from gelforge.records import log
from gelforge.records.forcefile import ForceFile, SampleForces, write_forces
from gelforge.records.frames import NEAR_DEPTH_MM, NEAR_MM, check_frames, presses_of
from gelforge.records.labelfile import read_labels
from gelforge.records.press import COLUMNS, Press, parse
from gelforge.records.solvetable import Solved, read_solves, write_solves
from gelforge.records.status import Status
from gelforge.stages.plan import assign_shards, write_shards
from tests.support.press_records import log_line, press_record, write_lines
from tests.support.pressed_dataset import SETTINGS, collect, label, write_pressed

WITH_ID = (*COLUMNS, "press_id")


def frame(at: int, **cells):
    return press_record(row=at + 2, sample_id=f"f{at}", press_id=cells.pop("press_id", "p1"), **cells)


DOWN = [frame(0, dz_mm=-0.5), frame(1, dz_mm=-1.0), frame(2, dz_mm=-1.5)]
SPHERE = build("sphere_15", {"kind": "sphere", "diameter": 15, "height": 10})
ASIDE = [frame(3, dz_mm=-1.5, dx_mm=0.1, dy_mm=0.2), frame(4, dz_mm=-1.5, dx_mm=0.2, dy_mm=0.4)]


def test_a_press_goes_down_and_then_sideways():
    assert check_frames(DOWN + ASIDE, "log.csv") == []


def test_a_row_that_is_no_later_moment_is_rejected_alone():
    for column, frames, said in (
        ("indenter", [*DOWN, frame(3, dz_mm=-1.8, indenter="bar_5")], "differs"),
        ("sensor_id", [*DOWN, frame(3, dz_mm=-1.8, sensor_id="other")], "differs"),
        ("gel_id", [*DOWN, frame(3, dz_mm=-1.8, gel_id="other")], "differs"),
        ("mounting", [*DOWN, frame(3, dz_mm=-1.8, mounting="again")], "differs"),
        ("x0_mm", [*DOWN, frame(3, dz_mm=-1.8, x0_mm=0.5)], "differs"),
        ("rot_deg", [*DOWN, frame(3, dz_mm=-1.8, rot_deg=10.0)], "differs"),
        (
            "time_utc",
            [frame(0, time_utc="2026-01-01T10:00:01Z"), frame(1, dz_mm=-1.2, time_utc="2026-01-01T10:00:00Z")],
            "earlier",
        ),
        ("dz_mm", [*DOWN, frame(3, dz_mm=-1.2)], "rises"),
        ("dz_mm", [*DOWN, frame(3, dz_mm=-1.5)], "same point"),
        ("dz_mm", [*DOWN, *ASIDE, frame(5, dz_mm=-1.9, dx_mm=0.3, dy_mm=0.6)], "deeper after"),
        ("dy_mm", [*DOWN, *ASIDE, frame(5, dz_mm=-1.5, dx_mm=0.15, dy_mm=0.3)], "goes back"),
        # farther away than before, on the other side of where the press went down
        ("dy_mm", [*DOWN, *ASIDE, frame(5, dz_mm=-1.5, dx_mm=-0.3, dy_mm=-0.6)], "goes back"),
        ("dy_mm", [*DOWN, *ASIDE, frame(5, dz_mm=-1.5, dx_mm=0.6, dy_mm=-0.8)], "goes back"),
        ("dx_mm", [*DOWN, *ASIDE, frame(5, dz_mm=-1.5, dx_mm=0.8, dy_mm=0.3)], "leaves the line"),
    ):
        wrong = check_frames(frames, "log.csv")
        assert [(r.row, r.column) for r in wrong] == [(frames[-1].row, column)], said
        assert said in wrong[0].reason and f"row {frames[-2].row}" in wrong[0].hint


def test_times_of_several_zones_are_compared_as_times():
    for before, now, earlier in (
        ("2026-01-01T10:00:00Z", "2026-01-01T13:00:01+03:00", False),
        ("2026-01-01T13:00:00+03:00", "2026-01-01T10:00:01", False),
        ("2026-01-01T10:00:00", "2026-01-01T10:00:01Z", False),
        ("2026-01-01T13:00:01+03:00", "2026-01-01T10:00:00Z", True),
        ("2026-01-01T10:00:01", "2026-01-01T13:00:00+03:00", True),
        ("2026-01-01T13:00:01+03:00", "2026-01-01T10:00:00", True),
    ):
        wrong = check_frames([frame(0, time_utc=before), frame(1, dz_mm=-1.2, time_utc=now)], "log.csv")
        assert [rejected.column for rejected in wrong] == ["time_utc"] * earlier, (before, now)


def test_rows_without_press_id_are_never_held_against_each_other():
    alone = [replace(each, press_id="") for each in (*ASIDE, *DOWN)]
    assert check_frames(alone, "log.csv") == [] and len(presses_of(alone)) == 5


def test_axes_read_while_they_move_may_shake():
    shaking = [replace(each, x0_mm=0.004 * (-1) ** k, dz_mm=each.dz_mm + 0.003 * k) for k, each in enumerate(ASIDE)]
    assert check_frames(DOWN + shaking, "log.csv") == []


@given(
    st.lists(st.floats(0.05, 1.0), min_size=1, max_size=5), st.lists(st.floats(0.05, 0.5), max_size=5),
    st.floats(0, 6.28), st.randoms(use_true_random=False),
)  # fmt: skip
def test_every_path_down_and_sideways_is_one_press_and_its_reverse_is_not(down, aside, angle, shuffle):
    steps = [(depth, 0.0) for depth in np.cumsum(down)] + [(sum(down), way) for way in np.cumsum(aside)]
    path = [frame(k, dz_mm=-depth, dx_mm=way * np.cos(angle), dy_mm=way * np.sin(angle))
            for k, (depth, way) in enumerate(steps)]  # fmt: skip
    assert check_frames(path, "log.csv") == []
    assert len(check_frames(path[::-1], "log.csv")) == len(path) - 1
    # presses of a log may be mixed: each is judged by its own rows
    other = [replace(each, press_id="p2", x0_mm=3.0) for each in path]
    mixed = [each for pair in zip(path, other, strict=True) for each in pair]
    assert check_frames(mixed, "log.csv") == []


def filmed(*ways):
    """Frames at points (dx, dy, dz) of one press."""
    return [frame(at, dx_mm=dx, dy_mm=dy, dz_mm=dz) for at, (dx, dy, dz) in enumerate(ways)]


@given(st.floats(0.001, 0.009), st.floats(0, 6.28))
@settings(max_examples=25)
@pytest.mark.parametrize("says", ["rises", "deeper after", "goes back", "leaves the line"])
def test_a_press_that_is_filmed_slowly_may_go_back_no_farther_than_any_other(says, step, angle):
    """Each step is too small to distinguish from the one before it; what they come to is not."""
    far, (x, y) = step * np.arange(1, 101), (np.cos(angle), np.sin(angle))
    begins, ways = {
        "rises": ((0, 0, -1), [(0, 0, -1 + rise) for rise in far]),
        "deeper after": ((0.3 * x, 0.3 * y, -1), [((0.3 + d) * x, (0.3 + d) * y, -1 - d) for d in far]),
        "goes back": ((x, y, -1), [((1 - back) * x, (1 - back) * y, -1) for back in far]),
        # a spiral, which leaves its line by less than a hundredth from frame to frame
        "leaves the line": (
            (x, y, -1),
            [((1 + d) * np.cos(angle + d), (1 + d) * np.sin(angle + d), -1) for d in far],
        ),
    }[says]
    near = NEAR_DEPTH_MM if says == "deeper after" else NEAR_MM
    wrong = check_frames(filmed(begins, *ways), "log.csv")
    assert len(wrong) >= (far > near + 0.02).sum() and {says in each.reason for each in wrong} <= {True}


@given(st.lists(st.tuples(*[st.floats(-0.02, 0.02)] * 3), max_size=40), st.floats(0, 0.5))
def test_frames_that_stand_are_moments_of_the_path_to_their_last(steps, aside):
    """What the log's check lets through no solver refuses."""
    frames = filmed(*(np.cumsum([(aside, 0, -1), *steps], axis=0)))
    lost = {wrong.row for wrong in check_frames(frames, "log.csv")}
    scenes = [
        Scene(Gel(), Material(), SPHERE, each.press) for each in frames if each.row not in lost and each.dz_mm < 0
    ]
    assert all(0.0 < frame_time(scene, scenes[-1]) <= 2.0 for scene in scenes)


def test_the_column_is_optional_and_read(tmp_path):
    lines = [log_line(WITH_ID, sample_id="a", press_id="p1"), log_line(WITH_ID, sample_id="b")]
    rows = log.read_log(write_lines(tmp_path / "log.csv", *lines, columns=WITH_ID))
    assert [parse(row, "log.csv")[0].press_id for row in rows] == ["p1", ""]
    rows = log.read_log(write_lines(tmp_path / "log.csv", log_line(sample_id="a")))
    assert parse(rows[0], "log.csv")[0].press_id == "" and "press_id" not in log.shard_text(rows)
    line = log_line(WITH_ID, press_id="a b")  # which is no name
    _, wrong = parse(log.read_log(write_lines(tmp_path / "log.csv", line, columns=WITH_ID))[0], "log.csv")
    assert [r.column for r in wrong] == ["press_id"]
    columns = (*COLUMNS, "mounting")
    again = write_lines(tmp_path / "mounted.csv", log_line(columns, mounting="gel 2"), columns=columns)
    assert [r.column for r in parse(log.read_log(again)[0], "log.csv")[1]] == ["mounting"]


@given(st.lists(st.integers(0, 6), min_size=1, max_size=60), st.integers(1, 5), st.integers(0, 60))
def test_frames_of_a_press_share_a_shard_and_keep_it(presses, size, first):
    ids = [f"s{k}" for k in range(len(presses))]
    press_of = {name: f"p{p}" for name, p in zip(ids, presses, strict=True) if p}
    early = assign_shards(ids[:first], {}, size, press_of)
    shards = assign_shards(ids, early, size, press_of)
    assert {name: shards[name] for name in ids[:first]} == early
    for press in set(press_of.values()):
        assert len({shards[name] for name in ids if press_of.get(name) == press}) == 1


@given(st.lists(st.integers(0, 6), min_size=1, max_size=60), st.integers(1, 5))
def test_samples_that_are_given_as_one_press_later_come_together(presses, size):
    """Those of no press stay where they were, and so do a press's first ones."""
    ids = [f"s{k}" for k in range(len(presses))]
    press_of = {name: f"p{p}" for name, p in zip(ids, presses, strict=True) if p}
    early = assign_shards(ids, {}, size)
    shards = assign_shards(ids, early, size, press_of)
    for press in set(press_of.values()):
        frames = [name for name in ids if press_of.get(name) == press]
        assert {shards[name] for name in frames} == {early[frames[0]]}
    assert all(shards[name] == early[name] for name in ids if name not in press_of)


def test_the_plan_keeps_frames_together(tmp_path):
    ids = ["a", "b", "a", "c", "a", "b"]
    lines = [log_line(WITH_ID, sample_id=f"s{k}", press_id=press) for k, press in enumerate(ids)]
    path = write_lines(tmp_path / "log.csv", *lines, columns=WITH_ID)
    of = Layout(tmp_path)
    names = write_shards(of, log.read_log(path), 2, {})
    held = [{row.cells["press_id"] for row in log.read_shard(of.shard(name))} for name in names]
    assert sum(map(len, held)) == 3


def test_no_press_is_on_two_sides_of_a_split():
    """Frames far apart, as of a bench that films a press whose place drifts, are still one press."""
    rng = np.random.default_rng(3)
    presses = [press_record(sample_id=f"s{k}", press_id=f"p{k // 6}", x0_mm=rng.uniform(-9, 9), y0_mm=rng.uniform(-9, 9))
               for k in range(300)]  # fmt: skip
    split, group = split_presses(presses, set(), {}, SETTINGS)
    for k in range(0, 300, 6):
        assert len(set(split[k : k + 6])) == len(set(group[k : k + 6])) == 1
    assert {"train", "val", "test"} <= set(split)
    assert len(set(group_presses([replace(p, press_id="") for p in presses], 1e-6, 1e-6, {}))) == 300


def test_files_carry_the_press(tmp_path):
    solves = [Solved("a", Status.OK, "", "hex", "m", "f", (0.0, 0.1, -1.0), {"seconds": 1.5}, "p1"),
              Solved("b", Status.DIVERGED, "why", "hex", "m", "", (np.nan, 0.0, 0.0), {}, "")]  # fmt: skip
    write_solves(tmp_path / "fea.csv", solves)
    back = read_solves(tmp_path / "fea.csv")
    assert [(s.sample_id, s.status, s.press_id) for s in back] == [("a", Status.OK, "p1"), ("b", Status.DIVERGED, "")]
    write_solves(tmp_path / "plain.csv", [replace(solves[0], press_id="")])
    assert "press_id" not in read_csv(tmp_path / "plain.csv")[0]
    write_forces(tmp_path / "f.npz", [SampleForces.failed("a", "DIVERGED", "m", "p1")], 0.07)
    with ForceFile(tmp_path / "f.npz") as forces:
        assert forces.press_id.tolist() == ["p1"]


def test_labels_and_dataset_carry_the_press(tmp_path):
    made = write_pressed(tmp_path, count=24)
    # give the force files and pose tables of stages 10 and 40 presses of six frames
    for shard in ("0000", "0001", "0002"):
        table = made["results"] / "10_poses" / f"{shard}.csv"
        rows = read_csv(table)
        for row in rows:
            row["press_id"] = f"p{int(row['sample_id'][1:]) // 6}"
        write_csv(table, list(rows[0]), rows)
        path = made["results"] / "40_forces" / f"{shard}.npz"
        with np.load(path) as file:
            arrays = dict(file)
        np.savez(path, **arrays, press_id=np.array([row["press_id"] for row in rows]))
    folder = label(made, "6x8")
    assert read_labels(folder / "0001.npz").press_id.tolist() == ["p1"] * 4 + ["p2"] * 4
    rows = read_csv(collect(made, "6x8") / "samples.csv")
    by_press = {}
    for row in rows:
        assert row["press_id"] == f"p{int(row['sample_id'][1:]) // 6}"
        by_press.setdefault((row["press_id"], row["indenter"] == "triangle_8"), set()).add(row["split"])
    assert all(len(splits) == 1 for splits in by_press.values())


def test_the_straight_press_to_a_sheared_pose_ends_there():
    press = Press(1.0, -2.0, 0.1, 0.3, -0.4, -0.8, 30.0)
    straight = press.straight_there
    for one, other in zip(press.pose(1.0, 1.0), straight.pose(1.0, 0.0), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    assert straight.end == 1.0 and press.end == 2.0
