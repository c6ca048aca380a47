"""Make goes by dates, the wrapper by contents: what did not change is not made again, and what reads a change is."""

import os
import random
import re
import shutil
import time
from pathlib import Path

import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, record_of, write_csv, write_text
from gelforge.flow.step import beside, build, cause
from tests.support.sandbox import REPORTED, make


def made(project) -> set[str]:
    """Make all of it; the targets whose commands ran, but the plan."""
    began = time.time_ns()
    done = make(project, *REPORTED)
    assert done.returncode == 0, done.stdout[-3000:]
    assert due(project) == set()
    logs = project / "results/tiny/logs"
    found = {
        str(path.relative_to(logs).with_suffix("")) for path in logs.rglob("*.log") if path.stat().st_mtime_ns > began
    }
    return found - {"00_plan/plan"}


def due(project) -> set[str]:
    """What `make -n` would make, after it planned anew."""
    done = make(project, "-n", *REPORTED)
    assert done.returncode == 0, done.stdout[-3000:]
    found = re.findall(r"gelforge\.flow\.step results/tiny/(\S+)", done.stdout)
    return {str(Path(name).with_suffix("")) for name in found}


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
        ("models.toml", '\n[other]\nkind = "unet"\nwidths = [4, 8]\n'),
        ("sensors.toml", "# a comment\n"),
    ):
        path = project / "workflow" / name
        write_text(path, path.read_text(encoding="utf-8") + text)


@pytest.mark.parametrize(
    "change", [lambda project: [os.utime(path) for path in files(project)], at_random], ids=["touched", "dates at random"]
)  # fmt: skip
def test_nothing_runs_where_no_content_changed(whole, change):
    change(whole)
    assert made(whole) == set()


def test_nothing_is_due_in_a_fresh_clone_or_for_what_is_not_read(whole):
    for change in (anew, unread):
        change(whole)
        assert due(whole) == set()


def test_a_parameter_on_which_no_solve_depends_trains_nothing(whole):
    """Stage 30 reads it, finds its solves, and writes the same table: what follows is only dated anew."""
    edited(whole / "data/tiny/dataset.toml", "[params.fea]", "[params.fea]\ntimeout_s = 901")
    solves = sorted((whole / "results/solves").glob("*.json"))
    before = [path.stat().st_mtime_ns for path in solves]
    # the report prints the parameters of every stage
    assert made(whole) == {"30_fea/0000", "30_fea/0001", "90_report/6x8-tiny"}
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


def other_picture(project):
    """The first press gets the picture of another."""
    first, second, *_ = sorted(path.name for path in (project / "data/tiny/images").iterdir())
    replaced(project, f"images/{first}", f"images/{second}")


def edited(path, old, new):
    """Change a word of a table."""
    text = path.read_text(encoding="utf-8")
    assert old in text
    write_text(path, text.replace(old, new, 1))


CHANGES = {
    "a row of the log": (
        lambda project: of_log(project, "dx_mm", "0.11"),
        {"10_poses/0001", "15_images/images", "30_fea/0001", *AFTER_FEA, *AFTER_LABELS},
    ),
    "a network's own table": (
        lambda project: edited(project / "workflow/models.toml", "widths = [4, 8]", "widths = [4, 6]"),
        set(AFTER_LABELS[1:]),
    ),
    "a comment": (lambda project: edited(project / "workflow/gels.toml", "# ", "#  "), set()),
    "a split": (
        lambda project: edited(project / "data/tiny/splits.csv", ",val", ",train"),
        set(AFTER_LABELS),
    ),
}  # fmt: skip


def test_another_picture_is_judged_and_learnt_from_and_no_force_depends_on_it(whole):
    other_picture(whole)
    assert {"10_poses/0000", "15_images/images", *AFTER_LABELS} < due(whole)
    done = make(whole, "labels", *REPORTED[2:])
    assert done.returncode == 0, done.stdout
    assert re.findall(r"^results/tiny/(\S+)  ", done.stdout, re.MULTILINE) == [
        "10_poses/0000.csv",
        "15_images/images.json",
    ]


@pytest.mark.parametrize("name", CHANGES)
def test_what_reads_a_change_is_due_and_nothing_else(whole, name):
    change, expected = CHANGES[name]
    change(whole)
    assert due(whole) == expected


# Targets that no other is made of; what follows a plan follows its tables.
LAST = ("00_plan/plan.mk", "80_evaluate/6x8/tiny.card.md", "90_report/6x8-tiny.html")


def turned(path):
    """Turn one bit in the middle of a file, which keeps its size and date; return how to turn it back."""
    whole, dates = path.read_bytes(), path.stat()

    def write(content):
        path.write_bytes(content)
        os.utime(path, ns=(dates.st_atime_ns, dates.st_mtime_ns))

    middle = len(whole) // 2
    write(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    return lambda: write(whole)


def test_one_bit_of_any_target_turned_at_the_same_date_and_size_is_refused_by_each_of_its_readers(whole, monkeypatch):
    """And the target is outdated. A file beside it is refused by a reader that has to run, for another command.

    Files of people, and those of the plan, which every make compares, have no record.
    """
    monkeypatch.chdir(whole)
    records = {record["target"]: record for record in map(record_of, Path("results/tiny/metrics").rglob("*.json"))}
    refusals = dict.fromkeys(records, 0)
    for name, record in records.items():
        target, inputs, command = Path(name), [*record["inputs"]], record["command"]
        back = turned(target)
        assert cause(target, inputs, command)[0] == "it changed since it was made", target
        back()
        for source in records.keys() & record["inputs"].keys():
            for file in (Path(source), *beside(Path(source))):
                back = turned(file)
                with pytest.raises(BadInput, match=f"^{re.escape(str(file))}: missing or changed since it was made"):
                    build(target, inputs, command if str(file) == source else ["false"])
                back()
                refusals[source] += 1
        assert cause(target, inputs, command)[0] == "", target
    last = {name for name, count in refusals.items() if not count}
    assert (
        last == {f"results/tiny/{name}" for name in LAST}
        and refusals["results/tiny/60_dataset/6x8/dataset.json"] > 14
    )
