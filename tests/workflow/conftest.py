"""Small datasets in a project folder of their own."""

import os
import shutil

import pytest

from gelforge.flow.files import read_csv, write_csv, write_text
from tests.benchmarks.sandbox import link_project

NEEDS_SLURM = [
    pytest.mark.slurm,
    pytest.mark.skipif(
        not shutil.which("slurmd", path=f"{os.environ.get('PATH', '')}:/usr/sbin"),
        reason="Slurm is absent; make test installs slurm-wlm and munge where it may",
    ),
]
# Coarse and in-process: the flow is on trial here, not the mechanics.
FAST = """
[params.plan]
shard_size = 2

[params.fea]
method = "draft"
tolerance = 0.2
"""


def lay_dataset(project, root, name, count, overrides=FAST):
    """Copy the first `count` presses of the demo log into data/NAME of a sandbox."""
    demo, data = root / "data" / "demo", project / "data" / name
    rows = read_csv(demo / "log.csv")[:count]
    write_csv(data / "log.csv", list(rows[0]), rows)
    base = (demo / "dataset.toml").read_text(encoding="utf-8").split("[params")[0]
    write_text(data / "dataset.toml", base + overrides)
    for row in rows:
        (data / row["image"]).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(demo / row["image"], data / row["image"])
    return data


@pytest.fixture
def project(root, tmp_path):
    """A sandbox with the dataset `tiny`: four presses in two shards."""
    project = link_project(root, tmp_path / "project")
    lay_dataset(project, root, "tiny", 4)
    return project


@pytest.fixture
def alone(root, tmp_path):
    """A sandbox of one press of its own, for what changes it beyond repair."""
    project = link_project(root, tmp_path / "project")
    lay_dataset(project, root, "tiny", 1)
    return project
