"""The Slurm executor on a real cluster: what a cluster does to work, with nothing lost and nothing done twice."""

import os
import re
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.benchmarks.slurm import Cluster, cluster, lay_profile, lay_project, make, start_make
from tests.support.waiting import HANG, wait_until
from tests.workflow.conftest import NEEDS_SLURM

pytestmark = NEEDS_SLURM
# A task sleeps in its first run only: what is lost while it sleeps is quick when it is brought back.
FIRST_RUN = "import os, time\nif open(f'runs/{name}').read().count('started') == 1:\n    "
FOR_EVER = f"time.sleep({2 * HANG})\n"  # of what is to be ended: were it not, no busy machine may pass that by
AWAIT_GO = "import os, time\nwhile not os.path.exists('runs/go'): time.sleep(0.1)\n"
HELD = "import time\nheld = b'x' * (120 * 2**20)\n"
STATES = re.compile(r"(\d+) queued, (\d+) running, (\d+) done, (\d+) failed")


@pytest.fixture(scope="module")
def lab():
    """A cluster of two cores, shared by the tests; each leaves it running and empty."""
    with cluster(cpus=2) as made:
        yield made


@pytest.fixture(scope="module", autouse=True)
def overdue(tmp_path_factory):
    """A task over its time limit on a cluster of its own, begun first: Slurm counts whole minutes."""
    with cluster(cpus=1) as made:
        project = lay_project(tmp_path_factory.mktemp("overdue") / "p", time_minutes=1)
        fault(project, "poses-0", FIRST_RUN + FOR_EVER)
        process = start_make(project, made, "poses", "SHARDS=0 1")
        yield project, process
        if process.poll() is None:
            process.terminate()
            process.wait()


@pytest.fixture
def project(tmp_path, lab):
    """A project of four shards; afterwards nothing of it may be left in the queue."""
    yield lay_project(tmp_path / "p", visible_seconds=3)
    wait_until(lambda: lab.ask("squeue", "-h") == "")


def fault(project: Path, name: str, code: str) -> None:
    """Make the task NAME run `code` before it writes its result."""
    (project / "faults" / name).write_text(code)


def runs(project: Path, stage: str = "poses", shards=range(4)) -> list[tuple[int, int]]:
    """How often each task was begun and how often it came to its end."""
    texts = [(project / "runs" / f"{stage}-{shard}") for shard in shards]
    texts = [path.read_text() if path.exists() else "" for path in texts]
    return [(text.count("started"), text.count("ended")) for text in texts]


def there(project: Path, stage: str = "10_poses") -> list[str]:
    """Results that are there under their final names."""
    return sorted(
        path.stem for path in (project / "results" / "lab" / stage).glob("[0-9]*.*") if path.suffix != ".part"
    )


def ends_well(process) -> str:
    """What a make that was begun has printed at its end."""
    text, _ = process.communicate(timeout=HANG)
    assert process.returncode == 0, text
    return text


def await_running(project: Path, lab, count: int) -> None:
    """Wait until `count` tasks of stage 10 have begun."""
    wait_until(lambda: sum(started > ended for started, ended in runs(project)) >= count)


ONCE = [(1, 1)] * 4


def test_equals_local_and_nothing_is_left_to_do(project, lab, tmp_path):
    code, text = make(project, lab, "whole")
    assert code == 0, text
    assert [runs(project, stage) for stage in ("poses", "fea", "forces")] == [ONCE] * 3
    assert "Nothing to be done" in make(project, lab, "-n", "whole")[1]
    local = lay_project(tmp_path / "local")
    assert make(local, lab, "whole", "EXECUTOR=local")[0] == 0
    for path in sorted((local / "results" / "lab").rglob("[0-9][0-9]_*/*")):
        if not {"logs", "metrics"} & set(path.parts):
            assert path.read_bytes() == (project / path.relative_to(local)).read_bytes()
    # Success leaves no bookkeeping.
    assert sorted(path.name for path in (project / "results" / "lab" / ".slurm").iterdir()) == ["lock", "work"]


