"""Every goal uses all job slots: steps overlap, no make starts a make, and what is printed is what a person needs."""

import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from gelforge.flow.files import read_json, record_of
from gelforge.flow.layout import metrics_of
from tests.support.sandbox import REPORTED, clean_environment, make

# Goals of `make help` that make no results of a dataset, by what they are for.
OTHERS = {
    "help", "setup", "status", "sample", "provenance", "deck", "look", "estimate", "freeze", "clean-STAGE", "clean-all", "docs", "lint",
    "format", "lock", "test", "test-all", "benchmark-X", "benchmark-tables", "lerobot-env", "real-check", "readme-pictures", "rig",
    "rig-check", "mcap-import", "feats-fetch", "feats-import", "projection", "fea-challenge", "fea-references", "ship",
}  # fmt: skip


# and those that do, for stages of the whole flow or branches of their own
STAGES = {
    "poses", "images", "meshes", "fea", "forces", "labels", "dataset", "train", "evaluate", "report", "demo", "calibrate", "pareto", "stability",
    "pareto-models", "export", "feats-export",
}  # fmt: skip


def test_no_make_starts_a_make(root):
    """A make in a recipe has one job slot, unless make sees its name in the recipe's own text."""
    for path in (root / "Makefile", *root.glob("rules/*.mk")):
        for line in path.read_text(encoding="utf-8").splitlines():
            assert not re.search(r"\$[({]MAKE[)}]|^\t.*(?<!`)\bmake (?!setup)(?=[a-z$-]+ )(?!.*##)", line), line
    goals = set(re.findall(r"^  ([a-z][\w-]*)\s", make(root, "help").stdout, re.MULTILINE))
    assert OTHERS <= goals <= OTHERS | STAGES, goals ^ (OTHERS | STAGES)


@pytest.mark.slow
def test_steps_of_a_goal_overlap_and_its_output_is_clean(calibrated):
    """The whole flow by one goal with two job slots, posterior first."""
    said, results = (calibrated / "said.txt").read_text(), calibrated / "results/demo"
    lines = [line for line in said.splitlines() if line.strip()]
    for bad in ("warning", "jobserver", "Traceback", "-j1"):
        assert bad not in said, said
    assert [line for line, count in Counter(lines).items() if count > 1] == []
    records = [(path, read_json(path)) for path in (results / "metrics").rglob("*.json")]
    spans = {path: (one["started"], one["started"] + one["seconds"]) for path, one in records}
    for stage in ("10_poses", "30_fea", "40_forces", "50_labels/24x32"):
        own = [path for path in spans if path.parent == results / "metrics" / stage]
        beside = [
            path
            for path in own
            if any(
                other != path and begin < spans[path][1] and end > spans[path][0]
                for other, (begin, end) in spans.items()
            )
        ]
        assert len(own) == 4 and len(beside) >= 2, stage
    assert list((results / "90_report").glob("*.html")) and not (calibrated / "data/demo/calibration.toml").exists()
    again = make(calibrated, "-j2", "demo")
    assert again.returncode == 0 and "because" not in again.stdout and " MiB" not in again.stdout, again.stdout


@pytest.mark.slow
def test_each_file_of_the_results_that_is_gone_is_healed_by_one_make(calibrated):
    """And nothing else is made for it."""
    for names in (
        ("00_plan/plan.mk", "10_poses/0001.csv", "40_forces/0000.npz"),
        ("00_plan/params/fea.json", "calibrate/summary.json", "50_labels/24x32/0002.npz"),
        ("00_plan/shards/0002.csv", "30_fea/0003.csv"),
    ):
        gone = [calibrated / "results/demo" / name for name in names]
        for path in gone:
            path.unlink()
        done = make(calibrated, "-j2", "demo")
        assert done.returncode == 0 and all(path.exists() for path in gone), done.stdout
        assert "flow.step" not in make(calibrated, "-n", "demo").stdout, names


