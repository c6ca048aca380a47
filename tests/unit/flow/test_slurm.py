"""The profile of a cluster: tables that override each other, and settings that cannot be."""

import re
import subprocess
from pathlib import Path

import pytest

from gelforge.flow.slurm import read_profile, script_of
from tests.support.refused import refused


def own(folder: Path, text: str) -> Path:
    """A profile of one's own beside the published one."""
    path = folder / "own.toml"
    path.write_text(text)
    return path


def test_a_stage_overrides_the_default_and_an_own_file_the_published_one(tmp_path, root):
    path = own(
        tmp_path,
        '[default]\npartition = "cpu"\ncores = 3\nmemory_mb = 9\n[labels]\noptions = ["--qos=short"]\nmemory_mb = 0\n',
    )
    labels, train = read_profile(path, "labels"), read_profile(path, "train")
    assert {"--partition=cpu", "--cpus-per-task=3", "--time=120", "--qos=short"} < set(labels.sbatch_options())
    assert not any(option.startswith("--mem") for option in labels.sbatch_options())
    # A stage's own table is narrower than [default], whichever file it stands in.
    assert {"--gres=gpu:1", "--cpus-per-task=4", "--mem=16000M"} < set(train.sbatch_options())
    assert read_profile(path, "calibrate") == read_profile(path, "forces")
    local = read_profile(root / "envs" / "slurm-cluster.toml", "train")
    assert local.options == () and local.cores == 1


def test_a_wrong_profile_is_named(tmp_path):
    for line, words in (
        ("memory = 3", "[labels] memory: unknown key; did you mean memory_mb?"),
        ("cores = 0", "[labels] cores = 0: give a whole number from 1"),
        ("options = [1]", "give a list"),
        ("visible_seconds = true", "give a number from 0"),
        ('options = ["--clusters=b"]', "name another cluster by export SLURM_CLUSTERS=NAME"),
        ('options = ["-Mb"]', "name another cluster by export SLURM_CLUSTERS=NAME"),
    ):
        refused(re.escape(words), read_profile, own(tmp_path, f"[labels]\n{line}\n"), "labels")


@pytest.mark.processes
def test_a_line_of_setup_that_fails_ends_the_job(tmp_path):
    """Such as a module that is not there: the command would run with other programs than those that were asked for."""
    profile = own(tmp_path, '[default]\nsetup = ["export WORD=said", "SETUP"]\n').read_text()
    for line, said, ended in (
        ("true", "said\n", "exit code 3"),
        ("cd /none", "setup failed: cd /none\n", "exit code 1"),
    ):
        path = own(tmp_path, profile.replace("SETUP", line))
        job = script_of(["bash", "-c", "echo $WORD; exit 3"], read_profile(path, "fea"))
        done = subprocess.run(["bash", "-c", job], capture_output=True, text=True, check=False)
        assert said in done.stdout and done.stdout.endswith(f"{ended}\n"), done.stdout
