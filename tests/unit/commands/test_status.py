"""Status counts what the records of all targets say, and names why samples are missing."""

import os

from gelforge.commands.status import cost_lines, failed_lines, lines, outdated_lines
from gelforge.flow.files import states_of, write_csv, write_json, write_text
from gelforge.flow.runs import duration, last_runs, still_asked


def planned(results, rows, shards):
    """The record of a plan of so many rows, and its shards."""
    write_json(results / "metrics/00_plan/plan.json", {"inputs": {}, "counts": {"rows": rows, "shards": shards}})
    for name in range(shards):
        write_csv(results / f"00_plan/shards/{name:04d}.csv", ["sample_id"], [])


def counted(results, name, done, **failed):
    """The record of a target whose command counted so."""
    counts = {"done": done, "failed": {reason.replace("_", " "): count for reason, count in failed.items()}}
    write_json(results / f"metrics/{name}.json", {"exit_code": 0, "counts": counts})


def table_of(results):
    """Numbers of the lines of stages, and all lines."""
    text = lines(results, still_asked(results, last_runs(results)))
    return {line.split()[0]: line.split()[1:] for line in text[2:] if not line.startswith(" ")}, text


def test_counts_add_up_and_reasons_are_named(tmp_path):
    results = tmp_path / "results/lab"
    assert "nothing planned" in lines(results, [])[0]
    planned(results, 6, 2)
    counted(results, "10_poses/0000", 2, not_a_number=1)
    counted(results, "10_poses/0007", 9)  # of a shard that the log has lost
    counted(results, "30_fea/0000", 1, too_deep=1)
    table, text = table_of(results)
    assert (table["10_poses"], table["30_fea"], table["40_forces"]) == (
        ["2", "1", "3"],
        ["1", "1", "3"],
        ["0", "0", "4"],
    )
    assert "         1 x not a number" in text and "         1 x too deep" in text
    counted(results, "40_forces/0000", 1)
    counted(results, "50_labels/24x32/0000", 1)
    table, _ = table_of(results)
    # of shard 0000 one row was rejected and one press not solved; the three of shard 0001 are to come
    assert table["40_forces"] == ["1", "0", "3"] and table["50_labels"] == ["24x32", "1", "0", "3"]
    counted(results, "40_forces/0000", 0, UNBALANCED=1)
    assert table_of(results)[0]["40_forces"] == ["0", "1", "3"]


def test_what_nobody_asked_for_is_not_pending(tmp_path):
    """A stage without a result is listed with the target that makes it."""
    results = tmp_path / "results/lab"
    planned(results, 1, 1)
    write_text(results / "70_train/24x32/unet.onnx", "")
    _, text = table_of(results)
    assert "70_train             24x32/unet.onnx" in text
    assert "calibrate            not made (make calibrate DATASET=lab)" in text


def test_a_stage_that_failed_is_reported_with_the_last_words_of_its_log(tmp_path):
    """Nothing said that dataset had failed: it was said to be not made, as what nobody asked for."""
    results, log = tmp_path / "results/lab", tmp_path / "results/lab/logs/60_dataset/24x32/dataset.log"
    planned(results, 1, 1)
    write_text(log, "$ python -m gelforge.stages.dataset\nerror: no sample has a label\n\n")
    for name, code in (("60_dataset/24x32/dataset", 2), ("30_fea/0000", 1), ("30_fea/0007", 1), ("70_train/net", 0)):
        write_json(results / f"metrics/{name}.json", {"exit_code": code})
    write_json(results / "metrics/90_report/index.json", {"exit_code": 130, "interrupted": True})
    asked = still_asked(results, last_runs(results))
    assert [run.name for run in asked if run.failed] == [
        "30_fea/0000",
        "60_dataset/24x32/dataset",
    ]  # 0007 is of rows now lost
    assert failed_lines(results, asked) == [
        "failed: 30_fea/0000: ended with code 1 without a message; log: " + str(results / "logs/30_fea/0000.log"),
        f"failed: 60_dataset/24x32/dataset: error: no sample has a label; log: {log}",
    ]
    table = lines(results, asked)
    assert "60_dataset           not made, because it failed: see below" in table


def test_what_was_made_of_something_that_changed_since_is_reported(tmp_path):
    """After a changed parameter all of it stood there as done; what was only touched is as it was."""
    results = tmp_path / "results/lab"
    planned(results, 1, 1)
    params = [results / f"00_plan/params/{name}.json" for name in ("poses", "fea")]
    poses, fea = results / "10_poses/0000.csv", results / "30_fea/0000.csv"
    for path in (*params, poses, fea):
        write_text(path, path.name)
    for target, *inputs in ((poses, params[0]), (results / "10_poses/0001.csv", params[0]), (fea, poses, params[1]),
                            (results / "50_labels/12x16/0000.npz", fea)):  # fmt: skip
        record = {"exit_code": 0, "inputs": states_of(inputs, {}), "target": str(target)}
        write_json((results / "metrics" / target.relative_to(results)).with_suffix(".json"), record)
        for path in inputs:
            os.utime(path)

    def reported():
        return outdated_lines(still_asked(results, last_runs(results)))

    assert reported() == []
    write_text(params[1], "changed")
    assert reported() == [
        "outdated: 30_fea/0000 and what follows from it, because parameters of fea changed since it was made"
    ]
    write_text(params[1], params[1].name)
    write_text(fea, "solved again, and not labelled")
    assert reported() == [
        f"outdated: 50_labels/12x16/0000 and what follows from it, because {fea} changed since it was made"
    ]
    write_text(params[0], "changed")
    write_text(results / "00_plan/shards/0000.csv", "changed")
    assert reported() == [
        "outdated: 10_poses/0000 and what follows from it, because parameters of poses changed since it was made"
    ]


def test_costs_add_up_by_stage(tmp_path):
    for shard, cpu in (("0000", 30.0), ("0001", 40.0)):
        write_json(tmp_path / f"metrics/30_fea/{shard}.json", {"cpu_seconds": cpu, "peak_mib": cpu})
    write_text(tmp_path / "metrics/30_fea/0002.json", "{")
    assert cost_lines(tmp_path, last_runs(tmp_path))[1].split() == ["30_fea", "70", "s", "40"]
    assert [duration(s) for s in (12.2, 125, 7200)] == ["12 s", "2 min", "2.0 h"]


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
    assert [run.name for run in known if run.failed] == ["30_fea/d"]
    assert outdated_lines(known) == [] and "cost so far" in cost_lines(results, known)[0]
