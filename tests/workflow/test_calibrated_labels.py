"""Labels that follow their log's calibration in one make: calibrate, poses, solves, forces; `make freeze` holds it."""

import numpy as np
import pytest

from gelforge.flow.calibration import read_posterior, read_values
from gelforge.records.forcefile import ForceFile
from tests.support.sandbox import make

FORCES = "results/demo/40_forces/0000.npz"


def say(project, *words):
    done = make(project, *words)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.slow
def test_labels_follow_the_posterior_and_hold_still_once_it_is_frozen(calibrated):
    frozen, summary = calibrated / "data/demo/calibration.toml", calibrated / "results/demo/calibrate/summary.json"
    found, total = read_posterior(summary), []
    for path in sorted((calibrated / FORCES).parent.glob("*.npz")):
        label = ForceFile(path)
        assert label.c10 == found.params["material"]["c10"] != 0.0725
        assert label.intervals["c10_interval95"] == pytest.approx(found.params["material"]["c10_interval95"])
        total.append(label.total[0, 2])
    # what was found is what the log says: labels meet the force sensor on coarse elements, too
    assert len(found.presses) == 4 and np.all(
        np.abs(total / np.array([-1.6503, -5.9641, -13.5257, -23.2532]) - 1.0) < 0.15
    )
    # no goal but freeze writes into data/; a shallower limit rejects a press: the posterior follows
    assert not frozen.exists()
    toml = calibrated / "data/demo/dataset.toml"
    whole = toml.read_text()
    toml.write_text(whole.replace("images = false", "images = false\ndeepest_share = 0.4"))
    say(calibrated, "freeze")
    held = frozen.read_text()
    assert read_values(frozen) == read_posterior(summary) and len(read_posterior(summary).presses) == 3
    # labels do not need the posterior any more
    toml.write_text(whole)
    assert "calibrate/summary.json" not in say(calibrated, "-n", "labels")
    say(calibrated, FORCES)
    assert len(read_posterior(summary).presses) == 3 and frozen.read_text() == held
    assert ForceFile(calibrated / FORCES).c10 == read_values(frozen).params["material"]["c10"] != label.c10
    # without it they are due by the posterior of all presses again
    frozen.unlink()
    said = say(calibrated, "-n", "labels")
    assert "flow.step results/demo/calibrate/summary.json" in said and f"gelforge.flow.step {FORCES} " in said
