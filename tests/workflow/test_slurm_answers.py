"""Whatever a site's wrappers of Slurm's programs answer: jobs are known by their names, submitted once, and seen gone."""

import os
import shutil
import signal
import time
from pathlib import Path

import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import write_text
from gelforge.flow.slurm import client
from gelforge.flow.slurm import run as slurm
from gelforge.flow.slurm.client import SlurmRefused, array_limit, elements, find_job
from gelforge.flow.slurm.cluster import read_profile
from gelforge.flow.slurm.record import Record, Results, Task, load
from tests.benchmarks.slurm import cluster, lay_project, start_make
from tests.support.waiting import HANG, wait_until
from tests.workflow.conftest import NEEDS_SLURM

pytestmark = NEEDS_SLURM
REAL_SQUEUE = shutil.which("squeue") or "squeue"
ONCE = "[ -e once ] || { touch once; "


@pytest.fixture(scope="module")
def lab():
    """A cluster of one core; each test leaves it empty."""
    with cluster(cpus=1) as made:
        yield made


@pytest.fixture
def site(lab, tmp_path, monkeypatch):
    """A project on the cluster; wrap(PROGRAM, LINES) puts a wrapper before one of Slurm's programs, $REAL in its lines."""
    project = lay_project(tmp_path / "p")
    monkeypatch.chdir(project)
    monkeypatch.setenv("SLURM_CONF", str(lab.folder / "slurm.conf"))
    (tmp_path / "bin").mkdir()
    path = os.environ["PATH"]
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{path}")

    def wrap(program: str, lines: str) -> None:
        script = tmp_path / "bin" / program
        write_text(script, f"#!/bin/bash\nREAL={shutil.which(program, path=path)}\n{lines}\n")
        script.chmod(0o755)

    yield wrap
    shutil.rmtree(tmp_path / "bin")
    lab.ask("scancel", f"--user={os.getuid()}")
    wait_until(lambda: lab.ask("squeue", "-h") == "")


def settings(**changes):
    """The profile of stage 10 with changes in [default]."""
    lay = "".join(f"{key} = {value!r}\n" for key, value in {"memory_mb": 50, "submit_seconds": 0, **changes}.items())
    write_text("own.toml", f"[default]\n{lay}")
    return read_profile("own.toml", "10_poses")


def work_of(count: int = 2) -> Record:
    """Work that does not end by itself."""
    tasks = [Task(f"results/lab/10_poses/{k}.csv", "sleep 600", 50, 5) for k in range(count)]
    return Record(Path("results/lab/.slurm/10_poses.json"), "10_poses", tasks)


def jobs_alive(lab) -> list[str]:
    """Numbers of all jobs that wait or run, as Slurm's own program reports."""
    return sorted(set(lab.ask(REAL_SQUEUE, "-h", "-t", "PD,R", "-o", "%F").split()))


ANSWERS = {
    "text before": 'echo "Welcome! 3 nodes of rack 12 are down."; $REAL "$@"',
    "text after": '$REAL "$@"; echo "on cluster slaking"',
    "the sentence of sbatch": 'echo "Submitted batch job $($REAL "$@") on cluster slaking"',
    "on stderr only": '$REAL "$@" >&2',
    "none": '$REAL "$@" >/dev/null 2>&1',
    "no text at all": '$REAL "$@"; printf "\\xff\\xfe\\n"',
    "an old number": 'echo 1; $REAL "$@" >/dev/null',
    "failing once it was taken": '$REAL "$@"; echo "quota: no such account" >&2; exit 3',
    "failing once before": f'{ONCE} echo "Socket timed out on send/recv operation" >&2; exit 1; }}; $REAL "$@"',
    "failing once after": f'$REAL "$@"; {ONCE} echo "Unable to contact slurm controller" >&2; exit 1; }}',
    "slow": 'sleep 1; $REAL "$@"; sleep 1',
    "killed once it was taken": '$REAL "$@"; kill -KILL $$',
}


