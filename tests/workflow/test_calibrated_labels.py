"""Labels that follow their log's calibration in one make: calibrate, poses, solves, forces; `make freeze` holds it."""

import shutil

import numpy as np
import pytest

from gelforge.flow.calibration import read_found
from gelforge.records.forcefile import ForceFile
from tests.support.sandbox import CALIBRATED, link_project, make


@pytest.fixture
def project(root, tmp_path):
    """A sandbox with the four published presses of a ball, solved coarsely."""
    project = link_project(root, tmp_path / "project")
    data = project / "data" / "ball"
    data.mkdir(parents=True)
    shutil.copy(root / "data" / "feats_sphere15" / "log.csv", data)
    (data / "dataset.toml").write_text(CALIBRATED)
    return project


def say(project, *words):
    done = make(project, "DATASET=ball", *words)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.slow
def test_labels_follow_the_posterior_and_hold_still_once_it_is_frozen(project):
    frozen, forces = project / "data/ball/calibration.toml", project / "results/ball/40_forces/0000.npz"
    summary = project / "results/ball/calibrate/summary.json"
    said = say(project, "labels")
    assert "jobserver" not in said and said.count("10_poses/0000.csv") == 1 and not frozen.exists()
    found, label = read_found(summary), ForceFile(forces)
    assert len(found.presses) == 4 and label.c10 == found.params["material"]["c10"] != 0.0725
    assert label.intervals["c10_interval95"] == pytest.approx(found.params["material"]["c10_interval95"])
    # what was found is what the log says: labels meet the force sensor on coarse elements, too
    ratio = label.total[:, 2] / [-1.6503, -5.9641, -13.5257, -23.2532]
    assert np.all(np.abs(ratio - 1.0) < 0.15)
    # a shallower limit rejects a press: the posterior follows, and no goal but freeze writes into data/
    toml = project / "data/ball/dataset.toml"
    toml.write_text(CALIBRATED.replace("images = false", "images = false\ndeepest_share = 0.4"))
    say(project, "calibrate")
    assert len(read_found(summary).presses) == 3
    say(project, "freeze")
    held = frozen.read_text()
    assert read_found(frozen) == read_found(summary)
    toml.write_text(CALIBRATED)
    say(project, "labels")
    assert len(read_found(summary).presses) == 3  # labels do not need the posterior any more
    assert frozen.read_text() == held and ForceFile(forces).c10 == read_found(frozen).params["material"]["c10"]
    frozen.unlink()
    say(project, "labels")
    assert ForceFile(forces).c10 == label.c10
