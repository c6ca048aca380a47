"""EXECUTOR=slurm on a real cluster: what a cluster does to work, with nothing lost, left running or done twice."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gelforge.flow.files import write_text
from tests.support import sandbox
from tests.support.cluster import NEEDS_SLURM, ROOT, Cluster, cluster, lay_profile, lay_project, make, start_make
from tests.support.sandbox import lay_dataset
from tests.support.waiting import HANG, wait_until

slow = pytest.mark.slow
needs_slurm = [*NEEDS_SLURM, slow]
SLEEP = f"time.sleep({2 * HANG})\n"
FOR_EVER = f"import time\n{SLEEP}"
ONCE_FOR_EVER = f"import time\nif open(f'runs/{{name}}').read().count('started') == 1:\n    {SLEEP}"
AWAIT_GO = "import time\nwhile not os.path.exists('runs/go'): time.sleep(0.1)\n"
ONCE = [(1, 1)] * 4


@pytest.fixture(scope="module")
def lab():
    """A cluster of two cores; each test leaves it running and empty."""
    with cluster(cpus=2) as made:
        yield made


@pytest.fixture
def project(tmp_path, lab):
    """A project of four shards, in a folder with a difficult name; afterwards nothing of it may be left in the queue."""
    yield lay_project(tmp_path / "it's 100%a ä")
    wait_until(lambda: lab.ask("squeue", "-h") == "")


def fault(project: Path, name: str, code: str) -> None:
    """Make the task NAME run `code` before it writes its result."""
    (project / "faults" / name).write_text(code)


def runs(project: Path, stage: str = "fea", shards=range(4)) -> list[tuple[int, int]]:
    """How often each task was begun and how often it came to its end."""
    paths = [project / "runs" / f"{stage}-{shard}" for shard in shards]
    texts = [path.read_text() if path.exists() else "" for path in paths]
    return [(text.count("started"), text.count("ended")) for text in texts]


def there(project: Path, stage: str = "30_fea") -> list[str]:
    """Results that are there under their final names."""
    return sorted(path.stem for path in (project / "results" / "lab" / stage).glob("[0-9].???"))


def await_running(project: Path, count: int) -> None:
    """Wait until `count` tasks of stage 30 have begun."""
    wait_until(lambda: sum(started > ended for started, ended in runs(project)) >= count)


def succeeds(process) -> str:
    """What a make that was begun printed, at its end."""
    text, _ = process.communicate(timeout=HANG)
    assert process.returncode == 0, text
    return text


class TestSmoke:
    pytestmark = needs_slurm

    def test_equals_local_and_nothing_is_left_to_do(self, project, lab, tmp_path):
        code, text = make(project, lab, "whole")
        assert code == 0, text
        assert [runs(project, stage) for stage in ("poses", "fea", "forces")] == [ONCE] * 3
        assert "Nothing to be done" in make(project, lab, "-n", "whole")[1]
        local = lay_project(tmp_path / "local")
        assert make(local, lab, "whole", "EXECUTOR=local")[0] == 0
        made = [path for path in (local / "results" / "lab").rglob("[0-9][0-9]_*/*") if "metrics" not in path.parts]
        made = [path for path in made if "logs" not in path.parts]
        assert len(made) == 13
        for path in made:
            assert path.read_bytes() == (project / path.relative_to(local)).read_bytes()
        assert not list((project / "results").glob(".slurm-*"))


class TestEnd:
    pytestmark = needs_slurm

    def test_a_cluster_ends_with_the_process_that_it_is_for(self, tmp_path):
        """Tests that a person stops leave no daemons behind."""
        program = "from tests.support.cluster import cluster\nwith cluster() as made: print(made.folder, flush=True); input()"
        process = subprocess.Popen(
            [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
        )
        folder = process.stdout.readline().strip()
        assert Path(folder, "slurm.conf").exists()
        process.kill()
        process.wait()
        wait_until(lambda: not Path(folder).exists())
        assert not subprocess.run(["pgrep", "-f", folder], capture_output=True).stdout


class TestWork:
    pytestmark = needs_slurm

    def test_labels_of_the_flow_are_those_of_one_machine(self, lab, root, tmp_path):
        for executor in ("local", "slurm"):
            project = sandbox.link_project(root, tmp_path / executor)
            lay_dataset(project, root, "tiny", 4)
            profile = f"SLURM_PROFILE={root / 'envs/slurm-cluster.toml'}"
            code, text = make(project, lab, "labels", "DATASET=tiny", f"EXECUTOR={executor}", profile)
            assert code == 0, text
        labels = sorted((tmp_path / "local/results/tiny/50_labels/24x32").glob("*.npz"))
        assert len(labels) == 2
        for path in labels:
            one, other = np.load(path), np.load(tmp_path / "slurm" / path.relative_to(tmp_path / "local"))
            assert one.files == other.files
            for key in one.files:  # NaN: not stated
                np.testing.assert_array_equal(one[key], other[key], key)

    def test_a_changed_input_reaches_the_end_in_one_make(self, project, lab):
        """What was only touched is dated anew, and no job is submitted for it."""
        assert make(project, lab, "forces")[0] == 0
        (project / "log.csv").touch()
        assert make(project, lab, "forces")[0] == 0
        assert [runs(project, stage) for stage in ("poses", "fea", "forces")] == [ONCE] * 3
        write_text(project / "log.csv", "changed\n")
        assert make(project, lab, "forces")[0] == 0
        assert [runs(project, stage) for stage in ("poses", "fea", "forces")] == [[(2, 2)] * 4] * 3
        assert "Nothing to be done" in make(project, lab, "-n", "forces")[1]

    def test_one_file_by_its_name_takes_only_what_it_needs(self, project, lab):
        code, text = make(project, lab, "results/lab/30_fea/2.csv")
        assert code == 0, text
        assert there(project, "10_poses") == there(project) == ["2"]

    def test_a_training_that_fails_leaves_the_network_before_it(self, project, lab):
        network = project / "results/lab/70_train/whole.pt"
        assert make(project, lab, "whole")[0] == 0
        kept = network.read_bytes()
        write_text(project / "log.csv", "changed\n")
        fault(project, "whole", "sys.exit(3)\n")
        code, text = make(project, lab, "whole")
        assert code != 0 and "FAILED results/lab/70_train/whole.pt (exit 3)" in text
        assert network.read_bytes() == kept
        (project / "faults/whole").unlink()
        assert make(project, lab, "whole")[0] == 0 and network.read_bytes() != kept


@pytest.fixture
def wrapped(tmp_path):
    """The PATH of a site with banners around Slurm's programs, and settings of an allocation in which make runs."""
    for program in ("sbatch", "scancel"):
        script = tmp_path / "bin" / program
        banner = 'echo "Welcome! 3 of 12 nodes are down."; echo "job 7 on cluster lab" >&2'
        write_text(script, f'#!/bin/bash\n{banner}\n{shutil.which(program)} "$@"\ncode=$?\n{banner}\nexit $code\n')
        script.chmod(0o755)
    path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
    return {"PATH": path, "SQUEUE_FORMAT": "%i", "SLURM_MEM_PER_NODE": "9999999", "SCANCEL_STATE": "PENDING"}


