"""What a plan depends on: contents and not names, states and not ages."""

import os
import re
import shutil
import subprocess
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gelforge.commands.why import ask_make, reasons
from gelforge.commands.why import lines as why_lines
from gelforge.errors import BadInput
from gelforge.flow.catalogue import with_content
from gelforge.flow.files import read_csv, write_csv, write_text
from gelforge.flow.params import SOURCES, digest_of_value
from gelforge.geometry.triangles import write_stl
from gelforge.records.forcefile import ForceFile
from gelforge.records.press import RawRow
from gelforge.stages.fea import shape_of
from gelforge.stages.plan import check_count, picture_folders, used
from tests.benchmarks.sandbox import comma_language, link_project, make
from tests.support.parameters import parameters
from tests.support.waiting import HANG

from .conftest import lay_dataset

BLOCK = np.array([[x, y, z] for z in (0, 6) for y in (0, 1) for x in (0, 1)], float)
FACES = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6],
         [1, 3, 5], [3, 7, 5]]  # fmt: skip


def block(path, wide):
    write_stl(path, (BLOCK - [0.5, 0.5, 0]) * [wide, wide, 1], np.array(FACES))


@pytest.fixture(scope="module")
def built(root, tmp_path_factory):
    """A sandbox with a dataset of two presses, built as far as labels, which tests copy and leave as it is."""
    project = link_project(root, tmp_path_factory.mktemp("planning") / "project")
    lay_dataset(project, root, "tiny", 2)
    assert make(project, "labels", "DATASET=tiny").returncode == 0
    return project


@pytest.fixture
def labelled(built, tmp_path):
    """A copy of that sandbox, of which nothing is outdated."""
    return shutil.copytree(built, tmp_path / "project", symlinks=True)


@pytest.fixture
def log(labelled):
    """The log of that dataset."""
    return labelled / "data/tiny/log.csv"


def test_a_shape_that_changes_under_its_name_is_another_shape(tmp_path):
    """The same key for the same content under another name, another key for other content under the same name."""
    block(tmp_path / "a.stl", 8.0)
    (tmp_path / "b.stl").write_bytes((tmp_path / "a.stl").read_bytes())
    tables = {name: {"kind": "stl", "file": f"{name}.stl", "seen": name == "a"} for name in "ab"}
    before, files = with_content(tables, tmp_path)
    assert files == [tmp_path / "a.stl", tmp_path / "b.stl"]
    block(tmp_path / "a.stl", 4.0)
    after, _ = with_content(tables, tmp_path)

    def key(indenters, name="a"):
        return digest_of_value(shape_of(SimpleNamespace(indenter=name), {"indenters": indenters}))

    assert key(before) == key(before, "b") != key(after)


def test_only_what_is_named_is_part_of_the_plan():
    assert used({"a": 1, "b": 2}, {"b", "c"}) == {"b": 2}


def test_what_was_made_of_another_choice_is_made_again(root, tmp_path):
    """However old the files are that it was made from."""
    (tmp_path / "rules").symlink_to(root / "rules")  # make takes a path with a blank for two
    (tmp_path / "Makefile").write_text(
        "DATASET := d\nMODEL := m\nEXECUTOR := local\nRES := 4x4\ninclude rules/00_given.mk\n"
        "page: choice\n\t@echo making && touch page\n"
        "choice: $(call chosen,choice,$(WORDS))\n\t@echo '$(WORDS)' > $@\n"
    )
    os.utime(tmp_path / "Makefile", (1e9, 1e9))

    def made(words: str) -> bool:
        for age, name in enumerate(("choice", "page")):  # a quick machine writes both within one tick of the clock
            if (tmp_path / name).exists():
                os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
        done = subprocess.run(
            ["make", "page", f"WORDS={words}"], cwd=tmp_path, capture_output=True, text=True, check=True
        )
        return "making" in done.stdout

    assert made("24x32 a") and not made("24x32 a")
    assert made("24x32 b") and made("24x32 a") and not made(" 24x32  a ")
    assert made("24x32") and made("") and not made("")


def test_a_plan_is_made_once_of_a_file_dated_in_the_future(labelled, log):
    ahead = time.time() + 86400
    os.utime(log, (ahead, ahead))
    assert planned_once(labelled)


