"""What a plan depends on: contents and not names, states and not ages; and what make makes again for a change of them."""

import os
import shutil
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import digest_of_value, read_csv, write_csv, write_text
from gelforge.flow.layout import STAGES, File, Layout, command_of
from gelforge.flow.params import stl_files, with_content
from gelforge.geometry.triangles import write_stl
from gelforge.stages.fea import shape_of
from gelforge.stages.plan import check_count, used
from tests.support.parameters import parameters
from tests.support.sandbox import lay_dataset, link_project, make
from tests.support.waiting import HANG

BLOCK = np.array([[x, y, z] for z in (0, 6) for y in (0, 1) for x in (0, 1)], float)
FACES = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6],
         [1, 3, 5], [3, 7, 5]]  # fmt: skip
POSES = "gelforge.flow.step results/tiny/10_poses/"
LABELS = "labels", "DATASET=tiny", "RES=6x8"


def block(path, wide):
    write_stl(path, (BLOCK - [0.5, 0.5, 0]) * [wide, wide, 1], np.array(FACES))


@pytest.fixture
def log(whole):
    """The log of that dataset."""
    return whole / "data/tiny/log.csv"


def test_a_shape_that_changes_under_its_name_is_another_shape(tmp_path):
    """The same key for the same content under another name, another key for other content under the same name."""
    block(tmp_path / "a.stl", 8.0)
    (tmp_path / "b.stl").write_bytes((tmp_path / "a.stl").read_bytes())
    tables = {name: {"kind": "stl", "file": f"{name}.stl", "seen": name == "a"} for name in "ab"}
    before = with_content(tables, tmp_path)
    assert stl_files(tables, tmp_path) == {"a": tmp_path / "a.stl", "b": tmp_path / "b.stl"}
    block(tmp_path / "a.stl", 4.0)
    after = with_content(tables, tmp_path)

    def key(indenters, name="a"):
        return digest_of_value(shape_of(SimpleNamespace(indenter=name), {"indenters": indenters}))

    assert key(before) == key(before, "b") != key(after)
    assert used({"a": 1, "b": 2}, {"b", "c"}) == {"b": 2}


def shown(project, *words, target="poses") -> str:
    """What `make -n` would run for a target."""
    done = make(project, "-n", target, "DATASET=tiny", *words, timeout=HANG)
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_a_scene_that_is_retired_leaves_the_chart(whole):
    """The chart is drawn anew, and no scene is solved for that."""
    scenes, folder = whole / "workflow/scenes.toml", whole / "results/tiny/pareto"
    text = scenes.read_text(encoding="utf-8")
    write_text(whole / "results/tiny/20_meshes/gelsight_mini.npz", "")
    assert make(whole, "results/tiny/00_plan/params/scenes/sphere_1mm.json", "DATASET=tiny").returncode == 0
    last = text.rindex("\n[")
    for name in [*tomllib.loads(text), "../pareto"]:
        write_text(folder / f"scenes/{name}.json", "{}")
    step = "flow.step results/tiny/pareto"
    assert step not in shown(whole, target="pareto")
    write_text(scenes, text[:last])
    said = shown(whole, target="pareto")
    assert f"{step}/pareto.json" in said and f"{step}/scenes" not in said


@pytest.mark.slow
def test_each_change_that_dates_do_not_tell_is_planned_once(whole, log):
    """Of the log and of a picture that it names: replaced by an older file, behind a link, gone and back. What is only touched is not."""
    plan = whole / "results/tiny/00_plan/plan.mk"
    lines = log.read_text().splitlines(keepends=True)
    picture, other = (log.parent / row["image"] for row in read_csv(log)[:2])
    kept, behind = picture.read_bytes(), log.with_name("behind.csv")

    def replaced(path, by):
        path.with_name("copy").write_bytes(by)
        os.utime(path.with_name("copy"), (0, 0))
        path.with_name("copy").replace(path)

    def link():
        behind.write_text("".join(lines))
        log.unlink()
        log.symlink_to(behind)

    assert POSES not in shown(whole)
    for change, planned, due in (
        (lambda: replaced(log, "".join(lines[:-1]).encode()), True, True),
        (link, True, True),  # as it was when it was built, and dated anew
        (lambda: behind.write_text("".join(lines[:-1])), True, True),
        (lambda: (behind.write_text("".join(lines)), replaced(picture, other.read_bytes())), True, True),
        (lambda: replaced(picture, kept), True, True),
        (lambda: (log.touch(), picture.touch()), False, True),
        (picture.unlink, True, True),
        (lambda: write_text(log.parent / "nocontact/a note.txt", ""), True, True),  # an odd name disturbs nothing
    ):
        change()
        said, at_first = shown(whole), plan.stat().st_mtime_ns
        assert ("plan.mk: made again" in said) == planned and (POSES in said) == due
        assert (POSES in shown(whole)) == (POSES in said) and plan.stat().st_mtime_ns == at_first
    assert make(whole, "-n", "dataset", "DATASET=tiny").returncode == 0


