"""What a person does not give has its default when a command runs."""

import os
import subprocess

import pytest


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rig"], "--plan 'workflow/rig/demo.toml'"),
        (["projection", "SENSOR=unit"], "--like 'gelsight_mini'"),
    ],
)
def test_a_variable_that_is_not_given_has_its_default(project, words, said):
    """In a project of its own: where people have made the demo, there is nothing left to make."""
    done = subprocess.run(["make", "-n", *words], cwd=project, capture_output=True, text=True, check=False)
    assert said in done.stdout, done.stdout + done.stderr


def test_jobs_are_the_machine_s_cores_whatever_a_shell_grants_one_program(project):
    """nproc obeys OMP_NUM_THREADS: with 1 of it, as numeric work often sets, every make was serial."""
    reported = ["make", "--eval=reported: ; @echo jobs=$(JOBS)", "reported", "DATASET=tiny"]
    for granted in ("1", "7777"):
        environment = os.environ | {"OMP_NUM_THREADS": granted, "OMP_THREAD_LIMIT": granted}
        done = subprocess.run(reported, cwd=project, env=environment, capture_output=True, text=True, check=False)
        assert f"jobs={len(os.sched_getaffinity(0))}\n" in done.stdout, done.stdout + done.stderr