@pytest.fixture
def dated(labelled):
    """Dates a result so many seconds from now."""

    def date(name: str, seconds: float) -> Path:
        path = labelled / "results/tiny" / name
        os.utime(path, (time.time() + seconds,) * 2)
        return path

    return date


@pytest.mark.parametrize(
    "name", ["10_poses/0000.csv", "00_plan/plan.mk", "00_plan/shards/0000.csv", "50_labels/24x32/labels.json"]
)
def test_results_dated_ahead_are_refused_because_an_edited_log_would_stay_unread(labelled, log, dated, name):
    dated(name, 3600)
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:-1]))
    done = make(labelled, "labels", "DATASET=tiny")
    assert done.returncode == 2 and f"results/tiny/{name} is dated " in done.stdout, done.stdout
    assert "wait until then, or make DATASET=tiny clean-ahead, which removes" in done.stdout
    assert make(labelled, "status", "DATASET=tiny").returncode == 0


def test_what_is_dated_ahead_is_made_again_from_the_log_as_it_is(labelled, log, dated):
    lines = log.read_text().splitlines(keepends=True)
    for name in ("00_plan/shards/0000.csv", "00_plan/shards.csv", "10_poses/0000.csv", "30_fea/0000.csv"):
        dated(name, 86400)
    solve = dated(f"30_fea/0000/{lines[1].split(',')[0]}.json", 86400)
    solved = solve.stat().st_mtime_ns
    log.write_text("".join(lines[:-1]))
    assert make(labelled, "clean-ahead", "DATASET=tiny").returncode == 0
    done = make(labelled, "fea", "DATASET=tiny")
    assert done.returncode == 0, done.stdout
    assert lost_by_log(labelled) == {lines[-1].split(",")[0]}
    assert [row["sample_id"] for row in read_csv(labelled / "results/tiny/10_poses/0000.csv")] == [
        lines[1].split(",")[0]
    ]
    assert solve.stat().st_mtime_ns == solved  # solved presses are known by what they were solved of


def test_clocks_a_moment_apart_are_waited_for(labelled, dated):
    dated("10_poses/0000.csv", 1.5)
    assert make(labelled, "poses", "DATASET=tiny").returncode == 0


def planned_once(folder, **options) -> bool:
    """Whether make plans a dataset at most once and is then content with its plan."""
    plan = folder / "results/tiny/00_plan/plan.mk"
    assert make(folder, "poses", "DATASET=tiny", timeout=HANG, **options).returncode == 0
    first = plan.stat().st_mtime_ns
    done = make(folder, "poses", "DATASET=tiny", timeout=HANG, **options)
    return done.returncode == 0 and plan.stat().st_mtime_ns == first


def test_a_plan_is_made_once_where_numbers_have_a_comma(labelled, tmp_path):
    """As in German or French: what `stat` prints follows the language."""
    environment = comma_language(tmp_path)
    if environment is None:
        pytest.skip("no localedef that makes a language of numbers with a comma")
    assert planned_once(labelled, environment=environment)


def lost_by_log(labelled):
    """Samples of the plan that the log has no more."""
    table = read_csv(labelled / "results/tiny/00_plan/shards.csv")
    return {row["sample_id"] for row in table if row["logged"] == "0"}


def test_a_linked_log_is_planned_once_for_each_change_behind_the_link(labelled, log):
    text = log.read_text().splitlines(keepends=True)
    behind = log.with_name("behind.csv")
    behind.write_text("".join(text))
    log.unlink()
    log.symlink_to(behind)
    assert planned_once(labelled)
    behind.write_text("".join(text[:-1]))
    assert planned_once(labelled)
    assert lost_by_log(labelled) == {text[-1].split(",")[0]}


def test_a_file_that_an_older_one_replaced_is_planned_again(labelled, log):
    text = log.read_text().splitlines(keepends=True)
    log.write_text("".join(text[:-1]))
    os.utime(log, (1e9, 1e9))
    done = make(labelled, "poses", "DATASET=tiny")
    assert done.returncode == 0, done.stdout
    assert lost_by_log(labelled) == {text[-1].split(",")[0]}


def test_touching_the_log_rebuilds_nothing(labelled, log):
    os.utime(log)
    done = make(labelled, "-n", "labels", "DATASET=tiny")
    assert "gelforge.flow.step" not in done.stdout


