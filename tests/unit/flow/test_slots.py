"""A program of several processes inside make runs no more of them than make has slots, beside make's other jobs."""

import multiprocessing
import os
import subprocess
import sys

import pytest

from gelforge.flow.jobs import handed_on, in_slots
from tests.support.sandbox import clean_environment
from tests.support.waiting import HANG

# Each task is marked by a file while it runs, as is the other job of make, and looks how many there are. It ends once as many
# run beside each other as there are slots, or all tasks have begun, and a moment later, so that more would be seen.
TASKS = """
import sys, time
from pathlib import Path
from gelforge.flow.jobs import in_slots
slots = int(sys.argv[1])
def running():
    return len(list(Path("running").iterdir()))
def task(k):
    mark = Path(f"running/{k}")
    mark.touch()
    Path(f"begun/{k}").touch()
    until = time.monotonic() + 120
    while running() < slots and len(list(Path("begun").iterdir())) < 6:
        assert time.monotonic() < until, "a slot stays empty"
        time.sleep(0.02)
    time.sleep(0.1)
    Path(f"seen/{k}").write_text(str(running()))
    mark.unlink()
    return k
try:
    assert list(in_slots(task, [(k,) for k in range(6)], 4)) == list(range(6))
finally:
    Path("done").touch()
"""
MAKEFILE = """
SHELL := bash
both: tasks other
tasks:
	+@$(PYTHON) -m gelforge.flow.step results/d/calibrate/x.json -- bash -c '$(PYTHON) tasks.py $(SLOTS) && touch results/d/calibrate/x.json.part'
other:
	@touch running/other; until [ -e done -o -e seen/2 ]; do sleep 0.05; done; rm running/other
"""


@pytest.mark.parametrize(("slots", "goal"), [(3, "both"), (2, "tasks")])
@pytest.mark.processes
def test_processes_and_other_jobs_together_take_all_slots_and_no_more(tmp_path, slots, goal):
    for name in ("begun", "running", "seen"):
        (tmp_path / name).mkdir()
    (tmp_path / "tasks.py").write_text(TASKS)
    (tmp_path / "Makefile").write_text(MAKEFILE)
    done = subprocess.run(
        ["make", f"PYTHON={sys.executable}", f"SLOTS={slots}", f"-j{slots}", goal], cwd=tmp_path, env=clean_environment(),
        text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=HANG, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "jobserver" not in done.stdout  # make has got all its slots back
    seen = [int(path.read_text()) for path in (tmp_path / "seen").iterdir()]
    assert len(seen) == 6 and max(seen) == slots


BOTH = multiprocessing.Barrier(2)


def pair(k):
    """A task that ends once another one runs beside it."""
    BOTH.wait(HANG)
    return k


@pytest.mark.processes
def test_without_slots_of_a_make_there_are_as_many_as_are_asked_for(monkeypatch):
    for flags in ("", f"-j --jobserver-auth={2**20},{2**20 + 1}", "--jobserver-auth=fifo:/nowhere"):
        monkeypatch.setenv("MAKEFLAGS", flags)
        assert list(in_slots(pair, [(k,) for k in range(4)], 2)) == [0, 1, 2, 3]
        assert list(in_slots(abs, [(-7,)], 2)) == [7] and list(in_slots(pair, [], 2)) == []


def test_descriptors_that_are_no_slots_are_not_handed_on(tmp_path):
    """A recipe that gets none still has their numbers in MAKEFLAGS, and other files may have taken them."""
    with (tmp_path / "a").open("w") as one, (tmp_path / "b").open("w") as other:
        flags = f"rR -j2 --jobserver-auth={one.fileno()},{other.fileno()} -- A=b"
        assert handed_on({"MAKEFLAGS": flags, "X": "y"}) == ((), {"MAKEFLAGS": "rR -j2 -- A=b", "X": "y"})
    pipe = os.pipe()
    flags = f"rR -j2 --jobserver-auth={pipe[0]},{pipe[1]}"
    assert handed_on({"MAKEFLAGS": flags}) == (pipe, {"MAKEFLAGS": flags})
    for number in pipe:
        os.close(number)
    assert handed_on({}) == ((), {})


@pytest.mark.processes
def test_a_task_that_fails_is_not_passed_over():
    with pytest.raises(ZeroDivisionError):
        list(in_slots(divmod, [(1, 1), (1, 0)], 2))
