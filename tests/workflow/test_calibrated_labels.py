"""make calibrated-labels: calibrates, freezes what it found, and labels with it; afterwards only make freeze changes it."""

import shutil

import numpy as np
import pytest

from gelforge.flow.files import read_json, write_json
from gelforge.flow.params import read_frozen
from gelforge.records.forcefile import ForceFile
from tests.support.sandbox import link_project, make

SETTINGS = """
sensor = "gelsight_mini"
gel = "gelsight_mini"
[params.poses]
images = false
[params.fea]
method = "draft"
tolerance = 0.2
[params.calibrate]
refine = "none"
[params.calibrate.solver]
size = 1.2
layers = 3
widened = []
press_steps = 8
"""


@pytest.fixture
def project(root, tmp_path):
    """A sandbox with the four published presses of a ball, solved coarsely."""
    project = link_project(root, tmp_path / "project")
    data = project / "data" / "ball"
    data.mkdir(parents=True)
    shutil.copy(root / "data" / "feats_sphere15" / "log.csv", data)
    (data / "dataset.toml").write_text(SETTINGS)
    return project


def say(project, *words):
    done = make(project, "DATASET=ball", *words)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.slow
def test_labels_follow_the_calibration_and_only_freezing_changes_it(project):
    frozen, forces = project / "data/ball/calibration.toml", project / "results/ball/40_forces/0000.npz"
    summary = project / "results/ball/calibrate/summary.json"
    say(project, "calibrated-labels")
    found, label = read_frozen(frozen), ForceFile(forces)
    assert len(found.presses) == 4 and label.c10 == found.params["material"]["c10"] != 0.0725
    assert label.intervals["c10_interval95"] == pytest.approx(found.params["material"]["c10_interval95"])
    # what was found is what the log says: labels meet the force sensor on coarse elements, too
    ratio = label.total[:, 2] / [-1.6503, -5.9641, -13.5257, -23.2532]
    assert np.all(np.abs(ratio - 1.0) < 0.15)
    # poses that it moved make the posterior no other; one that is other changes no label
    text, before = frozen.read_text(), forces.stat().st_mtime_ns
    posterior = summary.stat().st_mtime_ns
    say(project, "calibrate", "calibrated-labels")
    assert summary.stat().st_mtime_ns == posterior
    reported = read_json(summary)
    write_json(summary, reported | {"c10": reported["c10"] | {"median": 0.05}})
    say(project, "calibrated-labels")
    assert frozen.read_text() == text and forces.stat().st_mtime_ns == before
    say(project, "freeze")
    assert read_frozen(frozen).params["material"]["c10"] == 0.05
    say(project, "calibrated-labels")
    assert ForceFile(forces).c10 == 0.05
