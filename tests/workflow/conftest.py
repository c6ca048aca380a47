"""Small datasets in a project folder of their own."""

import shutil

import pytest

from gelforge.flow.files import alone as alone_with
from gelforge.flow.files import read_csv, write_csv, write_text
from tests.support.sandbox import FAST, REPORTED, lay_dataset, link_project, make

TRAINED = """
[params.report]
branches = []

[params.train]
epochs = 1
epoch_images = 4
"""
NETWORK = '\n[tiny]\nkind = "unet"\nwidths = [4, 8]\n'


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


@pytest.fixture(scope="session")
def made_whole(root, tmp_path_factory, worker_id):
    """A sandbox whose dataset `tiny`, six presses in two shards, is made up to its report; tests copy it.

    Workers of pytest share it: the first one makes it while the others wait.
    """
    base = tmp_path_factory.getbasetemp()
    project = (base if worker_id == "master" else base.parent) / "whole"
    with alone_with(project):
        if not (project / "made").exists():
            make_whole(root, project)
            (project / "made").touch()
    return project


def make_whole(root, project):
    link_project(root, project)
    data = lay_dataset(project, root, "tiny", 6, FAST.replace("shard_size = 2", "shard_size = 3") + TRAINED)
    shutil.copytree(root / "data/demo/nocontact", data / "nocontact")
    names = [row["sample_id"] for row in read_csv(data / "log.csv")]
    splits = [{"sample_id": name, "split": "val" if at > 4 else "train"} for at, name in enumerate(names)]
    write_csv(data / "splits.csv", ["sample_id", "split"], splits)
    models = project / "workflow/models.toml"
    write_text(models, models.read_text(encoding="utf-8") + NETWORK)
    done = make(project, *REPORTED)
    assert done.returncode == 0, done.stdout[-3000:]


@pytest.fixture
def whole(made_whole, tmp_path):
    """A copy of it, as `cp -a` makes it, of which nothing is outdated."""
    return shutil.copytree(made_whole, tmp_path / "whole", symlinks=True)