class TestFailure:
    pytestmark = needs_slurm

    def test_a_task_that_fails_is_shown_and_the_others_go_on(self, project, lab):
        """One ends with an error, one is killed while it writes: its part never counts."""
        fault(project, "fea-2", "print('sample s17 diverged')\nsys.exit(1)\n")
        fault(project, "fea-3", "open(out, 'w').write('half')\nos.kill(os.getpid(), 9)\n")
        code, text = make(project, lab, "-k", "forces")
        assert code != 0 and "FAILED results/lab/30_fea/2.csv (exit 1); log: results/lab/logs/30_fea/2.log" in text
        assert "sample s17 diverged" in text and "FAILED results/lab/30_fea/3.csv (exit 1" in text
        assert there(project, "30_fea") == ["0", "1"] == there(project, "40_forces")
        for name in ("fea-2", "fea-3"):
            (project / "faults" / name).unlink()
        code, text = make(project, lab, "forces")
        assert code == 0, text
        assert runs(project, "fea") == [(1, 1), (1, 1), (2, 1), (2, 1)] and runs(project, "forces") == ONCE
        assert (project / "results/lab/30_fea/3.csv").read_text() == "log\nposes-3\nfea-3\n"

    def test_a_task_killed_at_a_limit_names_the_setting(self, project, lab):
        """Limits of time are whole minutes, so that both kinds are tried at once."""
        lay_profile(project, time_minutes=1)
        fault(project, "fea-0", FOR_EVER)
        fault(project, "fea-1", f"held = b'x' * (120 * 2**20)\n{FOR_EVER}")
        code, text = make(project, lab, "-k", "fea")
        assert code != 0 and there(project) == ["2", "3"]
        for limit in ("time_minutes = 1", "memory_mb = 50"):
            assert f"killed at its limit {limit}; raise it in own.toml ([work] or [default])" in text, text

    def test_exit_code_0_without_a_result_is_a_failure(self, project, lab):
        """As that of a task that somebody cancelled before it began; Slurm may have forgotten it besides."""
        for shard in range(3):
            fault(project, f"fea-{shard}", AWAIT_GO)
        process = start_make(project, lab, "-k", "fea", "SHARDS=0 1 2")
        await_running(project, 2)
        wait_until(lambda: "PD" in lab.ask("squeue", "-h", "-o", "%t"))
        lab.ask("scancel", "--state=PENDING", f"--user={os.getuid()}")
        (project / "runs" / "go").touch()
        text, _ = process.communicate(timeout=HANG)
        assert process.returncode != 0 and "the job left no exit code, it was cancelled or did not run" in text
        assert len(there(project)) == 2

    def test_refused_with_slurm_s_own_words(self, project, lab):
        for settings, words in (
            ({"partition": "nowhere"}, "Invalid partition name specified"),
            ({"memory_mb": 10**6}, "Requested node configuration is not available"),
        ):
            lay_profile(project, **settings, visible_seconds=2 * HANG)
            code, text = make(project, lab, "fea")
            assert code != 0 and words in text, text
        assert runs(project) == [(0, 0)] * 4
        lay_profile(project)
        assert make(project, lab, "fea")[0] == 0

    @pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
    def test_interrupted_make_leaves_nothing_in_the_queue(self, project, lab, wrapped, how):
        fault(project, "fea-3", ONCE_FOR_EVER)
        lay_profile(project, time_minutes=60)  # no limit of time ends the job in make's place
        site = wrapped if how == signal.SIGINT else {}
        process = start_make(project, lab, "fea", **site)
        wait_until(lambda: there(project) == ["0", "1", "2"] and runs(project)[3] == (1, 0))
        # A terminal interrupts the whole group; a kill reaches make alone.
        (os.killpg if how == signal.SIGINT else os.kill)(process.pid, how)
        text, _ = process.communicate(timeout=HANG)
        assert process.returncode != 0
        assert how != signal.SIGINT or "interrupted; the same make goes on with it" in text
        wait_until(lambda: lab.ask("squeue", "-h") == "")
        assert "3" not in there(project)  # make removes a target whose step had not ended yet
        code, text = make(project, lab, "fea", **site)
        assert code == 0, text
        assert there(project) == list("0123") and runs(project)[3] == (2, 1)


