"""The line over a run counts what is on disk and names what holds a lock."""

import fcntl
import os
import time
from contextlib import contextmanager

from gelforge.commands.status import cost_lines, running_lines
from gelforge.flow.files import write_csv, write_json, write_text
from gelforge.flow.layout import Layout
from gelforge.flow.ledger import last_runs
from gelforge.flow.running import Progress, duration, look


def lay(results, solved):
    """Eight planned presses in two shards, so many of the first one solved, one a second until now."""
    rows = [{"sample_id": f"s{k}", "shard": k // 4} for k in range(8)]
    write_csv(results / "00_plan/shards.csv", ["sample_id", "shard"], rows)
    for shard in ("0000", "0001"):
        write_csv(
            results / f"00_plan/shards/{shard}.csv",
            ["sample_id", "shard"],
            [r for r in rows if r["shard"] == int(shard)],
        )
    now = time.time()
    for k in range(solved):
        path = results / f"30_fea/{k // 4:04d}/s{k}.json"
        write_json(path, {})
        os.utime(path, (now - (solved - k), now - (solved - k)))
    return now


@contextmanager
def at_work(results, target):
    """While a step holds the lock of a target."""
    lock = results / f"logs/{target}.lock"
    lock.parent.mkdir(parents=True)
    with lock.open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield


def test_presses_of_a_shard_that_is_being_solved_count(tmp_path):
    now = lay(tmp_path, 3)
    with at_work(tmp_path, "30_fea/0000"):
        state = look(tmp_path, now)
    assert (state.done, state.total, state.running, state.stage) == (3, 8, ["30_fea/0000"], "30_fea")
    assert abs(state.rate - 1.0) < 0.05
    assert "3 of 8 presses solved" in str(state) and "5 s left" in str(state) and "30_fea/0000" in str(state)


def rewrite(path, text):
    """Another text of the same length in a table whose time stays."""
    state = path.stat()
    assert len(text) == state.st_size
    path.write_text(text)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def test_a_table_is_read_once_and_again_when_it_changed(tmp_path):
    """A step that looks each second, and each step that ends, read the tables of all shards: thousands of thousands."""
    now = lay(tmp_path, 0)
    table, rejected = tmp_path / "00_plan/shards/0000.csv", tmp_path / "10_poses/0001.rejected.csv"
    write_text(rejected, "row,why\n1,a\n1,b\n2,c\n")
    assert (look(tmp_path, now).total, look(tmp_path, now).rejected) == (6, 2)
    rewrite(table, "x" * table.stat().st_size)  # were it read it would hold no row
    rewrite(rejected, "x" * rejected.stat().st_size)
    assert (look(tmp_path, now).total, look(tmp_path, now).rejected) == (6, 2)
    write_text(rejected, "row,why\n3,a\n")
    assert (look(tmp_path, now).total, look(tmp_path, now).rejected) == (7, 1)
    write_text(table, "sample_id,shard\ns0,0\n")
    assert look(tmp_path, now).total == 4
    rejected.unlink()
    assert look(tmp_path, now).total == 5
    table.unlink()
    assert look(tmp_path, now).total == 4


def test_kept_counts_that_were_corrupted_are_counted_again(tmp_path):
    now = lay(tmp_path, 0)
    assert look(tmp_path, now).total == 8
    kept = Layout(tmp_path).counts
    for text in ("", "[]", '{"a": 1}', "{", "null"):
        kept.write_text(text.replace("a", str(tmp_path / "00_plan/shards/0000.csv")))
        assert look(tmp_path, now).total == 8 and "0001.csv" in kept.read_text()


def test_a_folder_that_takes_no_file_is_looked_at_all_the_same(tmp_path):
    now = lay(tmp_path, 0)
    write_text(tmp_path / "logs", "")  # where the folder of logs would be
    assert look(tmp_path, now).total == 8


def test_what_older_parameters_solved_is_still_to_come(tmp_path):
    """After a changed parameter the first finished shard said that all is solved, and no rate and time left."""
    now = lay(tmp_path, 8)
    for shard in ("0000", "0001"):
        write_csv(tmp_path / f"30_fea/{shard}.csv", ["sample_id"], [])
    assert look(tmp_path, now).done == 8
    write_json(tmp_path / "00_plan/params/fea.json", {})
    os.utime(tmp_path / "00_plan/params/fea.json", (now + 10, now + 10))
    for path in (tmp_path / "30_fea/0000/s0.json", tmp_path / "30_fea/0000/s1.json"):
        os.utime(path, (now + 12, now + 12))
    state = look(tmp_path, now + 16)
    assert (
        (state.done, state.rate) == (2, 0.5) and "2 of 8 presses solved" in state.pace and "12 s left" in state.pace
    )
    os.utime(tmp_path / "30_fea/0000.csv", (now + 17, now + 17))
    assert look(tmp_path, now + 18).done == 4
    os.utime(tmp_path / "30_fea/0001.csv", (now + 17, now + 17))
    write_text(tmp_path / "20_meshes/ccx.npz", "")  # made for another shard's press
    os.utime(tmp_path / "20_meshes/ccx.npz", (now + 20, now + 20))
    assert look(tmp_path, now + 21).done == 8
    write_text(tmp_path / "20_meshes/0000.csv", "")
    os.utime(tmp_path / "20_meshes/0000.csv", (now + 20, now + 20))
    assert look(tmp_path, now + 21).done == 4


def test_of_stages_after_the_solves_their_count_is_not_reported(tmp_path):
    now = lay(tmp_path, 8)
    with at_work(tmp_path, "80_evaluate/24x32/pair_8.card"):
        assert str(look(tmp_path, now)) == "now: 80_evaluate/24x32/pair_8.card"
        write_json(tmp_path / "metrics/80_evaluate/24x32/pair_8.json", {})  # of the evaluation, not of its card
        os.utime(tmp_path / "metrics/80_evaluate/24x32/pair_8.json", (now + 9, now + 9))
        assert look(tmp_path, now).running == ["80_evaluate/24x32/pair_8.card"]
        write_json(tmp_path / "metrics/80_evaluate/24x32/pair_8.card.json", {})
        os.utime(tmp_path / "metrics/80_evaluate/24x32/pair_8.card.json", (now + 9, now + 9))
    assert [str(look(tmp_path, now, stage)) for stage in ("80_evaluate", "30_fea")] == ["", "8 of 8 presses solved"]


def test_a_stage_reports_its_own_number(tmp_path):
    """Poses and meshes of no press that was solved said "0 of 8 presses solved"."""
    now = lay(tmp_path, 0)
    write_csv(tmp_path / "10_poses/0000.rejected.csv", ["row", "column"], [{"row": 2, "column": "image"}])
    said = {stage: str(look(tmp_path, now, stage)) for stage in ("10_poses", "20_meshes", "40_forces")}
    assert said == {"10_poses": "0 of 8 rows accepted", "20_meshes": "0 of 7 presses meshed", "40_forces": ""}
    write_text(tmp_path / "10_poses/0000.csv", "")
    assert str(look(tmp_path, now, "10_poses")) == "3 of 8 rows accepted"
    for made in ("10_poses/0001.csv", "20_meshes/0000.csv"):
        write_text(tmp_path / made, "")
    assert [str(look(tmp_path, now, s)) for s in said] == ["7 of 8 rows accepted", "3 of 7 presses meshed", ""]
    with at_work(tmp_path, "10_poses/0001"):  # alone: the next stage waits
        assert str(look(tmp_path, now)) == "10_poses: 7 of 8 rows accepted; now: 10_poses/0001"
    write_json(tmp_path / "00_plan/params/poses.json", {})
    os.utime(tmp_path / "00_plan/params/poses.json", (now + 10, now + 10))
    assert str(look(tmp_path, now, "10_poses")) == "0 of 8 rows accepted"


def test_a_lock_that_nobody_holds_is_not_running(tmp_path):
    lay(tmp_path, 8)
    for shard in ("0000", "0001"):
        write_csv(tmp_path / f"30_fea/{shard}.csv", ["sample_id"], [])
    lock = tmp_path / "logs/30_fea/0000.lock"
    lock.parent.mkdir(parents=True)
    lock.touch()
    state = look(tmp_path)
    assert state.running == [] and state.done == state.total == 8 and running_lines(tmp_path) == []


def test_files_that_are_being_written_do_not_count(tmp_path):
    """A look at a run never meets a file that goes while it looks, nor counts one that a killed writer left."""
    now = lay(tmp_path, 3)
    for name in ("30_fea/0000/.s3.17.part.json", "metrics/30_fea/.0000.17.part.json"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("{")
    assert look(tmp_path, now).done == 3
    assert running_lines(tmp_path) == [] and cost_lines(last_runs(tmp_path)) == []


def test_a_shard_that_goes_between_two_looks_is_none(tmp_path):
    """Another make plans a log that lost rows; a step that printed how far its run has come failed its finished target."""
    now = lay(tmp_path, 3)
    (tmp_path / "00_plan/shards/0002.csv").symlink_to("gone.csv")  # listed, and not there when it is read
    assert look(tmp_path, now).total == 8


def test_nothing_planned_is_nothing(tmp_path):
    assert look(tmp_path) == Progress(0, 0, 0.0, [])


def test_costs_add_up_by_stage(tmp_path):
    for shard, cpu in (("0000", 30.0), ("0001", 40.0)):
        write_json(tmp_path / f"metrics/30_fea/{shard}.json", {"cpu_seconds": cpu, "peak_mib": cpu})
    (tmp_path / "metrics/30_fea/0002.json").write_text("{")
    assert cost_lines(last_runs(tmp_path))[1].split() == ["30_fea", "70", "s", "40"]


def test_durations_read_well():
    assert [duration(s) for s in (12.2, 125, 7200)] == ["12 s", "2 min", "2.0 h"]


def test_rejected_rows_are_no_presses_to_solve(tmp_path):
    now = lay(tmp_path, 2)
    write_csv(tmp_path / "10_poses/0000.rejected.csv", ["row", "column"], [{"row": 2, "column": c} for c in "ab"])
    assert "2 of 7 presses solved" in str(look(tmp_path, now))
    for shard in ("0000", "0001"):
        rows = [{"row": row, "column": "image"} for row in range(4)]
        write_csv(tmp_path / f"10_poses/{shard}.rejected.csv", ["row", "column"], rows)
    assert str(look(tmp_path, now)) == "no press left, 8 rows rejected"
