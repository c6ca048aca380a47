"""What make refuses of what it is given, before it reads its rules; and what it is answered of a planned dataset."""

import os
from pathlib import Path

import pytest

from gelforge.commands.export import FORMATS
from gelforge.errors import printable
from gelforge.flow import refuse
from gelforge.flow.files import states_of, write_json, write_text
from gelforge.flow.refuse import MOST_RESTARTS, answer, given_to, handed_down
from tests.support.refused import refused as bad_input

EVIL = ("$(shell touch pwned)", "`touch pwned`", "; touch pwned", "a'b", 'a"b', "a\ntouch pwned", "a#b", "%", "-n")
NAMES = ("DATASET", "SENSOR", "MODEL", "FORMAT", "EXECUTOR", "LIKE")
PLAN = {
    "SHARDS": "0000 0001", "MODELS": "grid_16 unet pair_24 tuned", "TUNED": "tuned", "NEED_NOCONTACT": "pair_24 tuned",
    "LEARNER": "grid_16", "REPORT_MODEL": "", "LEARN_ALSO": "", "IMAGES": "yes", "BRANCHES": "calibrate/summary.json",
}  # fmt: skip


@pytest.fixture(autouse=True)
def planned(tmp_path, monkeypatch):
    """A dataset of two shards, planned; returns what changes its lists."""
    monkeypatch.chdir(tmp_path)
    write_text("data/tiny/log.csv", "sample_id\n")
    for shard in ("0000", "0001"):
        write_text(f"results/tiny/00_plan/shards/{shard}.csv", "row,sample_id\n2,a\n")

    def plan(**lists):
        write_text("results/tiny/00_plan/plan.mk", "".join(f"{n} := {w}\n" for n, w in (PLAN | lists).items()))
        write_json(
            "results/tiny/metrics/00_plan/plan.json",
            {"inputs": states_of(["data/tiny/log.csv", "data/tiny/gone"], {})},
        )

    plan()
    return plan


def asked(goals, **given):
    words = [f"{name}={text}" for name, text in ({"DATASET": "tiny"} | given).items()]
    return list(answer(given_to([*goals.split(), *words], {})))


def refused(goals, **given):
    return bad_input("", asked, goals, **given)


def test_what_is_no_name_is_refused_with_what_was_given():
    for name in (*NAMES, "RES", "JOBS", "CHARTED", "TESTS"):
        for text in EVIL:
            if not (name in ("CHARTED", "TESTS") and text == "-n"):
                assert refused("labels", **{name: text}).startswith(printable(f"{name}={text}: give ")), (name, text)
    for name in NAMES:
        for text in ("../../x", "a b", ".hidden", "a/b"):
            assert refused("labels", **{name: text}), (name, text)
    for text in ("24", "x32", "24x32x7", "0x32", "24xx32", "24x00", "24X32", "24x32,12x16"):
        assert refused("labels", RES=text).startswith(f"RES={text}: give resolutions"), text
    for name in refuse.NEVER_EMPTY:
        for text in ("", " "):
            assert refused("labels", **{name: text}) == f"{name} is empty: give a value, or leave it out"


def test_text_that_a_shell_or_make_reads_meaning_into_is_refused_whatever_variable_it_comes_in():
    for name in ("ID", "FROM", "ANYTHING", "GELFORGE_REFERENCE"):
        for text in ("$(shell touch pwned)", "`x`", "a'b", 'a"b', "a\nb", "a\\b"):
            assert printable(f"{name}={text}: give text of one line without $") in refused("help", **{name: text})
    assert "FROM=$x" in bad_input("", given_to, ["help"], {"FROM": "$x"})
    assert given_to([], {"ANYTHING": "$x"})["DATASET"] == "demo"  # of the environment, and nobody reads it
    assert asked("help", FROM="/my disk/a; b & (c) #1 %")


