"""Parts of the Slurm executor that need no cluster: causes, hints, patience, profiles, and what waits for what."""

import dataclasses
import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, write_json, write_text
from gelforge.flow.layout import Layout, metrics_of
from gelforge.flow.slurm import run as slurm
from gelforge.flow.slurm.client import Element, cause_of
from gelforge.flow.slurm.cluster import read_profile
from gelforge.flow.slurm.record import Batch, Record, Results, Task, show
from tests.benchmarks.sandbox import link_project, make
from tests.support.waiting import HANG

ROOT = Path(__file__).resolve().parents[2]
PROFILE = ROOT / "workflow" / "slurm.toml"


@pytest.mark.parametrize(
    ("state", "status", "reason", "output", "cause"),
    [
        ("OUT_OF_MEMORY", 0, "OutOfMemory", "", "memory"),
        # Limits enforced by polling end a job as if it had failed; only its output says why.
        (
            "FAILED",
            9,
            "JobLaunchFailure",
            "slurmstepd: error: StepId=3.batch exceeded memory limit (2 > 1)",
            "memory",
        ),
        (
            "FAILED",
            256,
            "NonZeroExitCode",
            "slurmstepd: error: Detected 1 oom-kill event(s) in StepId=3.batch",
            "memory",
        ),
        ("TIMEOUT", 0, "TimeLimit", "", "time"),
        ("NODE_FAIL", 1, "NodeDown", "", "node"),
        ("PREEMPTED", 0, "None", "", "node"),
        ("PENDING", 0, "launch failed requeued held", "", "node"),
        ("FAILED", 256, "NonZeroExitCode", "FAILED x (exit 1)", "error"),
        ("FAILED", 9, "NonZeroExitCode", "FAILED x", "error"),
        ("CANCELLED", 15, "None", "", "error"),
        ("COMPLETED", 0, "None", "", "unknown"),
        ("", 0, "", "", "unknown"),
    ],
)
def test_cause(state, status, reason, output, cause):
    assert cause_of(state, status, reason, output)[0] == cause


def test_measures_are_bounded_and_fit_the_cause(monkeypatch):
    monkeypatch.chdir(ROOT)
    profile = dataclasses.replace(
        read_profile(PROFILE, "30_fea"),
        memory_max_mb=300,
        time_max_minutes=25,
        memory_factor=2.0,
        time_factor=2.0,
        retries=9,
    )
    asked = {"memory": [], "time": [], "node": [], "error": []}
    for cause, seen in asked.items():
        task = Task("t", "c", 100, 10, runs=1)
        while slurm.with_more(task, cause, profile):
            seen.append((task.memory_mb, task.minutes))
            task.runs += 1
    assert asked["memory"] == [(200, 10), (300, 10)]
    assert asked["time"] == [(100, 20), (100, 25)]
    assert asked["node"] == [(100, 10)] * 9
    assert asked["error"] == []


def published(folder: Path, text: str) -> None:
    """Lay a target as the wrapper does: metrics with its bytes, then the file."""
    write_json(folder / "results/lab/metrics/30_fea/0.json", {"bytes": len(text)})
    write_text(folder / "results/lab/30_fea/0.csv", text)


def look(record: Record) -> list[tuple]:
    """One look at a record whose only task has COMPLETED according to Slurm."""
    results = Results()
    results.look({"results/lab/30_fea"})
    return slurm.observe(record, slurm.by_task([Element("b", "7", 1, "COMPLETED", 0, "None")]), results)