def test_a_replaced_picture_reruns_its_own_shard(labelled, log):
    """The hint of a rejected picture, to copy the file again, is seen by make; other shards stay as they are."""
    rows = log.read_text().splitlines()
    picture = labelled / "data/tiny" / rows[1].split(",")[-1]
    whole = picture.read_bytes()
    picture.write_bytes(whole[:100])
    done = make(labelled, "poses", "DATASET=tiny")
    assert done.returncode == 0 and "rejected: " in done.stdout
    assert make(labelled, "poses", "DATASET=tiny", "STRICT=1").returncode  # a plain make before does not hide it
    picture.write_bytes(whole)
    done = make(labelled, "poses", "DATASET=tiny", "STRICT=1")
    assert done.returncode == 0, done.stdout
    assert "rejected: " not in done.stdout and "10_poses/0000.csv" in done.stdout


def test_a_picture_that_was_replaced_before_the_date_of_the_plan_is_seen(labelled, log):
    """As where the plan was made by a clock that was ahead then, and is no more."""
    picture = labelled / "data/tiny" / log.read_text().splitlines()[1].split(",")[-1]
    kept = picture.read_bytes()
    assert planned_once(labelled)
    picture.write_bytes(kept[:-1] + b"x")
    (labelled / "results/tiny/00_plan/plan.mk").touch()
    assert "gelforge.stages.poses" in make(labelled, "-n", "poses", "DATASET=tiny").stdout
    assert planned_once(labelled)


def test_a_picture_that_an_older_one_replaced_is_seen(labelled, log):
    rows = log.read_text().splitlines()
    picture, other = (labelled / "data/tiny" / row.split(",")[-1] for row in rows[1:3])
    assert "gelforge.flow.step" not in make(labelled, "-n", "poses", "DATASET=tiny").stdout
    copy = picture.with_name("copy")
    copy.write_bytes(other.read_bytes())
    os.utime(copy, (0, 0))
    copy.replace(picture)
    assert "10_poses/0000.csv" in make(labelled, "-n", "poses", "DATASET=tiny").stdout


def test_files_of_odd_names_beside_a_dataset_disturb_nothing(labelled):
    write_text(labelled / "data/tiny/nocontact/mini_a copy.png", "")
    (labelled / "workflow" / "x (1).stl").write_bytes(b"") if not (labelled / "workflow").is_symlink() else None
    done = make(labelled, "-n", "labels", "DATASET=tiny")
    assert done.returncode == 0, done.stdout
    assert make(labelled, "-n", "dataset", "DATASET=tiny").returncode == 0


def test_more_shards_than_make_can_hold_are_refused():
    with pytest.raises(BadInput, match=r"125000 shards of up to 8 samples .* shard_size = 500 or more"):
        check_count(["0"] * 125_000, 8)


@pytest.mark.parametrize("asked", [["nope"], "calibrate", [1], ["$(shell x)"]])
def test_a_branch_that_is_none_is_refused(asked):
    with pytest.raises(BadInput, match=r'\[report\] branches = .*: give a list of .*"calibrate" or "pareto"'):
        parameters(report={"branches": asked})


def test_why_names_the_parameter_that_changed_and_what_follows(labelled):
    assert "up to date" in make(labelled, "why", "TARGET=labels", "DATASET=tiny").stdout
    table = labelled / "data/tiny/dataset.toml"
    text = table.read_text()
    table.write_text(text.replace("tolerance = 0.2", "tolerance = 0.25"))
    said = make(labelled, "why", "TARGET=labels", "DATASET=tiny").stdout
    assert "30_fea/0000.csv" in said and "parameters of fea changed" in said, said


def test_why_is_reported_of_a_target_that_needs_a_choice_of_its_own(built):
    said = make(built, "why", "TARGET=export", "FORMAT=hdf5", "DATASET=tiny")
    assert said.returncode == 0 and "does not exist" in said.stdout, said.stdout