def test_dry_run_shows_what_local_would_run_and_submits_nothing(project, lab):
    steps = [
        [
            line
            for line in make(project, lab, "-n", "whole", f"EXECUTOR={name}")[1].splitlines()
            if "gelforge.flow.step" in line
        ]
        for name in ("slurm", "local")
    ]
    assert sorted(steps[0]) == sorted(steps[1]) and len(steps[0]) == 13
    assert not (project / "results").exists()


def test_a_changed_input_reaches_the_end_in_one_make(project, lab):
    assert make(project, lab, "fea")[0] == 0
    later = time.time() + 2
    os.utime(project / "log.csv", (later, later))
    # Results are older than this time stamp, so wait until they would not be.
    time.sleep(2.1)
    assert make(project, lab, "fea")[0] == 0
    assert [runs(project, stage) for stage in ("poses", "fea")] == [[(2, 2)] * 4] * 2
    assert "Nothing to be done" in make(project, lab, "-n", "fea")[1]


def test_arrays_of_limited_length_and_several_shards_a_task(project, lab):
    lay_profile(project, memory_mb=50, array_limit=2, shards_per_task=3, poll_seconds=1.0, concurrent=1)
    shards = range(11)
    code, text = make(project, lab, "poses", f"SHARDS={' '.join(map(str, shards))}")
    assert code == 0, text
    assert runs(project, shards=shards) == [(1, 1)] * 11
    names = lab.ask("squeue", "-h", "-t", "all", "-S", "i", "-o", "%F").split()[-4:]
    assert len(set(names)) == 2  # four tasks in two arrays


def test_one_file_by_its_name_takes_only_what_it_needs(project, lab):
    code, text = make(project, lab, "results/lab/30_fea/2.csv")
    assert code == 0, text
    assert there(project) == there(project, "30_fea") == ["2"]


def test_a_task_that_fails_is_shown_and_not_tried_again(project, lab):
    fault(project, "fea-2", "print('sample s17 diverged')\nsys.exit(1)\n")
    code, text = make(project, lab, "forces")
    assert code != 0
    assert "FAILED results/lab/30_fea/2.csv: failed (exit 1)" in text and "| sample s17 diverged" in text
    assert runs(project, "fea") == [(1, 1), (1, 1), (1, 0), (1, 1)] and runs(project, "forces") == [(0, 0)] * 4
    status = make(project, lab, "status")[1]
    assert "3 done, 1 failed" in status and "results/lab/30_fea/2.csv: failed (exit 1)" in status
    (project / "faults" / "fea-2").unlink()
    assert make(project, lab, "forces")[0] == 0
    assert runs(project, "fea") == [(1, 1), (1, 1), (2, 1), (1, 1)] and runs(project, "forces") == ONCE


def test_killed_by_memory_comes_back_with_more(project, lab):
    # 120 MiB are over 50 and 100, not over 200
    until_third = "while open(f'runs/{name}').read().count('started') < 3: time.sleep(0.1)\n"
    fault(project, "poses-1", HELD + until_third)
    code, text = make(project, lab, "poses")
    assert code == 0, text
    assert "killed at its memory limit of 50 MiB; again with 100 MiB" in text
    assert "killed at its memory limit of 100 MiB; again with 200 MiB" in text
    assert runs(project) == [(1, 1), (3, 1), (1, 1), (1, 1)]


