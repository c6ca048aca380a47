"""What make asks of a planned dataset: goals that it cannot reach, and results that are due whatever their dates."""

import os

import pytest

from gelforge.flow.asked import MOST_RESTARTS, answer
from gelforge.flow.dates import keep_states, states_of
from gelforge.flow.files import write_json, write_text
from tests.support.refused import refused as bad_input

PLAN = {
    "SHARDS": "0000 0001", "MODELS": "grid_16 unet pair_24 tuned", "TUNED": "tuned", "NEED_NOCONTACT": "pair_24 tuned",
    "LEARNER": "grid_16", "REPORT_MODEL": "", "LEARN_ALSO": "", "IMAGES": "yes",
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
        keep_states(tmp_path / "results/tiny/00_plan/states.txt", states_of(["data/tiny/log.csv"]))

    plan()
    return plan


def asked(goals, **given):
    return answer({"DATASET": "tiny", "RES": "24x32", "GOALS": goals} | given)


def refused(goals, **given):
    return bad_input("", asked, goals, **given)


def test_a_plan_is_made_again_where_a_file_changed_and_not_for_ever():
    assert asked("labels") == ["plan", "MODEL=grid_16", "LEARNT=grid_16"] and asked("help") == []
    write_text("data/tiny/log.csv", "sample_id\nx\n")
    assert asked("labels") == ["plan", "again"] == asked("labels", MODEL="unknown_yet")
    # a log that is being written to changes for ever
    assert asked("labels", MAKE_RESTARTS=str(MOST_RESTARTS)) == ["plan", "MODEL=grid_16", "LEARNT=grid_16"]
    os.unlink("results/tiny/00_plan/plan.mk")
    assert asked("labels", MAKE_RESTARTS=str(MOST_RESTARTS)) == ["plan", "again"]


def test_networks_are_refused_before_anything_is_made_for_them(planned):
    cases = [
        (refused("labels", MODEL="grid16"), "workflow/models.toml has: grid_16 unet pair_24 tuned, and shipped"),
        (refused("train", MODEL="tuned", RES="12x16"), "whose grid is 24x32: say RES=24x32"),
        (refused("pareto-models", CHARTED="grid_16 nope"), "CHARTED names nope"),
        (refused("ship"), "name the one that shall"),
        (refused("ship", MODEL="grid_16", RES="12x16"), "a grid of 24x32; train one of it"),
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


def target(name, *inputs):
    """A result with the record of what it was made of."""
    write_text(f"results/tiny/{name}", "")
    write_json(
        f"results/tiny/metrics/{name.rsplit('.', 1)[0]}.json", {"inputs": [f"results/tiny/{each}" for each in inputs]}
    )
    for each in inputs:
        write_text(f"results/tiny/{each}", "")


def test_results_of_another_choice_are_due():
    target("90_report/index.html", "80_evaluate/24x32/grid_16.json", "calibrate/summary.json")
    target("pareto_models/24x32.json", "80_evaluate/24x32/grid_16.json", "80_evaluate/24x32/unet.json")

    def due(**given):
        return [word for word in asked("labels", **given) if "/" in word]

    page, chart = "results/tiny/90_report/index.html", "results/tiny/pareto_models/24x32.json"
    assert due(CHARTED="unet grid_16") == [] and due() == [chart]
    assert due(CHARTED="grid_16 unet", MODEL="unet") == [page] and due(RES="12x16") == [page]
    os.unlink("results/tiny/calibrate/summary.json")  # which the page would still show
    assert due(CHARTED="grid_16 unet") == [page]


def test_a_gap_in_the_labels_is_due():
    target("50_labels/24x32/labels.json")
    for shard in ("0000", "0001"):
        assert "results/tiny/50_labels/24x32/labels.json" in asked("labels")
        write_text(f"results/tiny/50_labels/24x32/{shard}.npz", "")
    assert not [word for word in asked("labels") if "/" in word]