def of_each_stage(results) -> list[dict]:
    """The record of the last run of one target of each stage."""
    found = {
        (path.parent.relative_to(results / "metrics"), path.suffixes[0]): read_json(path)
        for path in sorted((results / "metrics").rglob("*.json"))
        if path.parent.name != "00_plan"
    }
    return list(found.values())


def stands_for(project, name: str) -> set[str]:
    """The files that a prerequisite stands for: itself, what was written with it, and pictures whose digests it holds."""
    path = project / name
    found = {name}
    if "results" in path.parts and "00_plan" not in path.parts:
        named = [*(record_of(metrics_of(path)) or {}).get("beside", ()), *(record_of(path) or {}).get("sha256", ())]
        found |= {str((path.parent / each).relative_to(project)) for each in named}
    if path.name.endswith(".pictures.json") or path.parent.name == "beside":
        data = Path("data", path.parts[path.parts.index("00_plan") - 1])
        held = read_json(path)
        found |= {str(data / each) for each in held.get("images", held) if (project / data / each).is_file()}
    return found


@pytest.mark.slow
def test_a_stage_reads_its_prerequisites_and_nothing_else(root, calibrated, whole, tmp_path):
    """One target of each stage, made again in a folder that holds what it depends on and the store of solves alone.

    And of each that makes the posterior or reads it.
    """
    for made in (calibrated / "results/demo", whole / "results/tiny"):
        home = made.parent.parent
        records = [
            one for one in of_each_stage(made) if home == whole or "/calibrate/" in f"{one['target']} {one['inputs']}"
        ]
        assert records
        for record in records:
            alone = tmp_path / record["target"].replace("/", "-")
            alone.mkdir()
            for name in ("src", ".venv"):
                (alone / name).symlink_to(root / name)
            for name in {each for given in record["inputs"] for each in stands_for(home, given)}:
                (alone / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(home / name, alone / name)
            shutil.copytree(home / "results/solves", alone / "results/solves")
            for path in (made / "00_plan/shards").glob("*.csv"):  # the plan's list of shards, without what they hold
                (alone / path.relative_to(home)).parent.mkdir(parents=True, exist_ok=True)
                (alone / path.relative_to(home)).touch()
            words = [word for word in record["command"] if word != "--part"]
            environment = clean_environment() | {"PYTHONPATH": str(root / "src")}
            done = subprocess.run(words, cwd=alone, env=environment, capture_output=True, text=True, check=False)
            assert done.returncode == 0, (record["target"], done.stderr)
            ours = alone / record["target"]
            if ours.suffix not in (".onnx", ".html") and ours.name != "summary.json":  # these say what they cost
                assert ours.read_bytes() == (home / record["target"]).read_bytes(), record["target"]


@pytest.mark.slow
def test_what_a_target_reads_and_is_gone_is_made_again_by_the_same_make(whole):
    """Files of the plan, and those that stages write beside their targets, for a page that is due."""
    results = whole / "results/tiny"
    gone = [results / name for name in (
        "00_plan/shards.csv", "00_plan/params/calibrate.json", "00_plan/params/spare.json", "00_plan/shards/0001.json",
        "10_poses/0000.rejected.csv", "10_poses/0001/demo-000004.stl", "60_dataset/6x8/labels.npy", "70_train/6x8/tiny.curve.png",
        "80_evaluate/6x8/tiny.png", "90_report/6x8-tiny.html",
    )]  # fmt: skip
    before = {path: path.read_bytes() for path in gone}
    for path in gone:
        path.unlink()
    done = make(whole, *REPORTED)
    assert done.returncode == 0, done.stdout
    assert all(path.exists() for path in gone)
    # pictures hold dates, and the page holds what each step cost
    same = [path for path in gone if path.suffix not in (".png", ".html")]
    assert {path for path in same if path.read_bytes() != before[path]} == set()
    assert "flow.step" not in make(whole, "-n", *REPORTED).stdout
