"""What a plan depends on: contents and not names, states and not ages; and nothing of it reaches make or a shell."""

import os
import re
import shutil
import subprocess
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from parameters import parameters

from gelforge.commands.why import ask_make, reasons
from gelforge.commands.why import lines as why_lines
from gelforge.errors import BadInput
from gelforge.flow.catalogue import with_content
from gelforge.flow.files import read_csv, write_csv, write_text
from gelforge.flow.layout import metrics_of
from gelforge.flow.params import SOURCES, digest_of_value
from gelforge.geometry.triangles import write_stl
from gelforge.records.forcefile import ForceFile
from gelforge.records.press import RawRow
from gelforge.stages.fea import shape_of
from gelforge.stages.plan import check_count, make_list, picture_folders, used
from tests.benchmarks.sandbox import comma_language, link_project, make
from tests.waiting import HANG

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


@pytest.mark.parametrize(
    "word", ["$(shell touch x)", "a b", "a\nall: ; touch x", "a:b", "#", "", "%", "a;b", "-n", "`x`"]
)
def test_make_reads_no_meaning_into_names(word):
    with pytest.raises(BadInput, match="cannot be a name in LIST"):
        make_list("LIST", ["fine-0.4", word])


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


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        ("DATASET", "../../x", "DATASET=../../x"),
        ("DATASET", "a;touch pwned", "DATASET="),
        ("DATASET", "$(shell touch pwned)", "DATASET="),
        ("SENSOR", "a b", "SENSOR=a b"),
        ("RES", "24", "RES=24"),
        ("RES", "24x32;ls", "RES="),
        ("RES", "x32", "RES=x32"),
        ("RES", "24x32x7", "RES=24x32x7"),
        ("RES", "0x32", "RES=0x32"),
        ("RES", "24xx32", "RES=24xx32"),
        ("RES", "24x00", "RES=24x00"),
        ("RES", "", "RES="),
        ("DATASET", "", "DATASET is empty"),
        ("DATASET", " ", "DATASET is empty"),
        ("MODEL", "", "MODEL is empty"),
        ("MODEL", "grid16", "workflow/models.toml has: "),
        ("JOBS", "", "JOBS is empty"),
    ],
)
def test_what_cannot_be_a_name_is_refused_before_anything_is_made(labelled, variable, value, message):
    done = make(labelled, "-n", "labels", *(["DATASET=tiny"] if variable != "DATASET" else []), f"{variable}={value}")
    assert done.returncode and message in done.stdout and not (labelled / "pwned").exists()
    assert [path.name for path in (labelled / "results").iterdir()] == ["tiny"]


@pytest.fixture
def with_nocontact(labelled):
    """The project whose dataset has a place for no-contact images."""
    (labelled / "data/tiny/nocontact").mkdir()
    return labelled


@pytest.mark.parametrize("goal", ["train", "onnx", "ship"])
def test_the_shipped_network_is_not_trained_under_another_name(with_nocontact, goal):
    done = make(with_nocontact, "-n", goal, "DATASET=tiny", "MODEL=shipped")
    assert done.returncode and f"to {goal}, name one of" in done.stdout
    assert make(with_nocontact, "-n", "evaluate", "DATASET=tiny", "MODEL=shipped").returncode == 0


@pytest.mark.parametrize("model", ["shipped", "pair_24_mirrored", "difference_16", "tuned"])
def test_a_network_that_needs_nocontact_images_is_refused_before_anything_is_solved(labelled, model):
    done = make(labelled, "-n", "report", "DATASET=tiny", f"MODEL={model}")
    assert done.returncode and "data/tiny/nocontact is missing" in done.stdout and f"MODEL={model}" in done.stdout
    assert make(labelled, "-n", "report", "DATASET=tiny", "MODEL=grid_16").returncode == 0
    assert make(labelled, "-n", "labels", "DATASET=tiny", f"MODEL={model}").returncode == 0


