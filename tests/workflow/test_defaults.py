"""What a person does not give has its default when a command runs."""

import subprocess

import pytest


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rig"], "--plan 'workflow/rig/demo.toml'"),
        (["projection", "SENSOR=unit"], "--like 'gelsight_mini'"),
        (["poses", "EXECUTOR=slurm", "DATASET=tiny"], "--profile 'workflow/slurm.toml'"),
    ],
)
def test_a_variable_that_is_not_given_has_its_default(project, words, said):
    """In a project of its own: where people have made the demo, there is nothing left to make."""
    done = subprocess.run(["make", "-n", *words], cwd=project, capture_output=True, text=True, check=False)
    assert said in done.stdout, done.stdout + done.stderr
