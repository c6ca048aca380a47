"""make sample and make look, one after the other as a person types them; frames of a press through the whole flow."""

import numpy as np
import pytest

from gelforge.flow.files import read_csv, write_csv, write_json
from gelforge.records.forcefile import ForceFile
from tests.support.sandbox import make


def say(project, *words):
    done = make(project, "DATASET=tiny", *words)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.slow
def test_look_finds_what_sample_made_and_a_calibration_scales_it(whole):
    """Its solve is in the store; nothing of the dataset is made."""
    project = whole
    first = read_csv(project / "data/tiny/log.csv")[0]["sample_id"]
    assert "has no label at 24x32 yet" in make(project, "DATASET=tiny", "look", f"ID={first}").stdout
    assert f"all files of {first} are in" in say(project, "sample", f"ID={first}")
    say(project, "look", f"ID={first}")
    scaled_by_the_calibrated_material(project, first)
    made = {path.name for path in (project / "results/tiny/look").iterdir()}
    assert made == {f"{first}-24x32.png", f"{first}-indenter.stl", f"{first}.vtu"}
    assert not (project / "results/tiny/50_labels/24x32").exists()


def scaled_by_the_calibrated_material(project, first):
    """What was made, made again with [material] c10 = "calibrated"."""
    sample = project / f"results/tiny/samples/{first}/40_forces/0000.npz"
    plain = ForceFile(sample).force
    toml = project / "data/tiny/dataset.toml"
    toml.write_text(toml.read_text() + '\n[params.material]\nc10 = "calibrated"\n')
    assert (
        "calibrate/summary.json" in make(project, "-n", "DATASET=tiny", "sample", f"ID={first}").stdout
    )  # made first
    summary = {"c10": {"median": 0.145, "interval68": [0.14, 0.15], "interval95": [0.13, 0.16]}, "parameters": {},
               "bench": {"offset": 0.0, "compliance": 0.0, "shear_compliance": 0.0, "mountings": {"": {"offset": 0.0}}, "stated_tilt_deg": {}}, "law": "no_slip", "used": []}  # fmt: skip
    write_json(project / "results/tiny/calibrate/summary.json", summary)
    say(project, "sample", f"ID={first}")
    np.testing.assert_allclose(ForceFile(sample).force, 2.0 * plain, rtol=1e-6)


def test_a_sample_that_stage_10_rejects_says_why(project):
    log = project / "data/tiny/log.csv"
    rows = read_csv(log)
    rows[1]["dz_mm"] = "deep"
    write_csv(log, list(rows[0]), rows)
    done = make(project, "DATASET=tiny", "sample", f"ID={rows[1]['sample_id']}")
    assert done.returncode != 0
    assert "not a finite number" in done.stdout and "was rejected, see above" in done.stdout


@pytest.mark.slow
def test_a_row_that_fills_up_a_labelled_shard_is_looked_at_alone(whole):
    log = whole / "data/tiny/log.csv"
    rows = read_csv(log)
    write_csv(log, list(rows[0]), rows[:-1])
    say(whole, "labels", "RES=6x8")
    write_csv(log, list(rows[0]), rows)
    new = rows[-1]["sample_id"]
    say(whole, "sample", f"ID={new}", "RES=6x8")
    say(whole, "look", f"ID={new}", "RES=6x8")
    assert (whole / f"results/tiny/look/{new}-6x8.png").exists()