def test_words_of_the_command_line_are_goals_variables_and_options():
    found = given_to(
        ["-j", "4", "-k", "labels", "-C", "there", "A=b=c", "RES=1x1", "-j", "fea"], {"RES": "2x2", "ID": "s"}
    )
    assert found["GOALS"] == "labels fea" and (found["A"], found["RES"], found["ID"]) == ("b=c", "1x1", "s")
    assert given_to(["feats-fetch"], {})["DATASET"] == "feats"
    assert handed_down(" -j2 --jobserver-auth=3,4 -- RES=1x1\\ 2x2 DATASET=a") == ["RES=1x1 2x2", "DATASET=a"]
    assert handed_down("rR") == []


def test_what_means_something_is_taken():
    said = asked(
        "labels",
        RES=" 24x32  12x16 ",
        MODEL="pair_24",
        EXECUTOR="slurm",
        JOBS="16",
        SENSOR="mini-a.2",
        ID="any thing",
    )
    assert said[:5] == ["DATASET=tiny", "RES=24x32", "RES=12x16", "EXECUTOR=slurm", "JOBS=16"]
    assert asked("test", TESTS="tests/unit/flow/test_refuse.py::test_x[a-b] tests/physics", CHARTED="grid_16 unet")


def test_goals_that_cannot_be_done_are_refused():
    cases = {
        "clean-labels labels": "say make clean-labels first, then make labels",
        "clean-all demo": "say make clean-all first, then make demo",
        "clean-plan": "clean-plan: no such target; there are clean-all clean-STAGE clean-poses",
        "export": "FORMAT=: name one of mcap",
        "sample": "no sample named; say make sample DATASET=tiny ID=SAMPLE_ID",
    }
    for goals, words in cases.items():
        assert words in refused(goals), goals
    assert asked("clean-labels clean-fea") and asked("sample", ID="s")
    assert refused("labels", EXECUTOR="cloud") == "EXECUTOR=cloud: give local or slurm"
    assert set(refuse.FORMATS) == set(FORMATS)


def test_only_what_needs_a_dataset_asks_for_one(tmp_path):
    assert "data/none/log.csv not found: DATASET=none needs a raw log" in refused("labels", DATASET="none")
    for goals in ("", "help", "setup", "test", "benchmark-dag", "clean-all", "projection", "mcap-import"):
        assert "plan" not in asked(goals, DATASET="none"), goals
    (tmp_path / "results/none").mkdir(parents=True)  # what was made of a dataset whose log is gone can still be seen
    assert "plan" not in asked("status provenance", DATASET="none") and refused("labels", DATASET="none")
    assert "plan" in asked("status")


def test_a_plan_is_made_again_where_a_content_changed_and_not_for_ever(monkeypatch):
    answered = ["plan", "MODEL=grid_16", "LEARNT=grid_16", "SHOWN=calibrate/summary.json"]
    os.utime("data/tiny/log.csv", (1e9, 1e9))  # no content
    assert asked("labels")[-4:] == answered
    for change in (
        lambda: write_text("data/tiny/log.csv", "sample_id\nx\n"),
        lambda: write_text("data/tiny/gone", "came"),
    ):
        plan = Path("results/tiny/00_plan/plan.mk").read_text(encoding="utf-8")
        change()
        # a log that is being written to changes for ever
        monkeypatch.setenv("MAKE_RESTARTS", str(MOST_RESTARTS))
        assert asked("labels")[-4:] == answered
        monkeypatch.delenv("MAKE_RESTARTS")
        assert asked("labels", MODEL="unknown_yet")[-1] == "plan" and not os.path.exists(
            "results/tiny/00_plan/plan.mk"
        )
        write_text("results/tiny/00_plan/plan.mk", plan)


