"""What people choose on the command line and in tables: make refuses what it cannot do, and runs nothing that it is given.

Almost all of it is asked of a dataset that is planned, and of which nothing is made.
"""

import os
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import write_text
from gelforge.flow.layout import metrics_of
from gelforge.stages.plan import make_list
from tests.support.sandbox import lay_dataset, link_project, make

EVERY_WAY = "$(shell touch pwned)`touch pwned`; touch pwned"


def planned_in(folder, root, *folders):
    """A sandbox with a dataset of two presses, planned, with these folders beside its log."""
    project = link_project(root, folder / "project")
    data = lay_dataset(project, root, "tiny", 2)
    for name in folders:
        (data / name).mkdir()
    assert make(project, "-n", "labels", "DATASET=tiny").returncode == 0
    return project


@pytest.fixture(scope="module")
def planned(root, tmp_path_factory):
    """A sandbox whose dataset is planned, which tests leave as it is."""
    return planned_in(tmp_path_factory.mktemp("planned"), root)


@pytest.fixture(scope="module")
def with_nocontact(root, tmp_path_factory):
    """Another one whose dataset has a place for no-contact images."""
    return planned_in(tmp_path_factory.mktemp("nocontact"), root, "nocontact")


@pytest.fixture
def own(planned, tmp_path):
    """A copy of that sandbox, to be changed."""
    return shutil.copytree(planned, tmp_path / "project", symlinks=True)


def test_make_reads_no_meaning_into_names():
    for word in ("$(shell touch x)", "a b", "a\nall: ; touch x", "a:b", "#", "", "%", "a;b", "-n", "`x`"):
        with pytest.raises(BadInput, match="cannot be a name in LIST"):
            make_list("LIST", ["fine-0.4", word])


def test_no_variable_of_the_command_line_runs_code(planned):
    words = [
        f"DATASET={EVERY_WAY}",
        "DATASET=../../x",
        "DATASET=",
        *(f"{name}={EVERY_WAY}" for name in ("RES", "MODEL", "TESTS")),
    ]
    for word in words:
        done = make(planned, "clean-all", *([] if word.startswith("DATASET") else ["DATASET=tiny"]), word)
        assert done.returncode and word.split("=")[0] in done.stdout and not (planned / "pwned").exists()
    assert [path.name for path in (planned / "results").iterdir()] == ["tiny"]


def test_text_from_the_command_line_is_one_word_of_the_shell(planned):
    done = make(planned, "-n", "rig", "look", "DATASET=tiny", "PLAN=a b; touch pwned & (c) #1 %", "ID=x y")
    assert (
        done.returncode == 0 and "--plan 'a b; touch pwned & (c) #1 %'" in done.stdout and "--id 'x y'" in done.stdout
    )


@pytest.mark.parametrize(("given", "executor"), [("on the command line", "local"), ("by the environment", "slurm")])
def test_make_expands_nothing_that_it_is_given(root, tmp_path, executor, given):
    """Whatever variable it comes in, also one that no rule knows; of the environment, what a rule reads."""
    text = "$(shell touch pwned)$(eval X := $(shell touch pwned))a$b"
    project = link_project(root, tmp_path / "p")
    by_hand = given == "on the command line"
    for name in ("IMAGE", "FROM", "PLAN", "SLURM_PROFILE", "GELFORGE_REFERENCE", "ANYTHING"):
        done = make(
            project, "-n", "projection", "rig", "SENSOR=s", f"EXECUTOR={executor}", *([f"{name}={text}"] if by_hand else []),
            environment={} if by_hand else {name: text},
        )  # fmt: skip
        assert not (project / "pwned").exists(), done.stdout
        assert (
            (": give text without" in done.stdout or "no such choice" in done.stdout)
            == (done.returncode != 0)
            == by_hand
        )


def test_a_recipe_that_takes_slots_of_make_is_only_shown_where_others_are(planned):
    """make runs such recipes even with -n, -q and -t where nothing keeps it from it."""
    for flag in ("-n", "-q", "-nk"):
        said = make(planned, flag, "calibrate", "DATASET=tiny").stdout
        assert ("flow.step results/tiny/calibrate/" in said) == ("n" in flag)
        assert not (planned / "results/tiny/calibrate").exists()


def test_jobs_of_a_program_are_those_of_the_command_line(planned):
    for words in (("-j1",), ("JOBS=3",)):
        said = make(planned, "-n", *words, "rig").stdout
        assert f"--jobs {words[0][-1]}" in said, said[-500:]


