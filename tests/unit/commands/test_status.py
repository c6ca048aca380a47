"""Status counts what is on disk, and names why samples are missing."""

import os
from pathlib import Path

import numpy as np

from gelforge.commands.status import cost_lines, failed_lines, lines, outdated_lines
from gelforge.flow.files import write_csv, write_json, write_text
from gelforge.flow.ledger import failures, last_runs, still_asked
from gelforge.records.forcefile import SampleForces, write_forces


def test_counts_add_up_and_reasons_are_named(tmp_path):
    results = tmp_path / "lab"
    assert "nothing planned" in lines(results)[0]
    write_csv(
        results / "00_plan/shards.csv", ["sample_id", "shard"], [{"sample_id": k, "shard": k // 3} for k in range(6)]
    )
    for name in range(2):
        of_shard = [{"sample_id": 3 * name + k} for k in range(3)]
        write_csv(results / f"00_plan/shards/{name:04d}.csv", ["sample_id"], of_shard)
    write_csv(results / "10_poses/0000.csv", ["sample_id"], [{"sample_id": k} for k in range(2)])
    rejected = [{"row": 4, "column": c, "reason": "not a number"} for c in ("x0_mm", "y0_mm")]
    write_csv(results / "10_poses/0000.rejected.csv", ["row", "column", "reason"], rejected)
    write_csv(
        results / "30_fea/0000.csv", ["sample_id", "status", "reason"],
        [{"sample_id": 0, "status": "OK", "reason": ""}, {"sample_id": 1, "status": "DIVERGED", "reason": "too deep"}],
    )  # fmt: skip
    text = lines(results)
    table = {line.split()[0]: line.split()[1:] for line in text[2:] if not line.startswith(" ")}
    assert table["10_poses"] == ["2", "1", "3"]
    assert table["30_fea"] == ["1", "1", "3"]
    assert table["40_forces"] == ["0", "0", "4"]
    (results / "50_labels/24x32").mkdir(parents=True)
    (results / "50_labels/24x32/0000.npz").touch()
    failed = SampleForces.failed("1", "DIVERGED")
    write_forces(results / "40_forces/0000.npz", [pressed("0"), failed], 0.08)
    table = {line.split()[0]: line.split() for line in lines(results)}
    # of shard 0000 one row was rejected and one press not solved; the three of shard 0001 are to come
    assert table["40_forces"][1:] == ["1", "0", "3"] and table["50_labels"][2:] == ["1", "0", "3"]
    assert any("not a number" in line for line in text) and any("too deep" in line for line in text)


def pressed(sample_id):
    """A sample whose one surface node bears 1 N."""
    return SampleForces(sample_id, "OK", "mesh", np.array([0]), np.array([[0.0, 0.0, -1.0]]), np.zeros((1, 3)))


def test_a_solve_that_gives_no_forces_is_reported(tmp_path):
    """Stage 40 refuses what does not balance; neither it nor a label of it is counted as done or to come."""
    results = tmp_path / "lab"
    for table in ("00_plan/shards.csv", "00_plan/shards/0000.csv", "10_poses/0000.csv"):
        write_csv(results / table, ["sample_id", "shard"], [{"sample_id": k, "shard": 0} for k in "ab"])
    write_csv(results / "30_fea/0000.csv", ["sample_id", "status"], [{"sample_id": k, "status": "OK"} for k in "ab"])
    write_forces(results / "40_forces/0000.npz", [pressed("a"), SampleForces.failed("b", "UNBALANCED")], 0.08)
    (results / "50_labels/24x32").mkdir(parents=True)
    text = lines(results)
    table = {line.split()[0]: line.split() for line in text}
    assert table["40_forces"][1:] == ["1", "1", "0"] and table["50_labels"][2:] == ["0", "0", "1"]
    assert any("1 x UNBALANCED: Contact forces and base reactions do not agree" in line for line in text)


def test_a_row_that_doubles_a_sample_is_one_row_of_the_log(tmp_path):
    """The plan's table has every sample once, and keeps those that the log has lost; the log's rows are what is counted."""
    results = tmp_path / "lab"
    known = [{"sample_id": name, "shard": 0} for name in ("a", "b", "gone")]
    write_csv(results / "00_plan/shards.csv", ["sample_id", "shard"], known)
    write_csv(results / "00_plan/shards/0000.csv", ["sample_id"], [{"sample_id": name} for name in ("a", "b", "a")])
    write_csv(results / "10_poses/0000.csv", ["sample_id"], [{"sample_id": name} for name in ("a", "b")])
    doubled = {"row": 4, "column": "sample_id", "reason": "an earlier row has the same sample_id"}
    write_csv(results / "10_poses/0000.rejected.csv", list(doubled), [doubled])
    table = {line.split()[0]: line.split()[1:] for line in lines(results)}
    assert table["10_poses"] == ["2", "1", "0"] and table["30_fea"] == ["0", "0", "2"]


def test_what_nobody_asked_for_is_not_pending(tmp_path):
    """A stage without a result is listed with the target that makes it."""
    results = tmp_path / "lab"
    write_csv(results / "00_plan/shards/0000.csv", ["sample_id"], [{"sample_id": "a"}])
    (results / "20_meshes").mkdir()
    (results / "20_meshes/ordinary.npz").touch()
    text = "\n".join(lines(results))
    assert "20_meshes            ordinary.npz" in text
    assert "calibrate            not made (make calibrate DATASET=lab)" in text


def test_a_stage_that_failed_is_reported_with_the_last_words_of_its_log(tmp_path):
    """Nothing said that dataset had failed: it was said to be not made, as what nobody asked for."""
    results, log = tmp_path / "lab", tmp_path / "lab/logs/60_dataset/24x32/dataset.log"
    write_csv(results / "00_plan/shards/0000.csv", ["sample_id"], [{"sample_id": "a"}])
    write_text(log, "$ python -m gelforge.stages.dataset\nerror: no sample has a label\n\n")
    for name, code in (("60_dataset/24x32/dataset", 2), ("30_fea/0000", 1), ("30_fea/0007", 1), ("70_train/net", 0)):
        write_json(results / f"metrics/{name}.json", {"exit_code": code})
    write_json(results / "metrics/90_report/index.json", {"exit_code": 130, "interrupted": True})
    failed = failures(results, still_asked(results, last_runs(results), None))
    assert [run.name for run in failed] == ["30_fea/0000", "60_dataset/24x32/dataset"]  # 0007 is of rows now lost
    assert failed_lines(results, failed) == [
        "failed: 30_fea/0000: ended with code 1 without a word; log: " + str(results / "logs/30_fea/0000.log"),
        f"failed: 60_dataset/24x32/dataset: error: no sample has a label; log: {log}",
    ]
    table = lines(results, {run.stage for run in failed})
    assert "60_dataset           not made, because it failed: see below" in table


def test_a_dataset_on_bricks_needs_no_meshes(tmp_path):
    write_csv(tmp_path / "lab/00_plan/shards/0000.csv", ["sample_id"], [{"sample_id": "a"}])
    assert "20_meshes            none needed: hexahedra have no file" in lines(tmp_path / "lab", meshes=[])
    assert "20_meshes            not made (make meshes DATASET=lab)" in lines(
        tmp_path / "lab", meshes=["ccx-centre-0.7"]
    )


def test_what_was_made_of_something_that_changed_since_is_reported(tmp_path):
    """After a changed parameter all of it stood there as done."""
    results = tmp_path / "results/lab"
    params = [write_dated(results / f"00_plan/params/{name}.json", 0) for name in ("poses", "fea")]
    write_csv(results / "00_plan/shards/0000.csv", ["sample_id"], [{"sample_id": "a"}])
    poses = made_of(results, "10_poses/0000.csv", 10, params[0])
    made_of(results, "10_poses/0001.csv", -10, params[0])  # of rows that the log has lost: nobody makes it again
    fea = made_of(results, "30_fea/0000.csv", 20, poses, params[1])
    made_of(results, "50_labels/12x16/labels.json", 30, fea)
    asked = still_asked(results, last_runs(results), [])
    assert outdated_lines(asked) == []
    write_dated(Path(params[1]), 40)
    assert outdated_lines(asked) == [
        "outdated: 30_fea/0000 and what follows from it, because parameters of fea changed since"
    ]
    write_dated(Path(fea), 50)  # solved again, and not labelled
    (reported,) = outdated_lines(asked)
    assert f"{fea} changed since" in reported and "50_labels/12x16/labels" in reported


def write_dated(path, at):
    """A file of a time in seconds after another; its path as text."""
    write_text(path, "")
    os.utime(path, (1e9 + at, 1e9 + at))
    return str(path)


def made_of(results, name, at, *inputs):
    """A target of that time with the record that its step left; its path as text."""
    target = write_dated(results / name, at)
    record = {"exit_code": 0, "inputs": inputs, "target": str(target)}
    write_json((results / "metrics" / name).with_suffix(".json"), record)
    return target


def test_a_record_that_lacks_what_is_asked_for_is_no_traceback(tmp_path):
    """One that parses may be of a run that was cut off, or of another program."""
    results = tmp_path / "lab"
    for name, record in (
        ("a", {}),
        ("b", {"exit_code": None, "cpu_seconds": "9", "inputs": None}),
        ("c", [1]),
        ("d", {"exit_code": 1}),
    ):
        write_json(results / f"metrics/30_fea/{name}.json", record)
    known = last_runs(results)
    assert [run.name for run in failures(results, known)] == ["30_fea/d"]
    assert outdated_lines(results, known) == [] and "cost so far" in cost_lines(results, known)[0]