def test_a_result_that_shows_late_is_waited_for_and_one_that_never_shows_is_not(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    profile = dataclasses.replace(read_profile(PROFILE, "30_fea"), visible_seconds=30)
    monkeypatch.chdir(tmp_path)
    task = Task("results/lab/30_fea/0.csv", "c", 100, 10, runs=1, where="b/1")
    record = Record(tmp_path / "r.json", "30_fea", [task], [Batch("b", "7", [[0]])])
    gone: dict = {}
    assert slurm.judge(record, profile, look(record), gone) == [] and task.state == "queued"
    published(tmp_path, "whole\n")
    assert look(record) == [] and task.state == "done"
    # The same without a result: after the time the profile allows it is run again, as it was.
    (tmp_path / "results/lab/30_fea/0.csv").unlink()
    task.state = "running"
    assert slurm.judge(record, profile, look(record), gone) == []
    gone[task.where] -= 31  # as if that long had passed
    assert slurm.judge(record, profile, look(record), gone) == [task]


@pytest.mark.parametrize(
    ("node", "edited", "due"),
    [(20.0, False, False), (-20.0, False, False), (20.0, True, True), (1e8, False, False), (-20.0, True, True)],
)
def test_a_node_whose_clock_is_off_dates_no_result(tmp_path, monkeypatch, node, edited, due):
    """make compares dates: one ahead would hide edits, one behind would be made again by each make for ever."""
    monkeypatch.chdir(tmp_path)
    published(tmp_path, "whole\n")
    source, target = tmp_path / "results/lab/10_poses/0.csv", tmp_path / "results/lab/30_fea/0.csv"
    write_text(source, "poses\n")
    now = time.time()
    os.utime(source, (now - 5, now - 5))
    record = metrics_of(target)
    write_json(record, {**read_json(record), "read": {str(source): source.stat().st_mtime_ns}})
    os.utime(target, (now + node, now + node))
    if edited:
        os.utime(source, (now - 1, now - 1))
    results = Results()
    results.look({"results/lab/30_fea"})
    assert results.there("results/lab/30_fea/0.csv")
    made = target.stat().st_mtime
    assert made <= time.time() and (made < source.stat().st_mtime) == due


@pytest.mark.parametrize("text", ["", "who"])
def test_a_file_without_all_its_bytes_is_no_result(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    published(tmp_path, "whole\n")
    (tmp_path / "results/lab/30_fea/0.csv").write_text(text)
    results = Results()
    results.look({"results/lab/30_fea"})
    assert not results.there("results/lab/30_fea/0.csv")


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Write a profile of one's own beside the published one."""
    monkeypatch.chdir(ROOT)

    def write(text: str) -> Path:
        path = tmp_path / "slurm.toml"
        path.write_text(text)
        return path

    return write


def test_a_stage_overrides_the_default_and_an_own_file_the_published_one(own):
    path = own('[default]\ncores = 3\nmemory_mb = 9\n[labels]\noptions = ["--qos=short"]\nmemory_mb = 7\n')
    profile = read_profile(path, "50_labels")
    asked = profile.sbatch_options(profile.memory_mb, 3)
    assert asked[-4:] == ["--cpus-per-task=3", "--mem=7M", "--time=3", "--qos=short"]
    of_core = dataclasses.replace(profile, memory_per_core=True)
    assert of_core.sbatch_options(7, 3)[-4:] == ["--cpus-per-task=3", "--mem-per-cpu=3M", "--time=3", "--qos=short"]
    # A stage's own table is narrower than [default], whichever file it stands in.
    train = read_profile(path, "70_train")
    assert "--gres=gpu:1" in train.options and train.cores == 4
    assert read_profile(path, "calibrate") == read_profile(path, "40_forces")
    local = read_profile(ROOT / "envs" / "slurm-cluster.toml", "70_train")
    assert local.options == () and local.cores == 1


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("memory = 3", "[labels] memory: unknown key; memory_mb is meant?"),
        ("cores = 0", "[labels] cores = 0: give a whole number from 1"),
        ("cores = '1'", "give a whole number"),
        ("options = [1]", "give a list"),
        ("poll_seconds = true", "give a number from 0.1"),
    ],
)
def test_a_wrong_profile_is_named(own, line, words):
    path = own(f"[labels]\n{line}\n")
    with pytest.raises(BadInput, match=re.escape(words)):
        read_profile(path, "50_labels")


HOLD = """
import sys
import time
from pathlib import Path
from gelforge.flow.slurm.lock import become_only_make
lock = become_only_make(Path(sys.argv[1]), 4711)
print("held already" if lock is None else "mine", flush=True)
lock and sys.stdin.read()
"""


def holder(results):
    """A process that becomes the only make, of number 4711, until its standard input closes."""
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", HOLD, results], stdin=pipe, stdout=pipe, stderr=pipe, text=True)


def test_a_make_of_the_same_number_on_another_machine_is_another_make(tmp_path):
    """Machines that share results count their processes each from 1 on, and so do containers."""
    first = holder(tmp_path)
    assert first.stdout.readline() == "mine\n"
    again = holder(tmp_path)
    assert again.communicate(timeout=HANG)[0] == "held already\n"  # make reads its files once more
    lock = tmp_path / ".slurm/lock"
    lock.write_text(lock.read_text().replace(os.uname().nodename, "elsewhere"))
    other = holder(tmp_path)
    assert "another make is at work" in other.stderr.readline()
    first.communicate(timeout=HANG)
    assert other.communicate(timeout=HANG)[0] == "mine\n"