def test_a_network_that_cannot_be_had_is_refused_before_anything_is_solved(planned, with_nocontact):
    done = make(planned, "-n", "report", "DATASET=tiny", "MODEL=shipped")
    assert done.returncode and "data/tiny/nocontact is missing" in done.stdout and "MODEL=shipped" in done.stdout
    assert make(planned, "-n", "labels", "DATASET=tiny", "MODEL=shipped").returncode == 0
    # the one of the demo, which learns from two dozen presses, would take the place of the one that ships
    done = make(with_nocontact, "-n", "ship", "DATASET=tiny")
    assert done.returncode and "name the new one" in done.stdout
    assert make(with_nocontact, "-n", "ship", "DATASET=tiny", "MODEL=unet").returncode == 0


def test_what_a_network_reads_is_seen_however_toml_writes_it(own):
    """Before anything is solved for it."""
    path = own / "workflow/models.toml"
    tables = (
        "[a]\nkind = 'grid'\nwidth = 4\nblocks = 1\n"
        '[ b ]  # ours\nwidth = 4\nblocks = 1\n"kind" = """grid"""\n'
        "[c]\n    kind='grid' # a pair\nwidth = 4\nblocks = 1\n"
    )
    inline = '"d" = {kind = "grid", width = 4, blocks = 1}'
    write_text(path, f"{inline}\n{path.read_text(encoding='utf-8')}\n{tables}")
    assert make(own, "-n", "labels", "DATASET=tiny").returncode == 0
    lines = (own / "results/tiny/00_plan/plan.mk").read_text().splitlines()
    lists = {name: words.split() for name, words in (line.split(" :=", 1) for line in lines)}
    assert set("abcd") <= set(lists["MODELS"]) and set("abcd") <= set(lists["NEED_NOCONTACT"])


def test_a_list_of_networks_that_is_no_toml_is_named_by_file_and_line(own):
    path = own / "workflow/models.toml"
    text = path.read_text(encoding="utf-8")
    write_text(path, f"kind = 'grid\n{text}")
    done = make(own, "-n", "report", "DATASET=tiny", "MODEL=unet")
    assert done.returncode and "workflow/models.toml: not valid TOML: " in done.stdout and "line 1" in done.stdout
    assert make(own, "-n", "help").returncode == 0


def test_where_the_report_shows_the_shipped_network_another_one_trains_without_nocontact_images(own):
    path = own / "data/tiny/dataset.toml"
    text = path.read_text(encoding="utf-8")
    write_text(path, f'{text}\n[params.report]\nmodel = "shipped"\n')
    assert "70_train/24x32/unet.onnx" in make(own, "-n", "train", "DATASET=tiny").stdout
    assert "data/tiny/nocontact is missing" in make(own, "-n", "evaluate", "DATASET=tiny").stdout


def test_other_datasets_are_learnt_from_as_they_lie(own):
    path, here = own / "data/tiny/dataset.toml", own / "results/here/60_dataset/24x32/dataset.json"
    text = path.read_text(encoding="utf-8")
    write_text(here, "{}")
    for also, said in (
        (["here", "gone"], "make DATASET=gone RES=24x32 dataset"), (["tiny"], "names the dataset itself"), (["a b"], "also"),
    ):  # fmt: skip
        write_text(path, f"{text}\n[params.train]\nalso = {also}\n")
        refused = make(own, "-n", "train", "DATASET=tiny")
        assert refused.returncode == 2 and said in refused.stdout
    write_text(path, f'{text}\n[params.train]\nalso = ["here"]\n')
    expected = make(own, "-n", "train", "DATASET=tiny")
    assert expected.returncode == 0
    assert "results/here/60_dataset/24x32/dataset.json" in inputs_of(expected.stdout, "70_train/24x32/unet.onnx")


def test_the_record_of_a_target_names_the_network_that_it_starts_from(with_nocontact):
    for model, target, kind in (
        ("tuned", "70_train/24x32/tuned.onnx", "safetensors"), ("shipped", "80_evaluate/24x32/shipped.json", "onnx"),
    ):  # fmt: skip
        said = make(with_nocontact, "-n", "evaluate", "DATASET=tiny", f"MODEL={model}").stdout
        assert f"src/gelforge/reading/weights/default.{kind}" in inputs_of(said, target)


def inputs_of(said: str, target: str) -> list[str]:
    """What a recipe that make printed gives its wrapper as inputs."""
    return re.search(rf"flow\.step results/tiny/{re.escape(target)} (.*)", said)[1].split()


