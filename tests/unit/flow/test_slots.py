"""A program of several processes inside make runs no more of them than make has slots, beside make's other jobs."""

import multiprocessing
import os
import subprocess
import sys

import pytest

from gelforge.flow.slots import handed_on, in_slots
from tests.benchmarks.sandbox import clean_environment
from tests.support.waiting import HANG

# Each task is marked by a file while it runs, as is the other job of make; each looks how many there are.
TASKS = """
import os, sys, time
from pathlib import Path
from gelforge.flow.slots import in_slots
alone = len(sys.argv) > 1
def task(k):
    mark = Path(f"running/{k}")
    mark.touch()
    until = time.monotonic() + (600 if alone else 0.3)
    while time.monotonic() < until and not (alone and (k > 1 or Path("two").exists())):
        if alone and len(list(Path("running").iterdir())) == 2:
            Path("two").touch()
        time.sleep(0.02)
    Path(f"seen/{k}").write_text(str(len(list(Path("running").iterdir()))))
    mark.unlink()
    return k
assert list(in_slots(task, [(k,) for k in range(6)], 4)) == list(range(6))
Path("done").touch()
"""
MAKEFILE = """
SHELL := bash
both: tasks other
tasks:
	+@$(PYTHON) -m gelforge.flow.step results/d/calibrate/x.json -- bash -c '$(PYTHON) tasks.py $(ALONE) && touch results/d/calibrate/x.json.part'
other:
	@touch running/other; until [ -e done -o -e seen/2 ]; do sleep 0.05; done; rm running/other
"""


def run_make(folder, *words):
    for name in ("running", "seen"):
        (folder / name).mkdir()
    (folder / "tasks.py").write_text(TASKS)
    (folder / "Makefile").write_text(MAKEFILE)
    done = subprocess.run(
        ["make", f"PYTHON={sys.executable}", "ALONE=", *words], cwd=folder, env=clean_environment(), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=HANG, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "jobserver" not in done.stdout  # make has got all its slots back
    return [int(path.read_text()) for path in sorted((folder / "seen").iterdir())]


@pytest.mark.parametrize("slots", [2, 3])
def test_processes_and_other_jobs_together_are_no_more_than_the_slots(tmp_path, slots):
    assert max(run_make(tmp_path, f"-j{slots}", "both")) <= slots


def test_slots_that_are_free_are_used(tmp_path):
    assert len(run_make(tmp_path, "-j2", "tasks", "ALONE=yes")) == 6


BOTH = multiprocessing.Barrier(2)


def pair(k):
    """A task that ends once another one runs beside it."""
    BOTH.wait(HANG)
    return k


@pytest.mark.parametrize("flags", ["", "-j --jobserver-auth=3,4", "--jobserver-auth=fifo:/nowhere"])
def test_without_slots_of_a_make_there_are_as_many_as_are_asked_for(monkeypatch, flags):
    monkeypatch.setenv("MAKEFLAGS", flags if "3,4" not in flags else f"-j --jobserver-auth={2**20},{2**20 + 1}")
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


def test_a_task_that_fails_is_not_passed_over():
    with pytest.raises(ZeroDivisionError):
        list(in_slots(divmod, [(1, 1), (1, 0)], 2))
