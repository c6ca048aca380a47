"""A make that dies anywhere leaves whole files or none: the next one ends as if nothing had happened."""

import os
import signal
import subprocess

import pytest

from gelforge.flow.files import write_text
from tests.support.sandbox import clean_environment, lay_dataset, link_project, make
from tests.support.waiting import HANG

# In the place of what Python imports of itself at its start: notes what all processes rename to, and kills them all before one.
AT_START = """
import os, signal
rename = os.replace
def replace(*paths, **options):
    name = os.path.relpath(paths[1])
    if name == os.environ.get("KILL_AT"):
        os.killpg(0, signal.SIGKILL)
    with open(os.environ["RENAMED"], "a") as stream:
        stream.write(name + "\\n")
    return rename(*paths, **options)
if "RENAMED" in os.environ:
    os.replace = replace
"""
MADE = ("00_plan", "10_poses", "15_images", "30_fea", "40_forces", "50_labels")


def laid(root, folder):
    """A sandbox with a dataset of one press, whose processes note their renames."""
    project = link_project(root, folder)
    (project / "src").unlink()
    (project / "src").mkdir()
    (project / "src/gelforge").symlink_to(root / "src/gelforge")
    write_text(project / "src/sitecustomize.py", AT_START)
    lay_dataset(project, root, "tiny", 1)
    return project


def begun(project, **environment: str) -> subprocess.Popen:
    """A make of the labels, with all that it starts in a group of processes."""
    return subprocess.Popen(
        ["make", "-j1", "labels", "DATASET=tiny"],
        cwd=project,
        env={**clean_environment(), "RENAMED": str(project / "renamed"), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def contents(project) -> dict[str, bytes]:
    """Bytes of all results by their place; what a process of a number left is none of them."""
    results = project / "results/tiny"
    found = [path for name in MADE for path in (results / name).rglob("*") if path.is_file()]
    return {str(path.relative_to(results)): path.read_bytes() for path in found if not path.name.startswith(".")}


@pytest.mark.slow
def test_a_make_that_is_killed_at_renames_ends_as_one_that_was_not(root, tmp_path):
    """At an early one, then at later ones, each time that it goes on: in the plan, in a stage, and of the last target and its record."""
    whole, project = laid(root, tmp_path / "whole"), laid(root, tmp_path / "killed")
    said, _ = (first := begun(whole)).communicate(timeout=HANG)
    assert first.returncode == 0, said
    renamed, expected = (whole / "renamed").read_text().splitlines(), contents(whole)
    names = [name for name in dict.fromkeys(renamed) if name.startswith("results/")]
    assert len(names) > 40 and len(expected) > 25
    for name in (names[1], names[len(names) // 2], names[-4], names[-1]):
        killed = begun(project, KILL_AT=name)
        said, _ = killed.communicate(timeout=HANG)
        assert killed.returncode == -signal.SIGKILL, (name, said)
    said, _ = (again := begun(project)).communicate(timeout=HANG)
    assert again.returncode == 0, said
    assert contents(project) == expected


def test_two_makes_that_plan_at_once_end_as_one(root, tmp_path):
    """Neither reads what the other is writing, nor removes what the other has planned."""
    project = link_project(root, tmp_path / "project")
    lay_dataset(project, root, "tiny", 2)
    both = [
        subprocess.Popen(
            ["make", "poses", "DATASET=tiny"], cwd=project, env=clean_environment(), text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )
        for _ in range(2)
    ]  # fmt: skip
    for process in both:
        said, _ = process.communicate(timeout=HANG)
        assert process.returncode == 0, said
    assert "flow.step" not in make(project, "-n", "poses", "DATASET=tiny").stdout
    assert sorted(os.listdir(project / "results/tiny/10_poses")) == ["0000", "0000.csv", "0000.rejected.csv"]