def controller_restarted(project: Path, lab: Cluster) -> None:
    """slurmctld is away while tasks end."""
    fault(project, "fea-0", AWAIT_GO)
    process = start_make(project, lab, "fea")
    await_running(project, 1)
    # Ended by TERM: one that is killed forgets what it started in the last seconds, and drains the node for it.
    lab.do("stop", "slurmctld")
    (project / "runs" / "go").touch()
    time.sleep(5)  # tasks end while nobody listens
    lab.do("start", "slurmctld")
    succeeds(process)
    assert runs(project) == ONCE


def node_lost(project: Path, lab: Cluster) -> None:
    """The node is gone with all its tasks, and comes back."""
    fault(project, "fea-0", ONCE_FOR_EVER)
    process = start_make(project, lab, "fea")
    wait_until(lambda: runs(project)[0] == (1, 0))
    wait_until(
        lambda: len(lab.ask("squeue", "-h", "-r").splitlines()) == 1
    )  # a task whose end Slurm missed runs again
    lab.do("lose")
    wait_until(lambda: "down" in lab.ask("sinfo", "-h", "-o", "%T"))  # Slurm itself must see that the node is gone
    lab.do("start", "slurmd")
    succeeds(process)
    assert runs(project) == [(2, 1), (1, 1), (1, 1), (1, 1)]


class TestDaemons:
    pytestmark = needs_slurm

    @pytest.mark.parametrize("case", [controller_restarted, node_lost])
    def test_work_outlives_daemons_that_go(self, case, tmp_path):
        with cluster(cpus=2) as made:
            case(lay_project(tmp_path / "p"), made)
            wait_until(lambda: made.ask("squeue", "-h") == "")

    def test_without_a_controller_make_says_so_and_goes_on_with_one(self, project, lab):
        lab.do("stop", "slurmctld")
        try:
            code, text = make(project, lab, "fea")
        finally:
            lab.do("start", "slurmctld")
        assert code != 0 and "Unable to contact slurm controller" in text
        assert make(project, lab, "fea")[0] == 0 and runs(project) == ONCE