@pytest.mark.parametrize("answer", ANSWERS)
def test_a_job_is_known_by_its_name_whatever_sbatch_answers(site, lab, answer):
    site("sbatch", ANSWERS[answer])
    record = work_of()
    slurm.submit(record, settings(submit_seconds=3), record.tasks)
    assert [batch.job for batch in load(record.path).batches] == jobs_alive(lab)
    assert len(jobs_alive(lab)) == 1
    slurm.cancel(record)
    assert not jobs_alive(lab) and not record.path.exists()


def test_a_wrapper_that_never_comes_to_submit_is_ended_and_submits_nothing_later(site, lab):
    site("sbatch", '(sleep 1; touch late) & wait; $REAL "$@"')
    with pytest.raises(SlurmRefused, match="no answer"):
        client.ran("sbatch", "--parsable", text="#!/bin/bash\n", seconds=0.5)
    time.sleep(1.5)
    assert not Path("late").exists() and not jobs_alive(lab)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("echo ok", "answered 'ok', and Slurm knows no job named gelforge-10_poses"),
        ("echo 4711 on slaking", "cancel by hand what it may have queued where squeue does not look"),
        ('$REAL "$@" --job-name=mine', "it gave job [0-9]+ another one, which is cancelled; let it keep --job-name"),
    ],
)
def test_an_answer_without_a_job_is_refused_and_nothing_stays(site, lab, lines, said):
    site("sbatch", lines)
    record = work_of()
    with pytest.raises(SlurmRefused, match=said):
        slurm.work(record, settings(), detach=False, submitting=True)
    assert not jobs_alive(lab) and not record.path.exists()


@pytest.mark.parametrize("lines", ['exec $REAL "$@"', '$REAL "$@" 2>&1'])
def test_a_job_that_slurm_refuses_is_refused_though_its_queue_lists_it(site, lab, lines):
    """As failed: what sbatch was refused for its memory stays there under its name."""
    site("sbatch", lines)
    record, profile = work_of(), settings(memory_mb=10**7)
    record.tasks = [slurm.Task("a", "true", 10**7, 5)]
    with pytest.raises(SlurmRefused, match="Requested node configuration is not available"):
        slurm.work(record, profile, detach=False, submitting=True)
    assert not record.path.exists()


def test_a_job_that_was_taken_twice_is_run_once(site, lab):
    site("sbatch", '$REAL "$@" <<<"$(tee script)"; $REAL "$@" <script')
    record = work_of(1)
    slurm.submit(record, settings(), record.tasks)
    wait_until(lambda: len(jobs_alive(lab)) == 2)
    slurm.ask_queue(record, 0.0, settings())
    assert jobs_alive(lab) == [record.batches[0].job]
    slurm.cancel(record)


def test_text_around_the_queue_changes_nothing(site, lab):
    site("squeue", 'echo "squeue: answers are 12 s old"; $REAL "$@"; echo; echo "7   7   RUNNING   0"')
    record = work_of()
    slurm.submit(record, settings(), record.tasks)
    assert [record.batches[0].job] == jobs_alive(lab)
    assert {element.task for element in elements([record.batches[0].name])} == {1, 2}
    slurm.cancel(record)


@pytest.mark.parametrize("lines", ["exit 0", 'echo "scancel: unable to contact slurm controller" >&2; exit 1'])
def test_jobs_that_stay_are_not_said_to_be_cancelled(site, lab, monkeypatch, capsys, lines):
    monkeypatch.setattr(client, "GONE_WITHIN_S", 0.5)
    site("scancel", lines)
    record, profile = work_of(), settings()
    slurm.submit(record, profile, record.tasks)
    with pytest.raises(SlurmRefused, match=r"may still be on Slurm.* make slurm-cancel DATASET=lab cancels them"):
        slurm.cancel(record)
    assert jobs_alive(lab) == [batch.job for batch in load(record.path).batches]
    # Nor is their record replaced by another run's, which would lose them.
    with pytest.raises(BadInput, match="is on Slurm already"):
        slurm.start(record.results, "10_poses", "10_poses", [], profile)
    site("scancel", 'exec $REAL "$@"')
    assert slurm.main(["cancel", "--results", "results/lab"]) == 0 and "cancelled" in capsys.readouterr().out
    assert not jobs_alive(lab)


