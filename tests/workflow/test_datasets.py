"""The tiny datasets of tests/data, each from its log to what can be made of it by one make, and a second one that makes nothing."""

import shutil

import numpy as np
import pytest

from gelforge.flow.files import read_csv
from gelforge.records.forcefile import ForceFile
from gelforge.records.labelfile import read_labels
from tests.support.sandbox import link_project, make

NAMES = ("frames", "bad_rows", "two_gels")


@pytest.fixture(scope="module")
def project(root, tmp_path_factory):
    """A sandbox with all of them, made."""
    project = link_project(root, tmp_path_factory.mktemp("datasets") / "project")
    for name in NAMES:
        data = shutil.copytree(root / "tests" / "data" / name, project / "data" / name)
        for row in read_csv(data / "log.csv"):
            if row["image"]:  # those of the demo
                (data / row["image"]).parent.mkdir(exist_ok=True)
                shutil.copy(root / "data" / "demo" / row["image"], data / row["image"])
                shutil.copytree(root / "data/demo/nocontact", data / "nocontact", dirs_exist_ok=True)
        done = make(project, f"DATASET={name}", *goals(name))
        assert done.returncode == 0, done.stdout
    return project


def goals(name):
    """What is made of a dataset: the one with images goes on to the card of the shipped network."""
    return ("dataset", "evaluate", "MODEL=shipped") if name == "bad_rows" else ("labels",)


def forces_of(project, name):
    """Status and total force (3,) N along the gel of each sample, in every shard."""
    found = {}
    for path in sorted((project / f"results/{name}/40_forces").glob("*.npz")):
        with ForceFile(path) as forces:
            for k, sample in enumerate(forces.sample_id):
                found[str(sample)] = str(forces.status[k]), forces.total[k], str(forces.press_id[k])
    return found


@pytest.mark.parametrize("name", NAMES)
def test_every_row_is_labelled_or_rejected_and_a_second_make_has_nothing_to_do(project, name):
    rows = read_csv(project / f"data/{name}/log.csv")
    results, forces = project / f"results/{name}", forces_of(project, name)
    rejected = {int(row["row"]) for path in (results / "10_poses").glob("*.rejected.csv") for row in read_csv(path)}
    good = [row["sample_id"] for number, row in enumerate(rows, start=2) if number not in rejected]
    assert sorted(forces) == sorted(good) and all(status == "OK" for status, *_ in forces.values())
    for path in (results / "50_labels/24x32").glob("0*.npz"):
        found = read_labels(path)
        for k, sample in enumerate(found.sample_id):
            total = forces[str(sample)][1]
            seen = found.label[k].astype(float).sum(axis=(1, 2)) + found.outside[k]
            assert seen == pytest.approx(total, abs=1e-6 * np.abs(total).sum())
    said = make(project, f"DATASET={name}", "-q", *goals(name))
    assert said.returncode == 0, said.stdout


def test_rows_are_rejected_by_number_and_column(project):
    paths = sorted((project / "results/bad_rows/10_poses").glob("*.rejected.csv"))
    found = [(row["row"], row["column"]) for path in paths for row in read_csv(path)]
    assert sorted(found) == [("3", "dz_mm"), ("4", "dz_mm"), ("5", "indenter"), ("6", "sample_id")]


def test_a_sensor_that_is_only_tested_is_in_no_other_split(project):
    rows = read_csv(project / "results/bad_rows/60_dataset/24x32/samples.csv")
    assert [row["sensor_id"] for row in rows if row["split"].startswith("test_unseen")] == ["mini_e"]
    assert len(rows) == 3 and (project / "results/bad_rows/60_dataset/24x32/images.npy").is_file()


def test_the_card_of_the_shipped_network_names_what_it_was_judged_on(project):
    card = (project / "results/bad_rows/80_evaluate/24x32/shipped.card.md").read_text(encoding="utf-8")
    assert "bad_rows" in card and "| " in card


def test_frames_of_a_press_are_moments_of_one_path(project):
    """The last on the way down is the press that was logged alone; a frame that goes back is none of it."""
    forces = forces_of(project, "frames")
    film = [forces[f"f{k}"] for k in range(5)]
    assert {press for *_, press in film} == {"film"} and "back" not in forces and forces["alone"][2] == ""
    assert (np.diff([-total[2] for _, total, _ in film[:4]]) > 0).all() and film[0][1][2] < 0
    alone = forces["alone"][1]
    np.testing.assert_allclose(film[3][1], alone, atol=0.02 * -alone[2])  # load steps are not the same
    dragged = film[4][1]
    assert 0.1 * -dragged[2] < dragged[0] < 1.1 * 0.2 * -dragged[2]  # along x, as far as friction holds


def test_a_thinner_gel_is_stiffer(project):
    forces = forces_of(project, "two_gels")
    assert forces["thin"][1][2] < 1.05 * forces["usual"][1][2] < 0