def test_who_cancels_another_dataset_than_the_one_that_runs_is_reported(tmp_path, capsys):
    assert slurm.main(["cancel", "--results", str(tmp_path / "demo")]) == 0
    assert "demo: nothing was left running" in capsys.readouterr().out


def test_collected_tasks_come_once_and_in_order(tmp_path):
    path = tmp_path / "30_fea.tasks"
    path.write_text("a\tone two\nb\tthree \\\n  four\na\tone two\n")
    assert slurm.collected(path) == [("a", "one two"), ("b", "three    four")]


def prerequisites(text: str) -> dict[str, set[str]]:
    """Target to prerequisites, order-only ones too, out of `make -p`."""
    graph: dict[str, set[str]] = {}
    for line in text.splitlines():
        match = re.match(r"^([^\s#:=][^:=]*):(?!=) ?(.*)$", line)
        if match:
            graph.setdefault(match[1], set()).update(match[2].replace("|", " ").split())
    return graph


def reaches(graph: dict, start: str) -> set[str]:
    """Everything a target waits for."""
    seen, todo = set(), [start]
    while todo:
        for name in graph.get(todo.pop(), ()):
            if name not in seen:
                seen.add(name)
                todo.append(name)
    return seen


def test_whatever_reads_a_collected_stage_waits_for_its_barrier(tmp_path):
    """Without it make would start a reader while its input is only noted."""
    project = link_project(ROOT, tmp_path / "p")
    data = project / "data" / "tiny"
    write_text(data / "log.csv", "sample_id,indenter\ns1,sphere_15\ns2,sphere_15\n")
    write_text(data / "dataset.toml", 'sensor = "feats"\ngel = "g"\n')
    done = make(project, "-np", "DATASET=tiny", "EXECUTOR=slurm", "report", "calibrate", "pareto", "stability")
    graph = prerequisites(done.stdout)
    collected = re.search(r"^COLLECT := (.*)$", done.stdout, re.MULTILINE)[1].split()
    assert any(name.startswith("barrier-30_fea") for name in graph), done.stdout[-2000:]
    for target in graph:
        if target.startswith("barrier-"):
            continue
        for stage in collected:
            folder, barrier = f"results/tiny/{stage}/", f"barrier-{stage}"
            reads = any(name.startswith(folder) for name in graph[target])
            if reads and not target.startswith(folder):
                assert barrier in reaches(graph, target), f"{target} does not wait for {stage}"


def test_work_on_slurm_is_shown_on_the_terminal_with_the_presses_of_the_whole_run(tmp_path, monkeypatch):
    results = tmp_path / "results" / "d"
    write_text(results / "00_plan/shards.csv", "sample_id,shard\ns0,0\ns1,0\n")
    write_text(Layout(results).shard("0000"), "sample_id\ns0\ns1\n")
    record = Record(
        results / ".slurm/30_fea.json", "30_fea", [Task("a", "true", 100, 1, "running"), Task("b", "true", 100, 1)]
    )
    master, slave = pty.openpty()
    monkeypatch.setenv("MAKE_TERMERR", os.ttyname(slave))
    monkeypatch.setenv("COLUMNS", "200")
    show(record, 0.0, silent=False)
    shown = os.read(master, 1000).decode()
    assert "30_fea on Slurm: 1 queued, 1 running, 0 done, 0 failed | 0 of 2 presses solved" in shown
    record.stage = "80_evaluate"
    show(record, 0.0, silent=False)
    assert "presses" not in os.read(master, 1000).decode()


def test_what_make_calls_its_terminal_where_it_knows_none_is_no_file(tmp_path, monkeypatch, capsys):
    """make says `true` then; a file of that name would be one that nobody asked for."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAKE_TERMERR", "true")
    show(
        Record(tmp_path / "results/d/.slurm/10_poses.json", "10_poses", [Task("a", "true", 100, 1)]),
        -60.0,
        silent=True,
    )
    assert "the controller does not answer" in capsys.readouterr().err and not list(tmp_path.iterdir())