@pytest.mark.parametrize(
    "table",
    [
        "[mine]\nkind = 'grid'\nwidth = 4\nblocks = 1\nreads = 'pair'",
        '[ mine ]  # ours\nkind = "grid"\nwidth = 4\nblocks = 1\n"reads" = """difference"""',
        "[mine]\n    reads='difference' # a difference\nkind = \"grid\"\nwidth = 4\nblocks = 1",
        '"mine" = {kind = "grid", width = 4, blocks = 1, reads = "pair"}',
    ],
)
def test_what_a_network_reads_is_seen_however_toml_writes_it(labelled, table):
    """Before anything is solved for it."""
    path = labelled / "workflow/models.toml"
    text = path.read_text(encoding="utf-8")
    write_text(path, f"{table}\n{text}" if table.startswith('"') else f"{text}\n{table}\n")
    done = make(labelled, "-n", "report", "DATASET=tiny", "MODEL=mine")
    assert done.returncode and "data/tiny/nocontact is missing" in done.stdout and "MODEL=mine" in done.stdout


def test_a_list_of_networks_that_is_no_toml_is_named_by_file_and_line(labelled):
    path = labelled / "workflow/models.toml"
    text = path.read_text(encoding="utf-8")
    write_text(path, f"reads = 'pair\n{text}")
    done = make(labelled, "-n", "report", "DATASET=tiny", "MODEL=grid_16")
    assert done.returncode and "workflow/models.toml: not valid TOML: " in done.stdout and "line 1" in done.stdout
    assert make(labelled, "-n", "help").returncode == 0


def test_a_recipe_that_takes_slots_of_make_is_only_shown_where_others_are(labelled):
    """make runs such recipes even with -n, -q and -t where nothing keeps it from it."""
    for flag in ("-n", "-q", "-nk"):
        said = make(labelled, flag, "calibrate", "DATASET=tiny").stdout
        assert ("gelforge.stages.calibrate" in said) == ("n" in flag)
        assert not (labelled / "results/tiny/calibrate").exists()
    assert "--jobs 3 " in make(labelled, "-n", "-j3", "calibrate", "DATASET=tiny").stdout


@pytest.mark.parametrize("goal", ["models", "evaluate-models", "pareto-models"])
def test_many_networks_are_refused_where_one_of_them_needs_nocontact_images(labelled, goal):
    done = make(labelled, "-n", goal, "DATASET=tiny")
    assert done.returncode and "data/tiny/nocontact is missing" in done.stdout
    assert make(labelled, "-n", "pareto-models", "DATASET=tiny", "CHARTED=grid_16").returncode == 0


def test_no_network_ships_that_nobody_named(with_nocontact):
    """The one of the demo, which learns from two dozen presses, would take the place of the one that ships."""
    done = make(with_nocontact, "-n", "ship", "DATASET=tiny")
    assert done.returncode and "name the one that shall" in done.stdout
    assert make(with_nocontact, "-n", "ship", "DATASET=tiny", "MODEL=grid_16").returncode == 0


def test_where_the_report_shows_the_shipped_network_another_one_trains_without_nocontact_images(labelled):
    path = labelled / "data/tiny/dataset.toml"
    text = path.read_text(encoding="utf-8")
    write_text(path, f'{text}\n[params.report]\nmodel = "shipped"\n')
    assert "70_train/24x32/grid_16.onnx" in make(labelled, "-n", "train", "DATASET=tiny").stdout
    assert "data/tiny/nocontact is missing" in make(labelled, "-n", "evaluate", "DATASET=tiny").stdout


@pytest.fixture
def also(labelled):
    """Gives the names of other datasets that the dataset is learnt with."""
    path = labelled / "data/tiny/dataset.toml"
    text = path.read_text(encoding="utf-8")
    return lambda *names: write_text(path, f"{text}\n[params.train]\nalso = {list(names)}\n")


def test_other_datasets_are_learnt_from_as_they_lie(labelled, also):
    also("here", "gone")
    here = labelled / "results/here/60_dataset/24x32/dataset.json"
    write_text(here, "{}")
    refused = make(labelled, "-n", "train", "DATASET=tiny")
    assert refused.returncode == 2 and "make DATASET=gone RES=24x32 dataset" in refused.stdout
    also("here")
    expected = make(labelled, "-n", "train", "DATASET=tiny")
    assert expected.returncode == 0 and "--also results/here/60_dataset/24x32 --model" in expected.stdout
    assert "results/here/60_dataset/24x32/dataset.json" in inputs_of(expected.stdout, "70_train/24x32/grid_16.onnx")


