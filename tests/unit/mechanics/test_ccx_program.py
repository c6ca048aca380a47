"""How CalculiX is found, and what is left of a run that ends before it has an answer."""

import shlex
import sys

import numpy as np
import pytest

from gelforge.mechanics.ccx.dat import DatError, Unfinished, read_dat
from gelforge.mechanics.ccx.program import ccx_program, need_ccx, run_ccx
from gelforge.mechanics.solvers.ccx import status_of
from gelforge.records.status import Status
from tests.support.refused import refused


def program(path, text="exit 0"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A machine without CalculiX: neither named, nor on PATH, nor in the virtual environment."""
    (tmp_path / "bin").mkdir()
    monkeypatch.delenv("CCX", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    return tmp_path


def test_without_calculix_nothing_is_found(nowhere):
    assert ccx_program() is None
    refused("make setup", need_ccx)


def test_the_one_that_conda_installed_in_the_environment_is_used_where_path_has_none(nowhere, monkeypatch):
    inside = program(nowhere / "venv/conda/bin/ccx")
    assert ccx_program() == inside
    on_path = program(nowhere / "bin/ccx")
    assert ccx_program() == on_path
    monkeypatch.setenv("CCX", program(nowhere / "own/ccx_2.22"))
    assert ccx_program() == str(nowhere / "own/ccx_2.22")


def test_a_named_program_that_is_not_there_is_not_replaced_by_another(nowhere, monkeypatch):
    program(nowhere / "bin/ccx")
    monkeypatch.setenv("CCX", str(nowhere / "gone/ccx"))
    assert ccx_program() is None


@pytest.mark.processes
def test_a_run_that_ends_before_it_answers_leaves_no_answer_of_an_earlier_one(tmp_path, monkeypatch):
    for ending in ("echo CalculiX Version 2; exit 3", "kill -9 $$"):
        monkeypatch.setenv("CCX", program(tmp_path / "bin/ccx", ending))
        (tmp_path / "press.dat").write_text("displacements (vx,vy,vz) for set NALL and time  0.1000000E+01\n")
        job = run_ccx("press", tmp_path, 60.0)
        assert job.returncode != 0 and not (tmp_path / "press.dat").exists()


@pytest.mark.processes
def test_a_program_that_does_not_even_print_its_name_is_refused(tmp_path, monkeypatch):
    """Every press would be solved without it, each after some attempts."""
    for ending, said in (
        ("exit 1", "code 1 and printed: nothing"), ("exit 0", "code 0"), ("echo no libspooles.so; exit 127", "no libspooles")
    ):  # fmt: skip
        monkeypatch.setenv("CCX", program(tmp_path / "bin/ccx", ending))
        refused(f"bin/ccx is not a working CalculiX: it ended with .*{said}", run_ccx, "press", tmp_path, 60.0)


@pytest.mark.processes
def test_the_memory_of_a_run_is_its_own(tmp_path, monkeypatch):
    """Neither that of a larger one before it, nor that of the process which starts it."""
    held = np.ones(2**25)  # 256 MiB
    hold = f'exec {shlex.quote(sys.executable)} -c \'import time; x = bytes(b"1") * int(sys.argv[1]); print("CalculiX Version"); time.sleep(0.3)\''
    found = []
    for size in (2**28, 2**20):
        monkeypatch.setenv("CCX", program(tmp_path / "bin/ccx", hold.replace("int(sys.argv[1])", str(size))))
        found.append(run_ccx("press", tmp_path, 60.0).peak_mib)
    assert held[0] and found[0] > 256.0 > 128.0 > found[1] > 1.0


def test_a_table_that_cannot_be_read_is_distinguished_from_a_load_that_was_not_reached():
    assert status_of(Unfinished("nothing printed")) is Status.DIVERGED
    assert status_of(DatError("no number")) is Status.UNREADABLE
    assert read_dat("") == []