def test_a_shape_that_is_put_where_it_was_missing_is_seen(alone):
    """Of an indenter of the dataset's own, beside whose table it lies."""
    data = alone / "data/tiny"
    (data / "indenters.toml").write_text('[mine]\nkind = "stl"\nfile = "mine.stl"\nscale = 1\n')
    log = data / "log.csv"
    rows = read_csv(log)
    rows[0] |= {"indenter": "mine"}
    write_csv(log, list(rows[0]), rows)
    done = make(alone, "poses", "DATASET=tiny")
    assert done.returncode == 0 and "mine.stl" in done.stdout
    block(data / "mine.stl", 4.0)
    done = make(alone, "poses", "DATASET=tiny")
    assert done.returncode == 0 and "10_poses/0000.csv" in done.stdout and "rejected: " not in done.stdout
    assert len(read_csv(alone / "results/tiny/10_poses/0000.csv")) == 1


def test_a_shape_that_is_another_one_under_its_name_is_solved_again(alone):
    """Whatever its ending and its folder; an eight millimetre block is pressed lightly, then one of four."""
    name, workflow = "of/mine/Block.STL", alone / "workflow"
    catalogue = workflow / "indenters.toml"
    catalogue.write_text(catalogue.read_text() + f'\n[mine]\nkind = "stl"\nfile = "{name}"\nscale = 1\n')
    rows = read_csv(alone / "data/tiny/log.csv")
    rows[0] |= {"indenter": "mine", "dz_mm": "-0.2"}
    write_csv(alone / "data/tiny/log.csv", list(rows[0]), rows)
    (workflow / name).parent.mkdir(parents=True, exist_ok=True)
    pressed = []
    for side in (8.0, 4.0):
        block(workflow / name, side)
        assert make(alone, "forces", "DATASET=tiny").returncode == 0
        pressed.append(ForceFile(alone / "results/tiny/40_forces/0000.npz").total[0, 2])
    assert pressed[0] < 1.5 * pressed[1] < 0.0


def test_the_variable_of_a_rigs_plan_is_no_file_of_the_flow(alone):
    before = (alone / "Makefile").read_bytes()
    done = make(alone, "rig", "poses", "DATASET=tiny", "PLAN=Makefile")
    assert done.returncode and "Makefile: " in done.stdout
    assert make(alone, "poses", "DATASET=tiny", "PLAN=Makefile").returncode == 0
    assert (alone / "Makefile").read_bytes() == before


def test_a_picture_that_is_put_into_any_folder_of_the_log_is_seen(alone):
    data = alone / "data/tiny"
    rows = read_csv(data / "log.csv")
    picture = data / rows[0]["image"]
    (data / "pics").mkdir()
    rows[0] |= {"image": "pics/a.png"}
    write_csv(data / "log.csv", list(rows[0]), rows)
    assert "rejected: " in make(alone, "poses", "DATASET=tiny").stdout
    shutil.copy(picture, data / "pics/a.png")
    done = make(alone, "poses", "DATASET=tiny")
    assert "10_poses/0000.csv" in done.stdout and "rejected: " not in done.stdout
    assert "gelforge.flow.step" not in make(alone, "-n", "poses", "DATASET=tiny").stdout
    shutil.rmtree(data / "pics")
    assert "rejected: " in make(alone, "poses", "DATASET=tiny").stdout


@pytest.mark.parametrize(
    ("names", "folders"),
    [
        (["images/a.png", "images/run 1/b.png", "", "../c.png", "/d.png"], ["data/x/images"]),
        ([f"images/{k:06d}/frame.png" for k in range(9)] + ["left/a.png"], ["data/x/images", "data/x/left"]),
        (["a.png", "images/b.png"], ["data/x"]),
        (["my pictures/a.png", "images/b.png"], ["data/x"]),
    ],
)
def test_folders_of_pictures_are_few_and_make_can_name_them(names, folders):
    rows = [RawRow(k + 2, {"image": name}) for k, name in enumerate(names)]
    assert picture_folders(Path("data/x"), rows) == folders


def test_what_is_left_of_a_dataset_whose_data_are_gone_is_seen_and_removed(alone):
    assert make(alone, "poses", "DATASET=tiny").returncode == 0
    shutil.rmtree(alone / "data/tiny")
    assert "10_poses" in make(alone, "status", "DATASET=tiny").stdout
    done = make(alone, "clean-all", "DATASET=tiny")
    assert done.returncode == 0 and not (alone / "results/tiny").exists(), done.stdout


