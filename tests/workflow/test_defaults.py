"""What a person does not give has its default when a command runs."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rig"], "--plan 'workflow/rig/demo.toml'"),
        (["projection", "SENSOR=unit"], "--like 'gelsight_mini'"),
        (["poses", "EXECUTOR=slurm", "DATASET=demo"], "--profile 'workflow/slurm.toml'"),
    ],
)
def test_a_variable_that_is_not_given_has_its_default(words, said):
    done = subprocess.run(["make", "-n", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    assert said in done.stdout, done.stdout + done.stderr