def test_a_shard_whose_log_lost_a_row_is_made_of_the_others(whole, log):
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[:-1]))
    assert make(whole, "poses", "DATASET=tiny").returncode == 0
    table = read_csv(whole / "results/tiny/00_plan/shards.csv")
    assert {row["sample_id"] for row in table if row["logged"] == "0"} == {lines[-1].split(",")[0]}
    assert len(read_csv(whole / "results/tiny/10_poses/0001.csv")) == 2


def test_a_replaced_picture_reruns_its_own_shard(whole, log):
    """The hint of a rejected picture, to copy the file again, is seen by make; other shards stay as they are."""
    picture = log.parent / read_csv(log)[0]["image"]
    kept = picture.read_bytes()
    picture.write_bytes(kept[:100])
    done = make(whole, "poses", "DATASET=tiny")
    assert done.returncode == 0 and "rejected: " in done.stdout
    assert "1 x image: " in make(whole, "status", "DATASET=tiny").stdout
    assert POSES not in shown(whole)
    picture.write_bytes(kept)
    done = make(whole, "poses", "DATASET=tiny")
    assert done.returncode == 0, done.stdout
    assert "rejected: " not in done.stdout and "10_poses/0000.csv" in done.stdout


def test_a_lost_label_file_is_made_again(whole):
    (whole / "results/tiny/50_labels/6x8/0000.npz").unlink()
    done = make(whole, *LABELS)
    assert done.returncode == 0 and "50_labels/6x8/0000.npz" in done.stdout
    assert (whole / "results/tiny/50_labels/6x8/0000.npz").exists()
    assert "flow.step" not in make(whole, "-n", *LABELS).stdout


def test_what_a_stage_reads_alone_makes_it_due(whole):
    """Changed where nothing between was made of it: another sensor's name in a pose table, another gel of a sensor."""
    of = "results/tiny/"
    for changed, kept, due in (
        ("10_poses/0000.csv", "30_fea/0000.csv", "50_labels"),
        ("00_plan/shards/0000.json", "10_poses/0000.csv", "30_fea"),
    ):
        said = make(whole, "-n", "-W", of + changed, "-o", of + kept, *LABELS).stdout
        assert f"flow.step {of}{due}/" in said, said


def test_all_targets_can_be_made_anew(whole):
    """`make -B`: files that people give are none of them."""
    done = make(whole, "-n", "-B", *LABELS, timeout=HANG)
    assert done.returncode == 0 and POSES in done.stdout and "50_labels" in done.stdout


def test_nothing_is_used_before_it_is_defined(root, tmp_path):
    """make 4.4 would warn, also where nothing is set up and planned yet."""
    project = link_project(root, tmp_path / "project")
    (project / ".venv").unlink()
    lay_dataset(project, root, "tiny", 1)
    for words in (["help"], ["-n", "setup"], ["help", "EXECUTOR=slurm"]):
        done = make(project, "--warn-undefined-variables", *words, "DATASET=tiny")
        assert done.returncode == 0 and "warning" not in done.stdout, done.stdout
    (project / ".venv").symlink_to(root / ".venv")
    of_developers = ["test", "test-all", "lint", "format", "lock", "real-check", "lerobot-env", "docs"]
    for words in (["report", "MODEL=unet"], ["labels", "EXECUTOR=slurm"], ["labels"], of_developers):
        done = make(project, "--warn-undefined-variables", "-n", *words, "DATASET=tiny")
        assert done.returncode == 0 and "warning" not in done.stdout, done.stdout


def test_more_shards_than_make_can_hold_are_refused():
    with pytest.raises(BadInput, match=r"125000 shards of up to 8 samples .* shard_size = 500 or more"):
        check_count(["0"] * 125_000, 8)


def test_a_branch_that_is_none_is_refused():
    for asked in (["nope"], "calibrate", [1], ["$(shell x)"]):
        with pytest.raises(BadInput, match=r'\[report\] branches = .*: give a list of 0 or more, each "calibrate"'):
            parameters(report={"branches": asked})


