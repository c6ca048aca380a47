"""Make goes by dates, the wrapper by contents: what did not change is not made again, and what reads a change is."""

import os
import random
import shutil
import time

import pytest

from gelforge.flow.files import read_csv, write_csv, write_text
from tests.support.sandbox import FAST, lay_dataset, link_project, make

TRAINED = """
[params.report]
branches = []

[params.train]
epochs = 1
epoch_images = 4
"""
NETWORK = '\n[tiny]\nkind = "unet"\nwidths = [4, 8]\n'
GOAL = ("evaluate", "report", "MODEL=tiny", "DATASET=tiny", "RES=6x8")


@pytest.fixture(scope="module")
def built(root, tmp_path_factory):
    """A sandbox whose dataset is made up to its report, which tests copy."""
    project = link_project(root, tmp_path_factory.mktemp("fresh") / "project")
    data = lay_dataset(project, root, "tiny", 8, FAST.replace("shard_size = 2", "shard_size = 4") + TRAINED)
    shutil.copytree(root / "data/demo/nocontact", data / "nocontact")
    names = [row["sample_id"] for row in read_csv(data / "log.csv")]
    splits = [{"sample_id": name, "split": "val" if at > 5 else "train"} for at, name in enumerate(names)]
    write_csv(data / "splits.csv", ["sample_id", "split"], splits)
    models = project / "workflow/models.toml"
    write_text(models, models.read_text(encoding="utf-8") + NETWORK)
    made(project)
    return project


@pytest.fixture
def project(built, tmp_path):
    """A copy of it, as `cp -a` makes it."""
    return shutil.copytree(built, tmp_path / "project", symlinks=True)


def made(project) -> set[str]:
    """Make all of it; the targets whose commands ran, but the plan."""
    began = time.time_ns()
    done = make(project, *GOAL)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "flow.step" not in make(project, "-n", *GOAL).stdout
    logs = project / "results/tiny/logs"
    found = {
        str(path.relative_to(logs).with_suffix("")) for path in logs.rglob("*.log") if path.stat().st_mtime_ns > began
    }
    return found - {"00_plan/plan"}


def files(project) -> list:
    """All files of a project but links and locks."""
    return [
        path for path in project.rglob("*") if path.is_file() and not path.is_symlink() and path.suffix != ".lock"
    ]


def anew(project):
    """As a fresh clone, or a copy by another program: all files of people are new, in any order."""
    for folder in ("data", "workflow"):
        for path in files(project / folder):
            kept = path.read_bytes()
            path.unlink()
            path.write_bytes(kept)


def at_random(project):
    """Dates of the last hour, whatever was made first."""
    numbers = random.Random(7)
    for path in files(project):
        at = time.time() - numbers.uniform(0, 3600)
        os.utime(path, (at, at))


def unread(project):
    """A comment, a network and a sensor that nothing asks for, a time limit and a share that no solve depends on."""
    for name, text in (
        ("models.toml", NETWORK.replace("tiny", "other")),
        ("sensors.toml", "# a comment\n"),
    ):
        path = project / "workflow" / name
        write_text(path, path.read_text(encoding="utf-8") + text)


@pytest.mark.parametrize(
    "change", [lambda project: [os.utime(path) for path in files(project)], at_random, anew, unread],
    ids=["touched", "dates at random", "checked out anew", "what is not read"],
)  # fmt: skip
def test_nothing_runs_where_no_content_changed(project, change):
    change(project)
    assert made(project) == set()


def test_a_parameter_on_which_no_solve_depends_trains_nothing(project):
    """Stage 30 reads it, finds its solves, and writes the same table: what follows is only dated anew."""
    table = project / "data/tiny/dataset.toml"
    write_text(table, table.read_text(encoding="utf-8").replace("[params.fea]", "[params.fea]\ntimeout_s = 901"))
    solves = sorted((project / "results/solves").glob("*.json"))
    before = [path.stat().st_mtime_ns for path in solves]
    # the report prints the parameters of every stage
    assert made(project) == {"30_fea/0000", "30_fea/0001", "90_report/6x8-tiny"}
    assert [path.stat().st_mtime_ns for path in solves] == before


def of_log(project, column, value):
    """Change a cell of the last row of the log."""
    log = project / "data/tiny/log.csv"
    rows = read_csv(log)
    rows[-1][column] = value
    write_csv(log, list(rows[0]), rows)


AFTER_FEA = ("40_forces/0001", "50_labels/6x8/0001")
AFTER_LABELS = (
    "60_dataset/6x8/dataset",
    "70_train/6x8/tiny",
    "80_evaluate/6x8/tiny",
    "80_evaluate/6x8/tiny.card",
    "90_report/6x8-tiny",
)


def replaced(project, name, by):
    """Put another file in the place of a file, older than what was made of it."""
    path = project / "data/tiny" / name
    shutil.copyfile(project / "data/tiny" / by, path.with_name("copy"))
    os.utime(path.with_name("copy"), (1e9, 1e9))
    path.with_name("copy").replace(path)


def edited(project, name, old, new):
    """Change a word of a table of workflow/."""
    path = project / "workflow" / name
    text = path.read_text(encoding="utf-8")
    assert old in text
    write_text(path, text.replace(old, new, 1))


def test_what_reads_a_change_is_made_again_and_nothing_else(project):
    """Of the log, pictures beside it, and tables of workflow/."""
    pictures = sorted(path.name for path in (project / "data/tiny/images").iterdir())
    of_shard = {"10_poses/0001", "15_images/images", "30_fea/0001", *AFTER_FEA, *AFTER_LABELS}
    of_log(project, "dx_mm", "0.11")
    assert made(project) == of_shard
    # another picture of the same press: it is judged and learnt from, and no force depends on it
    replaced(project, f"images/{pictures[0]}", f"images/{pictures[1]}")
    assert made(project) == {"10_poses/0000", "15_images/images", *AFTER_LABELS}
    # a network's own table
    edited(project, "models.toml", "widths = [4, 8]", "widths = [4, 6]")
    assert made(project) == set(AFTER_LABELS[1:])
    # a comment
    edited(project, "gels.toml", "# ", "#  ")
    assert made(project) == set()