def test_a_network_that_goes_on_waits_for_the_one_that_ships_and_keeps_to_its_grid(planned):
    def needs(target: str, *words: str) -> list[str]:
        lines = make(planned, "-pn", "data-that-is-none", "DATASET=tiny", *words).stdout.splitlines()
        return next(line.split() for line in lines if line.startswith(f"{target}:"))

    folder = "results/tiny/70_train"
    assert "src/gelforge/reading/weights/default.safetensors" in needs(f"{folder}/24x32/tuned.onnx")
    assert "src/gelforge/reading/weights/default.safetensors" not in needs(f"{folder}/24x32/pair_24.onnx")
    # what ships may be a network of another kind, whose place in a comparison of all is no matter of a dataset
    assert f"{folder}/24x32/tuned.onnx" not in needs("results/tiny/pareto_models/24x32.json")


def step_targets(project, *words) -> list[str]:
    """Targets of the wrapper in what make would run for these words."""
    said = make(project, "-pn", "DATASET=tiny", *words).stdout
    return re.findall(r"-m gelforge\.flow\.step (\S+) ", said)


def test_no_two_targets_share_a_log_and_a_record(with_nocontact):
    """A record is named by its target without the suffix: one that another overwrote would call the first corrupt."""
    goals = "pareto", "stability", "calibrate", "report", "feats-export", "pareto-models"
    found = set(step_targets(with_nocontact, *goals))
    assert len(found) > 50
    assert {name.split("/")[2] for name in found if "/" in name} == {
        "10_poses", "15_images", "20_meshes", "30_fea", "40_forces", "50_labels", "60_dataset", "70_train", "80_evaluate", "90_report",
        "calibrate", "feats", "pareto", "pareto_models", "stability",
    }  # fmt: skip
    records = Counter(str(metrics_of(Path(name))) for name in found)
    assert [name for name, count in records.items() if count > 1] == []


def test_a_report_of_imported_labels_solves_nothing(alone):
    """Of labels that came with their pictures no pose may be known."""
    write_text(alone / "data/tiny/labels/24x32.npz", "")
    write_text(alone / "data/tiny/dataset.toml", "[params.report]\nbranches = []\n")
    said = make(alone, "-n", "report", "DATASET=tiny", "MODEL=unet").stdout
    assert "flow.step results/tiny/90_report/" in said and "flow.step results/tiny/60_dataset/" in said, said
    assert not re.findall(r"flow\.step results/tiny/[1-5]0_", said)


def test_a_projection_without_a_sensor_is_one_sentence(alone):
    done = make(alone, "projection", "POINTS=p.csv")
    assert done.returncode and "no sensor named; say make projection SENSOR=name" in done.stdout, done.stdout
    assert "warning" not in done.stdout and "usage" not in done.stdout


def test_cleaning_goes_alone(alone):
    """Both at a time would remove what was found up to date, and end well."""
    write_text(alone / "results/tiny/50_labels/kept", "")
    done = make(alone, "clean-labels", "labels", "DATASET=tiny")
    assert done.returncode and "say make clean-labels first" in done.stdout
    assert (alone / "results/tiny/50_labels/kept").exists()
    assert make(alone, "clean-labels", "clean-fea", "DATASET=tiny").returncode == 0
    assert not (alone / "results/tiny/50_labels").exists()


def test_an_environment_that_moved_with_its_clone_is_named(own):
    """Its programs start in the place where it was made; make says so before it runs anything of it."""
    venv = own / ".venv"
    venv.unlink()
    venv.mkdir()
    (venv / "pyvenv.cfg").write_text("home = /usr/bin\ncommand = /usr/bin/python3 -m venv /elsewhere/.venv\n")
    done = make(own, "poses", "DATASET=tiny")
    assert done.returncode and "made for /elsewhere/.venv" in done.stdout and "make setup" in done.stdout
    for options in ("", "--clear ", "--clear --upgrade "):
        command = f"/usr/bin/python3 -m venv {options}{venv}"
        (venv / "pyvenv.cfg").write_text(f"home = /usr/bin\ncommand = {command}\n")
        assert make(own, "help").returncode == 0


def test_what_a_linked_environment_says_is_left_to_the_checkout_it_belongs_to(root, tmp_path):
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs/found").write_text("as they found it\n")
    (tmp_path / "ours").symlink_to("theirs")
    for program in ("ccx", "slurm", "chromium"):
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