@pytest.mark.parametrize(
    ("model", "target"), [("tuned", "70_train/24x32/tuned.onnx"), ("shipped", "80_evaluate/24x32/shipped.json")]
)
def test_the_record_of_a_target_names_the_network_that_it_starts_from(with_nocontact, model, target):
    said = make(with_nocontact, "-n", "evaluate", "DATASET=tiny", f"MODEL={model}").stdout
    kind = "safetensors" if model == "tuned" else "onnx"
    assert f"src/gelforge/networks/weights/default.{kind}" in inputs_of(said, target)


def inputs_of(said: str, target: str) -> list[str]:
    """What a recipe that make printed gives its wrapper as inputs."""
    return re.search(rf"flow\.step results/tiny/{re.escape(target)} (.*?) -- ", said)[1].split()


def test_a_study_of_parts_is_not_compared_with_more_than_their_whole(labelled, also):
    here = labelled / "results/here/60_dataset/24x32/dataset.json"
    write_text(here, "{}")
    also("here")
    refused = make(labelled, "-n", "study", "DATASET=tiny")
    assert refused.returncode == 2 and "[train] also = here: a study compares parts of one dataset" in refused.stdout
    assert "[params.train] also = [] in data/tiny/dataset.toml" in refused.stdout
    assert "gelforge.stages.train" not in refused.stdout
    also()
    assert make(labelled, "-n", "study", "DATASET=tiny").returncode == 0


@pytest.mark.parametrize(("name", "said"), [("tiny", "names the dataset itself"), ("a b", "also")])
def test_what_cannot_be_learnt_with_is_refused(labelled, also, name, said):
    also(name)
    refused = make(labelled, "-n", "train", "DATASET=tiny")
    assert refused.returncode == 2 and said in refused.stdout


EVERY_WAY = "$(shell touch pwned)`touch pwned`; touch pwned"


@pytest.mark.parametrize(
    ("variable", "value"),
    [*((name, EVERY_WAY) for name in ("FORMAT", "EXECUTOR", "CHARTED", "TESTS", "JOBS")),
     *(("MODEL", value) for value in ("$(shell touch pwned)", "`touch pwned`", "; touch pwned", "a'b"))],
)  # fmt: skip
def test_no_variable_of_the_command_line_runs_code(labelled, variable, value):
    done = make(labelled, "help", f"{variable}={value}")
    assert done.returncode and f"{variable}=" in done.stdout and not (labelled / "pwned").exists()


@pytest.mark.parametrize("value", ["$(shell touch pwned)", "`touch pwned`", "';touch pwned;'", '";touch pwned;"'])
def test_text_from_the_command_line_is_one_word_of_the_shell(labelled, value):
    goals = ("sample", "look", "provenance")
    done = make(labelled, "-k", *goals, "DATASET=tiny", f"ID={value}")
    assert not (labelled / "pwned").exists()
    assert all(re.search(rf"\[\S+: {goal}\] Error", done.stdout) for goal in goals), done.stdout


def test_a_target_runs_by_its_former_name_too(labelled):
    new, old = (make(labelled, "-n", name, "DATASET=tiny", "ID=s000").stdout for name in ("provenance", "lineage"))
    (command,) = [line for line in new.splitlines() if "gelforge.commands.provenance" in line]
    assert command in old.splitlines() and "make lineage is called make provenance now" in old


@pytest.mark.parametrize("executor", ["local", "slurm"])
@pytest.mark.parametrize("given", ["on the command line", "by the environment"])
def test_make_expands_nothing_that_it_is_given(root, tmp_path, executor, given):
    """Whatever variable it comes in, also one that no rule knows, and where prerequisites are expanded twice."""
    text = "$(shell touch pwned)$(eval X := $(shell touch pwned))a$b"
    project = link_project(root, tmp_path / "p")
    names = ["REFERENCE", "IMAGE", "POINTS", "LIKE", "FROM", "TOPICS", "PLAN", "ID", "TARGET", "STRICT", "DETACH",
             "SLURM_PROFILE", "GELFORGE_REFERENCE", "ANYTHING"]  # fmt: skip
    by_hand = given == "on the command line"
    words = [f"{name}={text}" for name in names] if by_hand else []
    done = make(
        project, "-n", "projection", "rig", "mcap-import", "real-check", "SENSOR=s", f"EXECUTOR={executor}", *words,
        environment={} if by_hand else dict.fromkeys(names, text),
    )  # fmt: skip
    assert done.returncode == 0 and not (project / "pwned").exists(), done.stdout
    for option in ("--image", "--points", "--like", "--plan", "--from", "--topics", "--reference"):
        assert f"{option} '{text}'" in done.stdout


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
    done = make(labelled, "labels", "DATASET=tiny")
    assert done.returncode == 0, done.stdout
    assert lost_by_log(labelled) == {lines[-1].split(",")[0]}
    assert [row["sample_id"] for row in read_csv(labelled / "results/tiny/10_poses/0000.csv")] == [
        lines[1].split(",")[0]
    ]
    assert solve.stat().st_mtime_ns == solved  # solved presses are known by what they were solved of