def test_killed_by_memory_as_often_as_the_profile_allows(project, lab):
    lay_profile(project, memory_mb=50, memory_max_mb=80, poll_seconds=1.0)
    fault(project, "poses-1", HELD + FOR_EVER)
    code, text = make(project, lab, "poses")
    assert code != 0 and "killed at its memory limit of 80 MiB" in text and "run 2" in text
    assert runs(project) == [(1, 1), (2, 0), (1, 1), (1, 1)] and there(project) == ["0", "2", "3"]


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_interrupted_make_cancels(project, lab, how):
    fault(project, "poses-3", FIRST_RUN + FOR_EVER)
    process = start_make(project, lab, "poses")
    wait_until(lambda: there(project) == ["0", "1", "2"] and runs(project)[3] == (1, 0))
    # A terminal interrupts the whole group; a kill reaches make alone.
    (os.killpg if how == signal.SIGINT else os.kill)(process.pid, how)
    text, _ = process.communicate(timeout=HANG)
    assert process.returncode != 0
    wait_until(lambda: lab.ask("squeue", "-h") == "")
    assert there(project) == ["0", "1", "2"]
    code, text = make(project, lab, "poses")
    assert code == 0, text
    assert runs(project) == [(1, 1), (1, 1), (1, 1), (2, 1)]


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_and_detached_work_is_found_again(project, lab, how):
    for shard in range(4):
        fault(project, f"poses-{shard}", AWAIT_GO)
    process = start_make(project, lab, "poses", "DETACH=1")
    await_running(project, lab, 2)
    (os.killpg if how == signal.SIGINT else os.kill)(process.pid, how)
    text, _ = process.communicate(timeout=HANG)
    assert process.returncode != 0 and "left running on Slurm" in text
    assert lab.ask("squeue", "-h") != ""
    status = make(project, lab, "status")[1]
    queued, running, done, failed = map(int, STATES.search(status.partition("slurm 10_poses")[2]).groups())
    assert queued + running + done == 4 and running >= 1 and not failed
    assert "\nrunning: " in status
    (project / "runs" / "go").touch()
    code, text = make(project, lab, "fea")
    assert code == 0 and "awaiting what was left running" in text
    assert runs(project) == ONCE


def test_the_same_make_twice_submits_once(project, lab):
    for shard in range(4):
        fault(project, f"poses-{shard}", AWAIT_GO)
    first = start_make(project, lab, "fea")
    await_running(project, lab, 1)
    second = start_make(project, lab, "fea")
    said = iter(second.stdout.readline, "")
    assert any("another make is at work" in line for line in said)
    (project / "runs" / "go").touch()
    texts = [process.communicate(timeout=HANG)[0] for process in (first, second)]
    assert [first.returncode, second.returncode] == [0, 0], texts
    assert runs(project) == runs(project, "fea") == ONCE


def test_a_partial_result_never_counts(project, lab):
    # The task dies half-way through its file, and so does the wrapper that would have cleaned up.
    dies = "open(out, 'w').write('half')\nos.kill(os.getppid(), 9)\nos.kill(os.getpid(), 9)\n"
    fault(project, "poses-2", dies)
    code, text = make(project, lab, "fea")
    assert code != 0 and "FAILED results/lab/10_poses/2.csv: failed (" in text
    assert there(project) == ["0", "1", "3"] and (project / "results/lab/10_poses/2.csv.part").read_text() == "half"
    (project / "faults" / "poses-2").unlink()
    assert make(project, lab, "fea")[0] == 0
    assert (project / "results/lab/10_poses/2.csv").read_text() == "log\nposes-2\n"
    assert runs(project) == [(1, 1), (1, 1), (2, 1), (1, 1)]


def test_refused_with_slurms_own_words(project, lab):
    lay_profile(project, memory_mb=50, partition="nowhere", poll_seconds=1.0)
    code, text = make(project, lab, "poses")
    assert code != 0 and "Invalid partition name specified" in text
    lay_profile(project, memory_mb=10**7, poll_seconds=1.0)
    code, text = make(project, lab, "poses")
    assert code != 0 and "Requested node configuration is not available" in text
    assert runs(project) == [(0, 0)] * 4
    lay_profile(project, memory_mb=50, poll_seconds=1.0)
    assert make(project, lab, "poses")[0] == 0


def slurmd_killed(project: Path, lab: Cluster) -> None:
    """slurmd is killed and started again."""
    for shard in range(4):
        fault(project, f"poses-{shard}", "import time\ntime.sleep(4)\n")
    process = start_make(project, lab, "poses")
    await_running(project, lab, 2)
    lab.do("kill", "slurmd")
    time.sleep(0.5)
    lab.do("start", "slurmd")
    ends_well(process)
    assert runs(project) == ONCE


def slurmctld_restarted(project: Path, lab: Cluster) -> None:
    """slurmctld is away while tasks end."""
    for shard in range(4):
        fault(project, f"poses-{shard}", "import time\ntime.sleep(3)\n")
    process = start_make(project, lab, "poses")
    await_running(project, lab, 2)
    # Ended by TERM: one that is killed forgets what it started in the last seconds, and drains the node for it.
    lab.do("stop", "slurmctld")
    time.sleep(5)  # tasks end while nobody listens
    lab.do("start", "slurmctld")
    ends_well(process)
    assert runs(project) == ONCE