def test_another_choice_is_named_as_the_cause(tmp_path, monkeypatch):
    write_text(
        tmp_path / "Makefile",
        "page/index.html: page/choice.txt\n\ttouch $@\npage/choice.txt: choose-anew\n\ttouch $@\n.PHONY: choose-anew\n",
    )
    for age, name in enumerate(("page/choice.txt", "page/index.html")):
        write_text(tmp_path / name, "")
        os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
    monkeypatch.chdir(tmp_path)
    said = "\n".join(why_lines("page/index.html", reasons(ask_make("page/index.html", []))))
    assert "page/choice.txt" in said and "another choice" in said


def test_each_file_that_a_word_asks_for_is_a_cause(tmp_path, monkeypatch):
    write_text(
        tmp_path / "Makefile", "all: d/a.csv d/b.csv\nd/a.csv d/b.csv: strict\n\ttouch $@\n.PHONY: strict all\n"
    )
    for name in ("d/a.csv", "d/b.csv"):
        write_text(tmp_path / name, "")
    monkeypatch.chdir(tmp_path)
    found = reasons(ask_make("all", []))
    assert set(found) == {"d/a.csv", "d/b.csv"}
    assert all("STRICT=1" in why for reasons_of in found.values() for why in reasons_of)


@pytest.mark.parametrize("stage", sorted({of.module for of in SOURCES.values()}))
def test_results_follow_the_version_of_their_stage(root, stage):
    """What a newer version of the code makes otherwise is made again: the version is a prerequisite of one of its rules."""
    slices = {f"$P/{name}.json" for name, of in SOURCES.items() if of.module == stage}
    rules = re.findall(r"^(\S.*)\n\t(?:\$\(HANDS_SLOTS\))?\$\(call step,(\S+?)[ ,]", spelt_out(root), re.MULTILINE)
    of_stage = [head for head, module in rules if module in (f"gelforge.stages.{stage}", "$(PARETO_SCENE)")]
    assert any(slices & set(head.split()) for head in of_stage)


def test_every_stage_that_make_runs_has_a_version(root):
    run = set(re.findall(r"call step,gelforge\.stages\.(\w+)", spelt_out(root)))
    assert run == {of.module for of in SOURCES.values()}


def spelt_out(root):
    """The text of all rules, with the module in place of a macro that names a stage's command (poses_of = MODULE ...)."""
    text = "".join(rules_of(root))
    modules = dict(re.findall(r"^(\w+_of) = (gelforge\.stages\.\w+) ", text, re.MULTILINE))
    return re.sub(r"call step,\$\(call (\w+_of),", lambda found: f"call step,{modules[found[1]]} ", text)


def rules_of(root):
    """The text of all rules."""
    return [path.read_text() for path in sorted((root / "rules").glob("*.mk"))]


def prerequisites(project, goal, target) -> list[str]:
    """What make holds a target to depend on, order-only prerequisites left out; the last word where it planned anew."""
    said = make(project, "-pn", "DATASET=tiny", goal).stdout
    lines = re.findall(rf"^{re.escape(target)}:(.*)$", said, re.MULTILINE)
    assert lines, said[-2000:]
    return lines[-1].split("|")[0].split()


def test_the_page_is_made_again_for_every_parameter_that_it_prints(built):
    printed = {str(path.relative_to(built)) for path in built.glob("results/tiny/00_plan/params/*.json")}
    assert len(printed) > len(SOURCES)  # catalogues, too
    needed = prerequisites(built, "report", "results/tiny/90_report/index.html")
    assert printed <= set(needed) and needed[0].endswith("/report.json")


def test_the_open_benchmark_is_written_again_for_what_its_files_and_keys_hold(labelled):
    keys, catalogue = labelled / "data/fea_challenge/keys.json", labelled / "workflow/indenters.toml"
    text = catalogue.read_text(encoding="utf-8")
    write_text(keys, "{}")
    write_text(catalogue, text + '\n[probe]\nkind = "stl"\nfile = "probe.stl"   # closed, tip down\n')
    block(labelled / "workflow/probe.stl", 2.0)
    needed = set(prerequisites(labelled, "fea-challenge", "results/fea_challenge/challenge.json"))
    code = {f"src/gelforge/{name}.py" for name in ("sweeps/challenge", "stages/pareto", "sweeps/methods")}
    assert {"data/fea_challenge/keys.json", "workflow/probe.stl", *code} <= needed