def test_clocks_a_moment_apart_are_waited_for(labelled, dated):
    dated("10_poses/0000.csv", 1.5)
    assert make(labelled, "labels", "DATASET=tiny").returncode == 0


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


def test_files_of_odd_names_beside_a_dataset_disturb_nothing(with_nocontact):
    labelled, picture = with_nocontact, with_nocontact / "data/tiny/nocontact/mini_a copy.png"
    picture.write_bytes(b"")
    (labelled / "workflow" / "x (1).stl").write_bytes(b"") if not (labelled / "workflow").is_symlink() else None
    done = make(labelled, "-n", "labels", "DATASET=tiny")
    assert done.returncode == 0, done.stdout
    assert make(labelled, "-n", "dataset", "DATASET=tiny").returncode == 0
    picture.unlink()


def test_more_shards_than_make_can_hold_are_refused():
    with pytest.raises(BadInput, match=r"125000 shards of up to 8 samples .* shard_size = 500 or more"):
        check_count(["0"] * 125_000, 8)


@pytest.mark.parametrize("asked", [["nope"], "calibrate", [1], ["$(shell x)"]])
def test_a_branch_that_is_none_is_refused(asked):
    with pytest.raises(BadInput, match=r'\[report\] branches = .*: give a list of .*"calibrate" or "pareto"'):
        parameters(report={"branches": asked})


def test_an_environment_that_moved_with_its_clone_is_named(labelled):
    """Its programs start in the place where it was made; make says so before it runs anything of it."""
    venv = labelled / ".venv"
    venv.unlink()
    venv.mkdir()
    (venv / "pyvenv.cfg").write_text("home = /usr/bin\ncommand = /usr/bin/python3 -m venv /elsewhere/.venv\n")
    done = make(labelled, "poses", "DATASET=tiny")
    assert done.returncode and "made for /elsewhere/.venv" in done.stdout and "make setup" in done.stdout
    for options in ("", "--clear ", "--clear --upgrade "):
        command = f"/usr/bin/python3 -m venv {options}{venv}"
        (venv / "pyvenv.cfg").write_text(f"home = /usr/bin\ncommand = {command}\n")
        assert make(labelled, "help").returncode == 0


def test_why_names_the_parameter_that_changed_and_what_follows(labelled):
    assert "up to date" in make(labelled, "why", "TARGET=labels", "DATASET=tiny").stdout
    table = labelled / "data/tiny/dataset.toml"
    text = table.read_text()
    table.write_text(text.replace("tolerance = 0.2", "tolerance = 0.25"))
    said = make(labelled, "why", "TARGET=labels", "DATASET=tiny").stdout
    assert "30_fea/0000.csv" in said and "parameters of fea changed" in said, said


def test_why_is_reported_of_a_target_that_needs_a_choice_of_its_own(labelled):
    said = make(labelled, "why", "TARGET=export", "FORMAT=hdf5", "DATASET=tiny")
    assert said.returncode == 0 and "does not exist" in said.stdout, said.stdout


@pytest.mark.parametrize("program", ["ccx", "slurm", "chromium"])
def test_what_a_linked_environment_says_is_left_to_the_checkout_it_belongs_to(root, tmp_path, program):
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs/found").write_text("as they found it\n")
    (tmp_path / "ours").symlink_to("theirs")
    subprocess.run([root / f"envs/{program}.sh", tmp_path / "ours/found"], check=True)
    assert (tmp_path / "theirs/found").read_text() == "as they found it\n"