def test_networks_are_refused_before_anything_is_made_for_them(planned):
    cases = [
        (refused("labels", MODEL="grid16"), "workflow/models.toml has: grid_16 unet pair_24 tuned, and shipped"),
        (refused("train", MODEL="tuned", RES="12x16"), "whose grid is 24x32: say RES=24x32"),
        (refused("pareto-models", CHARTED="grid_16 nope"), "CHARTED names nope"),
        (refused("ship"), "name the new one"),
        (refused("ship", MODEL="grid_16", RES="12x16"), "a grid of 24x32; train a network with that grid"),
        *((refused(goal, MODEL="shipped"), f"to {goal}, name one of") for goal in ("train", "ship")),
        (refused("pareto-models"), "data/tiny/nocontact is missing"),
        *((refused("report", MODEL=name), f"MODEL={name} reads") for name in ("shipped", "pair_24", "tuned")),
    ]
    for said, words in cases:
        assert words in said
    assert asked("labels", MODEL="pair_24") and asked("report", MODEL="unet") and asked("ship", MODEL="unet")
    assert asked("pareto-models", CHARTED="grid_16 unet")
    os.mkdir("data/tiny/nocontact")
    assert asked("pareto-models") and asked("report", MODEL="shipped")


def test_the_report_shows_the_network_of_its_table_where_that_has_the_grid(planned):
    os.mkdir("data/tiny/nocontact")
    for model, res, shown in (
        ("shipped", "24x32", "shipped"), ("shipped", "12x16", "grid_16"), ("tuned", "12x16", "grid_16"), ("unet", "12x16", "unet"),
    ):  # fmt: skip
        planned(REPORT_MODEL=model)
        assert f"MODEL={shown}" in asked("report", RES=res)
    assert "MODEL=pair_24" in asked("report", MODEL="pair_24")


def test_a_dataset_without_images_or_labels_is_refused_at_once(planned):
    planned(IMAGES="")
    for goal in ("report", "dataset", "train", "pareto-models", "export", "demo"):
        assert "names no images" in refused(goal, FORMAT="hdf5") and "make labels DATASET=tiny" in refused("report")
    assert asked("labels calibrate")
    write_text("data/tiny/labels/1x1.npz", "")  # imported labels come with their images
    assert "labels of 1x1, not of 24x32: say RES=1x1" in refused("dataset")
    assert asked("dataset", RES="1x1")


def test_other_datasets_that_are_learnt_from_must_be_there(planned):
    planned(LEARN_ALSO="here gone")
    write_json("results/here/60_dataset/24x32/dataset.json", {})
    assert "make DATASET=gone RES=24x32 dataset" in refused("train")
    planned(LEARN_ALSO="here")
    assert asked("train")


def test_another_choice_is_a_newer_file():
    """Of network, resolution, branches that there are, and networks of the chart."""

    def dates(**given):
        asked("labels", **given)
        found = {}
        for name in ("report", "pareto_models-24x32"):
            path = f"results/tiny/00_plan/choices/{name}.txt"
            found[name] = os.stat(path).st_mtime_ns
            os.utime(path, (1e9, 1e9))
        return {name for name, at in found.items() if at != 1e18}

    assert dates() == {"report", "pareto_models-24x32"} and dates() == set()
    assert dates(MODEL="unet") == {"report"} and dates(MODEL="unet", RES="24x32 12x16") == set()
    assert dates(MODEL="unet", CHARTED="unet") == {"pareto_models-24x32"}
    write_text("results/tiny/pareto/pareto.json", "")
    assert dates(MODEL="unet", CHARTED="unet") == {"report"}


def test_labels_with_a_gap_are_dated_before_what_they_are_made_of():
    table = "results/tiny/50_labels/24x32/labels.json"
    write_json(table, {"sha256": {"0000.npz": "", "0001.npz": ""}})
    write_text("results/tiny/50_labels/24x32/0000.npz", "")
    asked("labels", RES="12x16")
    assert os.stat(table).st_mtime_ns
    asked("labels", RES="12x16 24x32")
    assert os.stat(table).st_mtime_ns == 0
    write_text("results/tiny/50_labels/24x32/0001.npz", "")
    os.utime(table)
    asked("labels")
    assert os.stat(table).st_mtime_ns