def test_every_phony_name_does_something(planned):
    said = make(planned, "-pn", "DATASET=tiny", "report").stdout
    names = set(re.findall(r"^([a-z][a-z-]*):.*\n(?:#.*\n)*#  Phony target", said, re.MULTILINE))
    assert {"clean-all", "report"} <= names
    idle = [
        name for name in names
        if re.search(rf"^{name}:\s*\n(?:#.*\n)*\n", said, re.MULTILINE) and name != "meshes"
    ]  # fmt: skip
    assert idle == []


def test_a_file_beside_the_makefile_takes_the_place_of_no_module_of_python(own):
    (own / "types.py").write_text("raise RuntimeError('stray')\n")
    for goal in ("poses", "status"):
        done = make(own, goal, "DATASET=tiny")
        assert done.returncode == 0 and "stray" not in done.stdout, done.stdout


def test_a_dry_run_before_set_up_installs_nothing(own):
    """It installed 5 GB and system packages, because make makes what it includes even with -n."""
    (own / ".venv").unlink()
    for flag in ("-n", "-q", "-t"):
        done = make(own, flag, "labels", "DATASET=tiny")
        assert done.returncode and "not set up yet: run make setup" in done.stdout
    assert make(own, "help").returncode == 0 and not (own / ".venv").exists()


def test_a_dry_run_with_newer_scripts_of_set_up_runs_none_of_them(own, root):
    """Of an environment that is the project's own; `make setup` runs them."""
    venv, envs = own / ".venv", own / "envs"
    made = venv.resolve()
    for link in (venv, envs):
        link.unlink()
        link.mkdir()
    for name in ("bin", "lib"):
        (venv / name).symlink_to(made / name)
    for name in ("ready", "ccx.path", "kernels.compiled"):
        write_text(venv / name, "none\n")
        os.utime(venv / name, (1e9, 1e9))
    shutil.copy(root / "envs/requirements.lock", envs)
    for name in ("venv.sh", "ccx.sh"):
        write_text(envs / name, f'#!/bin/sh\necho {name} >>ran\ntouch "$1"\n')
        (envs / name).chmod(0o755)
    write_text(
        envs / "kernels.py", "import sys\nopen('ran', 'a').write('kernels.py\\n')\nopen(sys.argv[1], 'a').close()\n"
    )
    for flag in ("-n", "-q", "-nk"):
        said = make(own, flag, "labels", "DATASET=tiny").stdout
        assert not (own / "ran").exists() and ("50_labels" in said) == ("n" in flag), said
    assert "envs/ccx.sh .venv/ccx.path" in make(own, "-n", "setup").stdout and not (own / "ran").exists()
    assert make(own, "setup").returncode == 0
    assert sorted((own / "ran").read_text().split()) == ["ccx.sh", "kernels.py", "venv.sh"]
    (venv / "ccx.path").unlink()
    done = make(own, "-n", "labels", "DATASET=tiny")
    assert done.returncode and "not set up yet" in done.stdout and not (venv / "ccx.path").exists()


def test_a_misspelt_choice_is_refused_and_the_environment_is_none(own):
    """`make DATSET=mylab` made the demo; a MODEL left over in a shell changed what was trained."""
    for word in ("DATSET=tiny", "CHARTED=unet", "JOB=3", "PY=python"):
        done = make(own, "-n", "labels", word)
        assert done.returncode and f"{word}: no such choice; there are DATASET RES" in done.stdout
    said = make(own, "-n", "train", "DATASET=tiny", environment={"MODEL": "pair_8", "RES": "1x1", "JOBS": "x"}).stdout
    assert "70_train/24x32/unet.onnx" in said


def test_results_of_the_project_itself_are_no_dataset(own):
    """`make clean-all DATASET=benchmarks` removed tracked files."""
    write_text(own / "results/benchmarks/kept.json", "{}")
    for name in ("benchmarks", "readme", "solves"):
        assert "holds no dataset" in make(own, "clean-all", f"DATASET={name}").stdout
    assert (own / "results/benchmarks/kept.json").exists()


def test_a_network_that_was_added_after_the_plan_is_known(own):
    """A check by the outdated plan would refuse it."""
    path = own / "workflow/models.toml"
    write_text(path, path.read_text(encoding="utf-8") + '\n[new]\nkind = "unet"\nwidths = [4, 8]\n')
    assert "70_train/24x32/new.onnx" in make(own, "-n", "train", "DATASET=tiny", "MODEL=new").stdout
    refused = make(own, "-n", "train", "DATASET=tiny", "MODEL=newer")
    assert refused.returncode and "MODEL=newer: no such network" in refused.stdout