def test_what_somebody_cancelled_before_it_began_is_not_submitted_again(site, lab):
    record = work_of(3)
    slurm.submit(record, settings(), record.tasks)
    name = record.batches[0].name
    lab.ask("scancel", find_job(name))
    wait_until(lambda: all(element.over for element in elements([name])))
    ended = slurm.observe(record, slurm.by_task(elements([name])), Results())
    assert [slurm.cause_of(state, status, why, "")[1] for _, state, status, why in ended if state != "COMPLETING"]
    assert {state for _, state, *_ in ended} <= {"CANCELLED", "COMPLETING"} and len(ended) >= 2


def test_the_number_that_older_code_took_for_a_job_is_none(tmp_path):
    record = work_of(1)
    record.path = tmp_path / "d" / ".slurm" / "10_poses.json"
    record.batches = [slurm.Batch("gelforge-a", "slaking", [[0]])]
    record.save()
    assert load(record.path).batches[0].job == ""


@pytest.mark.parametrize("option", ["--clusters=slaking", "-Mslaking", "--cluster=all"])
def test_work_is_not_sent_to_a_cluster_that_is_not_looked_at(site, option):
    with pytest.raises(
        BadInput, match="where squeue does not look for it; work on that cluster by its own SLURM_CONF"
    ):
        settings(options=[option])


def test_options_of_a_profile_do_not_take_a_job_out_of_sight(site, lab, monkeypatch):
    monkeypatch.setenv("SBATCH_WAIT", "1")
    record = work_of(1)
    slurm.submit(record, settings(options=["--job-name=mine", "--array=1-7", "--output=/dev/null"]), record.tasks)
    assert {element.task for element in elements([record.batches[0].name])} == {1}
    slurm.cancel(record)


def test_ctrl_c_says_that_jobs_are_cancelled_when_they_are(site, lab, tmp_path):
    """The case that people met: a line after the number was taken for it, and four times four jobs stayed."""
    site("sbatch", ANSWERS["the sentence of sbatch"])
    project = Path.cwd()
    for shard in range(4):
        write_text(project / "faults" / f"poses-{shard}", "import time\ntime.sleep(600)\n")
    process = start_make(project, lab, "poses")
    wait_until(lambda: jobs_alive(lab) and list((project / "runs").iterdir()), of=process)
    assert len(jobs_alive(lab)) == 1
    os.killpg(process.pid, signal.SIGINT)
    text, _ = process.communicate(timeout=HANG)
    assert "interrupted, its Slurm jobs are cancelled" in text and not jobs_alive(lab), text


def test_limits_of_jobs_and_of_arrays_are_the_clusters_own(tmp_path, monkeypatch):
    few = "MaxJobCount=4\nSchedulerParameters=batch_sched_delay=0,max_array_tasks=3"
    monkeypatch.chdir(lay_project(tmp_path / "p"))
    with cluster(cpus=1, extra=few) as made:
        monkeypatch.setenv("SLURM_CONF", str(made.folder / "slurm.conf"))
        monkeypatch.setattr(client, "LEAST_ANSWER_S", 4.0)
        record, profile = work_of(8), settings(submit_seconds=1, shards_per_task=2)
        assert array_limit(profile) == 3
        slurm.submit(record, profile, record.tasks[:2])
        with pytest.raises(
            SlurmRefused, match=r"(queue full|unable to accept job).*raise shards_per_task \(now 2\) in the profile"
        ):
            slurm.work(record, profile, detach=False, submitting=True)
        assert not jobs_alive(made)


@pytest.mark.parametrize(
    "words",
    [
        "sbatch: error: AssocMaxSubmitJobLimit",
        "sbatch: error: QOSMaxSubmitJobPerUserLimit",
        "Batch job submission failed: Job violates accounting/QOS policy (job submit limit, user's size and/or time limits)",
    ],
)
def test_a_limit_of_submitted_jobs_names_the_setting_that_helps(site, words):
    site("sbatch", f"echo {words!r} >&2; exit 1")
    record = work_of()
    with pytest.raises(SlurmRefused, match=r"raise shards_per_task \(now 1\)"):
        slurm.work(record, settings(), detach=False, submitting=True)