def test_a_clone_in_a_folder_with_a_blank_works_on(root, tmp_path):
    project = link_project(root, tmp_path / "my clone")
    (project / ".venv").unlink()
    (project / ".venv").mkdir()
    command = f"/usr/bin/python3 -m venv {project}/.venv"
    (project / ".venv" / "pyvenv.cfg").write_text(f"home = /usr/bin\ncommand = {command}\n")
    done = make(project, "help")
    assert done.returncode == 0, done.stdout


def step_targets(project, *words) -> list[str]:
    """Targets of the wrapper in what make would run for these words."""
    said = make(project, "-pn", "DATASET=tiny", *words).stdout
    return re.findall(r"-m gelforge\.flow\.step (\S+) ", said)


def test_no_two_targets_share_a_log_and_a_record(with_nocontact):
    """A record is named by its target without the suffix: one that another overwrote would call the first corrupt."""
    goals = (
        "models",
        "evaluate-models",
        "study",
        "pareto",
        "stability",
        "calibrate",
        "report",
        "onnx",
        "feats-export",
        "pareto-models",
    )
    found = set(step_targets(with_nocontact, *goals))
    assert len(found) > 100 and any("/study/" in name for name in found)
    records = Counter(str(metrics_of(Path(name))) for name in found)
    assert [name for name, count in records.items() if count > 1] == []


@pytest.mark.parametrize(
    ("res", "model", "writes"),
    [("12x16", "grid_16", True), ("24x32", "grid_16", True), ("24x32", "tuned", True), ("12x16", "tuned", False)],
)
def test_the_network_of_a_report_is_the_one_it_names_at_every_resolution_that_it_writes(
    with_nocontact, res, model, writes
):
    table = with_nocontact / "data/tiny/dataset.toml"
    text = table.read_text()
    table.write_text(f'{text}\n[params.report]\nmodel = "{model}"\n')
    trained = [name for name in step_names(with_nocontact, res).split() if name.endswith(".onnx")]
    assert (trained == [f"results/tiny/70_train/{res}/{model}.onnx"]) is writes and trained


def step_names(project, res) -> str:
    return " ".join(step_targets(project, "report", f"RES={res}"))


def test_a_network_that_goes_on_waits_for_the_one_that_ships_and_keeps_to_its_grid(labelled):
    def needs(target: str, *words: str) -> list[str]:
        lines = make(labelled, "-pn", "data-that-is-none", "DATASET=tiny", *words).stdout.splitlines()
        return next(line.split() for line in lines if line.startswith(f"{target}:"))

    folder = "results/tiny/70_train"
    assert "src/gelforge/networks/weights/default.safetensors" in needs(f"{folder}/24x32/tuned.onnx")
    assert "src/gelforge/networks/weights/default.safetensors" not in needs(f"{folder}/24x32/pair_24.onnx")
    # what ships may be a network of another kind, whose place in a comparison of all is no matter of a dataset
    assert f"{folder}/24x32/tuned.onnx" not in needs("models")
    parts = "results/tiny/study/24x32"
    assert "src/gelforge/networks/weights/default.safetensors" in needs(
        f"{parts}/tuned/networks/units_4.onnx", "MODEL=tuned"
    )
    assert "src/gelforge/networks/weights/default.safetensors" not in needs(
        f"{parts}/pair_24/networks/units_4.onnx", "MODEL=pair_24"
    )


def test_jobs_of_a_program_are_those_of_the_command_line(labelled):
    for words in (("-j1",), ("JOBS=1",), ("-j3",), ("JOBS=3",)):
        said = make(labelled, "-n", *words, "DATASET=tiny", "calibrate").stdout
        assert f"--jobs {words[0][-1]} " in said, said[-500:]


@pytest.fixture
def alone(root, tmp_path):
    """A project of one press of its own, for what changes it beyond repair."""
    project = link_project(root, tmp_path / "project")
    lay_dataset(project, root, "tiny", 1)
    return project


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


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["clean-labels", "labels"], "say make clean-labels first, then make labels"),
        (["clean-all", "demo"], "say make clean-all first, then make demo"),
    ],
)
def test_cleaning_goes_alone(alone, words, says):
    """Both at a time would remove what was found up to date, and end well."""
    write_text(alone / "results/tiny/50_labels/kept", "")
    done = make(alone, *words, "DATASET=tiny")
    assert done.returncode and says in done.stdout and (alone / "results/tiny/50_labels/kept").exists()
    assert make(alone, "clean-labels", "clean-fea", "DATASET=tiny").returncode == 0
    assert not (alone / "results/tiny/50_labels").exists()


