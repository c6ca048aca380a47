"""Small datasets in a project folder of their own."""

import os
import shutil

import pytest

from gelforge.flow.files import alone as alone_with
from gelforge.flow.files import read_csv, write_csv, write_text
from tests.support.sandbox import CALIBRATED, FAST, REPORTED, lay_dataset, link_project, make

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
def once(root, tmp_path_factory):
    """A sandbox of a name, filled by a function of the project and its folder; tests copy it.

    Workers of pytest share it: the first one makes it while the others wait.
    """
    base = tmp_path_factory.getbasetemp()

    def made(name, fill):
        project = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
        with alone_with(project):
            if not (project / "made").exists():
                link_project(root, project)
                fill(root, project)
                (project / "made").touch()
        return project

    return made


def copy_of(project, folder):
    """A copy of a sandbox, as `cp -a` makes it, of which nothing is outdated."""
    return shutil.copytree(project, folder / project.name, symlinks=True)


def make_whole(root, project):
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
def whole(once, tmp_path):
    """A copy of a sandbox whose dataset `tiny`, six presses in two shards, is made up to its report."""
    return copy_of(once("whole", make_whole), tmp_path)


def make_calibrated(root, project):
    data = project / "data/demo"
    data.mkdir()
    shutil.copy(root / "data/feats_sphere15/log.csv", data)
    write_text(data / "dataset.toml", CALIBRATED + "[params.plan]\nshard_size = 1\n")
    done = make(project, "-j2", "demo")
    assert done.returncode == 0, done.stdout
    write_text(project / "said.txt", done.stdout)


@pytest.fixture
def calibrated(once, tmp_path):
    """A copy of a sandbox whose `demo`, the four published presses of a ball in four shards, is made with two job slots.

    Labels follow their own calibration; there are no images, so the page ends at labels. said.txt: what make printed.
    """
    return copy_of(once("calibrated", make_calibrated), tmp_path)