def test_a_shape_that_is_put_where_it_was_missing_or_is_another_one_is_seen(alone):
    """Of an indenter of the dataset's own, beside whose table it lies, whatever its ending and its folder."""
    data, name = alone / "data/tiny", "of/mine/Block.STL"
    (data / "indenters.toml").write_text(f'[mine]\nkind = "stl"\nfile = "{name}"\nscale = 1\n')
    log = data / "log.csv"
    rows = read_csv(log)
    rows[0] |= {"indenter": "mine"}
    write_csv(log, list(rows[0]), rows)
    done = make(alone, "poses", "DATASET=tiny")
    assert done.returncode == 0 and name in done.stdout
    (data / name).parent.mkdir(parents=True)
    block(data / name, 8.0)
    done = make(alone, "poses", "DATASET=tiny")
    assert done.returncode == 0 and "10_poses/0000.csv" in done.stdout and "rejected: " not in done.stdout
    assert len(read_csv(alone / "results/tiny/10_poses/0000.csv")) == 1
    assert POSES not in shown(alone)
    block(data / name, 4.0)
    assert POSES in shown(alone)


def test_the_variable_of_a_rigs_plan_is_no_file_of_the_flow(alone):
    before = (alone / "Makefile").read_bytes()
    done = make(alone, "rig", "poses", "DATASET=tiny", "PLAN=Makefile")
    assert done.returncode and "Makefile: " in done.stdout
    assert make(alone, "-n", "poses", "DATASET=tiny", "PLAN=Makefile").returncode == 0
    assert (alone / "Makefile").read_bytes() == before


def test_what_is_left_of_a_dataset_whose_data_are_gone_is_seen_and_removed(alone):
    assert make(alone, "poses", "DATASET=tiny").returncode == 0
    shutil.rmtree(alone / "data/tiny")
    assert "10_poses" in make(alone, "status", "DATASET=tiny").stdout
    done = make(alone, "clean-all", "DATASET=tiny")
    assert done.returncode == 0 and not (alone / "results/tiny").exists(), done.stdout


def test_results_follow_the_version_of_their_stage(whole):
    """What a newer version of the code makes otherwise is made again: the version is a prerequisite of one of its files."""
    goals = ("report", "calibrate", "pareto", "stability", "pareto-models")
    rules = [
        line.split(":", 1) for line in make(whole, "-pn", *goals, "DATASET=tiny").stdout.splitlines() if ":" in line
    ]
    made = {file.by.partition(" ")[0] for file in vars(Layout).values() if isinstance(file, File)}
    assert {name for name in made if name.startswith("stages.")} == {f"stages.{name}" for name in (*STAGES, "plan")}
    for stage in STAGES:
        reads = [reads.split() for target, reads in rules if f"gelforge.stages.{stage}" in command_or_none(target)]
        assert any(f"results/tiny/00_plan/params/{stage}.json" in each for each in reads), stage


def command_or_none(target):
    """The command that makes a file, empty for none."""
    try:
        return command_of(Path(target))
    except BadInput:
        return []


def test_a_gel_that_is_edited_calibrates_anew(whole):
    """It keeps its name, and a calibration waits for no pose."""
    sensors, gels = (whole / f"workflow/{name}.toml" for name in ("sensors", "gels"))
    write_text(sensors, sensors.read_text().replace('gel = "gelsight_mini"', 'gel = "dome"'))
    table = whole / "data/tiny/dataset.toml"
    write_text(table, table.read_text().replace("gelsight_mini", "dome"))
    done = make(whole, "poses", "DATASET=tiny")
    assert done.returncode == 0, done.stdout
    write_text(whole / "results/tiny/calibrate/summary.json", "{}")
    text, due = gels.read_text(), "flow.step results/tiny/calibrate/summary.json"
    edits = ((text + "\n", False), (text.replace("[dome]\nwidth = 18.0", "[dome]\nwidth = 19.0"), True))
    for edited, again in edits:
        write_text(gels, edited)
        assert (due in make(whole, "-n", "calibrate", "DATASET=tiny").stdout) == again


def test_a_log_without_images_has_none_to_judge(whole):
    """Neither a start of the program that would, nor a file of it."""
    (whole / "results/tiny/15_images/images.json").unlink()
    judges = "flow.step results/tiny/15_images"
    assert judges in make(whole, "-n", *LABELS).stdout
    table = whole / "data/tiny/dataset.toml"
    write_text(table, table.read_text() + "\n[params.poses]\nimages = false\n")
    assert judges not in make(whole, "-n", *LABELS).stdout
