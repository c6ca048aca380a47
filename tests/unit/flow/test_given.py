"""What make refuses of what it is given, before it reads its rules."""

import pytest

from gelforge.commands.export import FORMATS
from gelforge.flow import given
from gelforge.flow.given import needs_plan, refusal

EVIL = ("$(shell touch pwned)", "`touch pwned`", "; touch pwned", "a'b", 'a"b', "a\ntouch pwned", "a#b", "%", "-n")
NAMES = ("DATASET", "SENSOR", "MODEL", "FORMAT", "EXECUTOR")


@pytest.fixture(autouse=True)
def with_log(tmp_path, monkeypatch):
    """A folder with one dataset, tiny."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data/tiny").mkdir(parents=True)
    (tmp_path / "data/tiny/log.csv").write_text("sample_id\n")


def said(goals="labels", **variables):
    return refusal({"DATASET": "tiny", "RES": "24x32", "GOALS": goals} | variables)


def test_what_is_no_name_is_refused_with_what_was_given():
    for name in (*NAMES, "RES", "JOBS", "CHARTED", "TESTS"):
        for text in EVIL:
            if not (name in ("CHARTED", "TESTS") and text == "-n"):
                assert said(**{name: text}).startswith(f"{name}={text}: give "), (name, text)
    for name in NAMES:
        for text in ("../../x", "a b", ".hidden", "a/b"):
            assert said(**{name: text}), (name, text)
    for text in ("24", "x32", "24x32x7", "0x32", "24xx32", "24x00", "24X32", "24x32,12x16"):
        assert said(RES=text).startswith(f"RES={text}: give resolutions"), text
    for name in given.NEVER_EMPTY:
        for text in ("", " "):
            assert said(**{name: text}) == f"{name} is empty: give a value, or leave it out"


def test_what_means_something_is_taken():
    assert not said(
        RES=" 24x32  12x16 ", MODEL="pair_24", EXECUTOR="slurm", JOBS="16", SENSOR="mini-a.2", ID="$(any thing)"
    )
    assert not said(
        TESTS="tests/unit/flow/test_given.py::test_x[a-b] tests/physics", CHARTED="grid_16 unet", MODEL="shipped"
    )


def test_goals_that_cannot_be_done_are_refused():
    cases = {
        "clean-labels labels": "say make clean-labels first, then make labels",
        "clean-all demo": "say make clean-all first, then make demo",
        "export": "FORMAT=: name one of mcap",
        "sample": "no sample named; say make sample DATASET=tiny ID=SAMPLE_ID",
    }
    for goals, words in cases.items():
        assert words in said(goals), goals
    assert not said("clean-labels clean-fea") and not said("export", FORMAT="hdf5") and not said("sample", ID="s")
    assert said(EXECUTOR="cloud") == "EXECUTOR=cloud: give local or slurm"
    assert set(given.FORMATS) == set(FORMATS)


def test_only_what_needs_a_dataset_asks_for_one(tmp_path):
    assert "data/none/log.csv not found: DATASET=none needs a raw log" in said(DATASET="none")
    for goals in ("", "help", "setup", "test", "benchmark-dag", "clean-all", "projection", "mcap-import"):
        assert not said(goals, DATASET="none"), goals
    (tmp_path / "results/none").mkdir(parents=True)  # what was made of a dataset whose log is gone can still be seen
    assert not said("status provenance", DATASET="none") and said("labels", DATASET="none")
    assert needs_plan({"DATASET": "tiny", "GOALS": "status"}) and not needs_plan(
        {"DATASET": "none", "GOALS": "status"}
    )