@pytest.mark.parametrize(("word", "strict"), [("0", False), ("no", False), ("", False), ("1", True)])
def test_strict_can_be_said_not_to_be(labelled, word, strict):
    said = make(
        labelled, "-n", "-W", "results/tiny/00_plan/shards/0000.csv", "poses", "DATASET=tiny", f"STRICT={word}"
    ).stdout
    assert "gelforge.stages.poses" in said and ("--strict" in said) == strict


def test_labels_that_were_imported_at_another_resolution_are_named(alone):
    write_text(alone / "data/tiny/labels/1x1.npz", "")
    done = make(alone, "dataset", "DATASET=tiny")
    assert done.returncode and "labels of 1x1, not of 24x32: say RES=1x1" in done.stdout, done.stdout


def test_a_report_of_imported_labels_solves_nothing(alone):
    """Of labels that came with their pictures no pose may be known."""
    write_text(alone / "data/tiny/labels/24x32.npz", "")
    write_text(alone / "data/tiny/dataset.toml", "[params.report]\nbranches = []\n")
    said = make(alone, "-n", "report", "DATASET=tiny", "MODEL=grid_16").stdout
    assert "gelforge.stages.report" in said and "gelforge.stages.dataset" in said, said
    assert not [
        stage for stage in ("poses", "meshes", "fea", "forces", "labels") if f"gelforge.stages.{stage} " in said
    ]


def test_a_projection_without_a_sensor_is_one_sentence(alone):
    done = make(alone, "projection", "POINTS=p.csv")
    assert done.returncode and "no sensor named; say make projection SENSOR=name" in done.stdout, done.stdout
    assert "warning" not in done.stdout and "usage" not in done.stdout


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
    rules = re.findall(
        r"^(\S.*)\n\t(?:\$\(HANDS_SLOTS\))?\$\(call step,(\S+) ", "".join(rules_of(root)), re.MULTILINE
    )
    of_stage = [head for head, module in rules if module in (f"gelforge.stages.{stage}", "$(PARETO_SCENE)")]
    assert any(slices & set(head.split()) for head in of_stage)


def test_every_stage_that_make_runs_has_a_version(root):
    run = set(re.findall(r"call step,gelforge\.stages\.(\w+)", "".join(rules_of(root))))
    assert run == {of.module for of in SOURCES.values()}


def rules_of(root):
    """The text of all rules."""
    return [path.read_text() for path in sorted((root / "rules").glob("*.mk"))]


def prerequisites(project, goal, target) -> list[str]:
    """What make holds a target to depend on, order-only prerequisites left out; the last word where it planned anew."""
    said = make(project, "-pn", "DATASET=tiny", goal).stdout
    lines = re.findall(rf"^{re.escape(target)}:(.*)$", said, re.MULTILINE)
    assert lines, said[-2000:]
    return lines[-1].split("|")[0].split()


def test_the_page_is_made_again_for_every_parameter_that_it_prints(labelled):
    printed = {str(path.relative_to(labelled)) for path in labelled.glob("results/tiny/00_plan/params/*.json")}
    assert len(printed) > len(SOURCES)  # catalogues, too
    needed = prerequisites(labelled, "report", "results/tiny/90_report/index.html")
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


def test_every_phony_name_does_something(labelled):
    said = make(labelled, "-pn", "DATASET=tiny", "report").stdout
    names = set(re.findall(r"^([a-z][a-z-]*):.*\n(?:#.*\n)*#  Phony target", said, re.MULTILINE))
    assert {"clean-venv", "clean-all", "report"} <= names
    idle = [
        name for name in names
        if re.search(rf"^{name}:\s*\n(?:#.*\n)*\n", said, re.MULTILINE) and name not in ("plan-again", "choose-anew", "strict", "gap-in-labels", "meshes")
    ]  # fmt: skip
    assert idle == []
