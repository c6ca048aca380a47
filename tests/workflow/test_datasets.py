"""The tiny datasets of tests/data, each from its log to what can be made of it by one make, and a second one that makes nothing."""

import shutil

import numpy as np
import pytest

from gelforge.flow.files import read_csv
from gelforge.records.forcefile import ForceFile
from gelforge.records.labelfile import read_labels
from tests.support.sandbox import link_project, make


@pytest.fixture
def project(root, tmp_path):
    return link_project(root, tmp_path / "project")


def made(root, project, name, *goals):
    """Make the goals of a dataset of tests/data; status, total force (3,) N along the gel and press of each sample.

    Every row is labelled or rejected, and nothing is left to do.
    """
    data = shutil.copytree(root / "tests/data" / name, project / "data" / name)
    rows = read_csv(data / "log.csv")
    for row in rows:
        if row["image"]:  # those of the demo
            (data / row["image"]).parent.mkdir(exist_ok=True)
            shutil.copy(root / "data/demo" / row["image"], data / row["image"])
            shutil.copytree(root / "data/demo/nocontact", data / "nocontact", dirs_exist_ok=True)
    done = make(project, f"DATASET={name}", *goals)
    assert done.returncode == 0, done.stdout
    results, forces = project / "results" / name, {}
    for path in sorted((results / "40_forces").glob("*.npz")):
        with ForceFile(path) as found:
            for k, sample in enumerate(found.sample_id):
                forces[str(sample)] = str(found.status[k]), found.total[k], str(found.press_id[k])
    rejected = {int(row["row"]) for path in (results / "10_poses").glob("*.rejected.csv") for row in read_csv(path)}
    good = [row["sample_id"] for number, row in enumerate(rows, start=2) if number not in rejected]
    assert sorted(forces) == sorted(good) and all(status == "OK" for status, *_ in forces.values())
    for path in (results / "50_labels/24x32").glob("0*.npz"):
        found = read_labels(path)
        for k, sample in enumerate(found.sample_id):
            total = forces[str(sample)][1]
            seen = found.label[k].astype(float).sum(axis=(1, 2)) + found.outside[k]
            assert seen == pytest.approx(total, abs=1e-6 * np.abs(total).sum())
    said = make(project, f"DATASET={name}", "-q", *goals)
    assert said.returncode == 0, said.stdout
    return forces


@pytest.mark.slow
def test_bad_rows_are_named_and_the_others_go_on_to_the_card_of_the_shipped_network(root, project):
    made(root, project, "bad_rows", "dataset", "evaluate", "MODEL=shipped")
    results = project / "results/bad_rows"
    found = [
        (row["row"], row["column"])
        for path in (results / "10_poses").glob("*.rejected.csv")
        for row in read_csv(path)
    ]
    assert sorted(found) == [("3", "dz_mm"), ("4", "dz_mm"), ("5", "indenter"), ("6", "sample_id")]
    # a sensor that is only tested is in no other split
    rows = read_csv(results / "60_dataset/24x32/samples.csv")
    assert [row["sensor_id"] for row in rows if row["split"].startswith("test_unseen")] == ["mini_e"]
    assert len(rows) == 3 and (results / "60_dataset/24x32/images.npy").is_file()
    card = (results / "80_evaluate/24x32/shipped.card.md").read_text(encoding="utf-8")
    assert "bad_rows" in card and "| " in card


@pytest.mark.slow
def test_frames_of_a_press_are_moments_of_one_path_and_a_thinner_gel_is_stiffer(root, project):
    """The last on the way down is the press that was logged alone; a frame that goes back is none of it."""
    forces = made(root, project, "frames", "labels")
    film = [forces[f"f{k}"] for k in range(4)]
    assert {press for *_, press in film} == {"film"} and "back" not in forces and forces["alone"][2] == ""
    assert (np.diff([-total[2] for _, total, _ in film[:3]]) > 0).all() and film[0][1][2] < 0
    alone = forces["alone"][1]
    np.testing.assert_allclose(film[2][1], alone, atol=0.02 * -alone[2])  # load steps are not the same
    dragged = film[3][1]
    assert 0.1 * -dragged[2] < dragged[0] < 1.1 * 0.2 * -dragged[2]  # along x, as far as friction holds
    assert forces["thin"][1][2] < 1.05 * alone[2] < 0