def node_lost(project: Path, lab: Cluster) -> None:
    """The node is gone with all its tasks, and comes back."""
    fault(project, "poses-0", FIRST_RUN + FOR_EVER)
    fault(project, "poses-1", FIRST_RUN + FOR_EVER)
    process = start_make(project, lab, "poses")
    await_running(project, lab, 2)
    lab.do("lose")
    wait_until(lambda: "down" in lab.ask("sinfo", "-h", "-o", "%T"))  # Slurm itself must see that the node is gone
    lab.do("start", "slurmd")
    ends_well(process)
    assert runs(project) == [(2, 1), (2, 1), (1, 1), (1, 1)]


def started_again(project: Path, lab: Cluster) -> None:
    """slurmd away until Slurm gives its node up: the tasks there go on, beside those that Slurm starts in their place."""
    fault(project, "poses-0", FIRST_RUN + "while not os.path.exists('runs/go'): time.sleep(0.1)\n")
    process = start_make(project, lab, "poses", "SHARDS=0 1")
    await_running(project, lab, 1)
    lab.do("kill", "slurmd")
    wait_until(lambda: "down" in lab.ask("sinfo", "-h", "-o", "%T"))
    lab.do("start", "slurmd")
    wait_until(lambda: re.search(r"JobState=RUNNING .* Restarts=[1-9]", lab.ask("scontrol", "show", "job", "-o")))
    (project / "runs" / "go").touch()
    ends_well(process)
    assert [ended for _, ended in runs(project, shards=range(2))] == [1, 1]


def no_controller(project: Path, lab: Cluster) -> None:
    """No slurmctld answers."""
    lay_profile(project, memory_mb=50, poll_seconds=1.0, submit_seconds=0)
    lab.do("stop", "slurmctld")
    try:
        code, text = make(project, lab, "poses")
    finally:
        lab.do("start", "slurmctld")
    assert code != 0 and "Unable to contact slurm controller" in text
    code, text = make(project, lab, "poses")
    assert code == 0, text
    assert runs(project) == ONCE


def busy_controller(project: Path, lab: Cluster) -> None:
    """The controller stops answering in the middle, and may have taken what it never confirmed."""
    lay_profile(project, memory_mb=50, poll_seconds=1.0, submit_seconds=0, visible_seconds=2, array_limit=1000)
    controller = int((lab.folder / "pids" / "slurmctld").read_text())
    os.kill(controller, signal.SIGSTOP)
    try:
        code, text = make(project, lab, "poses")
    finally:
        os.kill(controller, signal.SIGCONT)
    assert code != 0 and re.search("timed out|no answer", text), text
    code, text = make(project, lab, "poses")
    assert code == 0, text
    assert runs(project) == ONCE


APART = (slurmd_killed, slurmctld_restarted, node_lost, started_again, no_controller, busy_controller)


@pytest.fixture(scope="module", autouse=True)
def apart(tmp_path_factory):
    """What takes daemons away waits for Slurm's own clocks: begun first, each case on a cluster of its own."""

    def on_its_own(case) -> None:
        with cluster(cpus=2) as made:
            case(lay_project(tmp_path_factory.mktemp(case.__name__) / "p", visible_seconds=3), made)
            wait_until(lambda: made.ask("squeue", "-h") == "")

    tmp_path_factory.getbasetemp()  # made on the first call, which must not be that of two threads
    with ThreadPoolExecutor(len(APART)) as pool:
        yield {case: pool.submit(on_its_own, case) for case in APART}


@pytest.mark.parametrize("case", APART)
def test_work_outlives_daemons_that_go(case, apart):
    apart[case].result()


def test_killed_by_the_time_limit_comes_back_with_more(overdue):
    project, process = overdue
    text = ends_well(process)
    assert "killed at its time limit of 1 min; again with 50 MiB, 2 min" in text
    assert runs(project, shards=range(2)) == [(2, 1), (1, 1)]
