"""Small datasets in a project folder of their own."""

import pytest

from tests.support.sandbox import lay_dataset, link_project


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
