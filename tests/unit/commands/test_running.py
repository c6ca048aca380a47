"""The line over a run counts shards on disk and names what holds a lock."""

import fcntl
import os
import time
from contextlib import contextmanager

from gelforge.commands.status import cost_lines, running_lines
from gelforge.flow.files import write_json, write_text
from gelforge.flow.ledger import last_runs
from gelforge.flow.running import Progress, duration, look


def dated(path, at):
    """A file that was written at a time; its folder too, where there is none."""
    write_text(path, "")
    os.utime(path, (at, at))


def lay(results, solved=0):
    """Four planned shards with their poses, so many of them solved, one in ten seconds until now."""
    now = time.time()
    for k in range(4):
        dated(results / f"00_plan/shards/{k:04d}.csv", now - 200)
        dated(results / f"10_poses/{k:04d}.csv", now - 100)
    for k in range(solved):
        dated(results / f"30_fea/{k:04d}.csv", now - 60)
        dated(results / f"metrics/30_fea/{k:04d}.json", now - 10 * (solved - k))
    return now


@contextmanager
def at_work(results, target):
    """While a step holds the lock of a target."""
    lock = results / f"logs/{target}.lock"
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield


def test_shards_of_the_latest_stage_that_runs_count(tmp_path):
    now = lay(tmp_path, 2)
    with at_work(tmp_path, "30_fea/0002"), at_work(tmp_path, "10_poses/0003"):
        state = look(tmp_path, now)
    assert (state.stage, state.done, state.total) == ("30_fea", 2, 4)
    assert sorted(state.running) == ["10_poses/0003", "30_fea/0002"]
    assert str(state).startswith("30_fea: 2 of 4 shards, 20 s left; now: ")
    assert str(look(tmp_path, now, "10_poses")) == "10_poses: 4 of 4 shards"
    assert str(look(tmp_path, now, "40_forces")) == "40_forces: 0 of 4 shards"


def test_what_older_parameters_or_rows_made_is_still_to_come(tmp_path):
    """After a changed parameter the first finished shard said that all is solved, and no time left."""
    now = lay(tmp_path, 4)
    assert look(tmp_path, now, "30_fea").done == 4
    dated(tmp_path / "10_poses/0001.csv", now)
    assert look(tmp_path, now, "30_fea").done == 3
    dated(tmp_path / "00_plan/params/fea.json", now + 10)
    assert look(tmp_path, now, "30_fea").done == 0
    dated(tmp_path / "30_fea/0000.csv", now + 20)
    assert look(tmp_path, now, "30_fea").done == 1


def test_other_stages_are_named_and_not_counted(tmp_path):
    now = lay(tmp_path, 4)
    with at_work(tmp_path, "80_evaluate/24x32/pair_8.card"):
        assert str(look(tmp_path, now)) == "now: 80_evaluate/24x32/pair_8.card"
        # of the evaluation, not of its card
        dated(tmp_path / "metrics/80_evaluate/24x32/pair_8.json", now + 9)
        assert look(tmp_path, now).running == ["80_evaluate/24x32/pair_8.card"]
        dated(tmp_path / "metrics/80_evaluate/24x32/pair_8.card.json", now + 9)
    assert str(look(tmp_path, now, "80_evaluate")) == "" and running_lines(tmp_path) == []


def test_what_nobody_holds_or_is_being_written_does_not_count(tmp_path):
    """Nor a shard that another make takes away between two looks."""
    now = lay(tmp_path, 3)
    (tmp_path / "logs/30_fea").mkdir(parents=True)
    (tmp_path / "logs/30_fea/0000.lock").touch()
    for name in ("30_fea/.0003.17.part.csv", "metrics/30_fea/.0000.17.part.json", "00_plan/shards/.0007.1.part.csv"):
        write_text(tmp_path / name, "{")
    (tmp_path / "00_plan/shards/0009.csv").symlink_to("gone.csv")
    assert look(tmp_path, now) == Progress("", 0, 0, None, [])
    state = look(tmp_path, now, "30_fea")
    assert (state.done, state.total) == (3, 5) and running_lines(tmp_path) == []
    assert look(tmp_path / "nothing") == Progress("", 0, 0, None, [])


def test_costs_add_up_by_stage(tmp_path):
    for shard, cpu in (("0000", 30.0), ("0001", 40.0)):
        write_json(tmp_path / f"metrics/30_fea/{shard}.json", {"cpu_seconds": cpu, "peak_mib": cpu})
    (tmp_path / "metrics/30_fea/0002.json").write_text("{")
    assert cost_lines(tmp_path, last_runs(tmp_path))[1].split() == ["30_fea", "70", "s", "40"]
    assert [duration(s) for s in (12.2, 125, 7200)] == ["12 s", "2 min", "2.0 h"]
