"""The calibration stage on the four real points, with a coarse mesh."""

import json
import shutil

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.stages import calibrate
from gelforge.stages.report import calibration_section
from tests.support.parameters import parameters, write_stage

SOLVER = {
    "size": 1.2,
    "layers": 3,
    "press_steps": 8,
    "shear_steps": 3,
    "final_tolerance": 1e-7,
}


def stage_args(root, folder, **changes):
    """Arguments of the stage in a folder of its own, and the parameters it gets."""
    usual = {"solver": SOLVER, "compare": False, "refine": "none", "friction_nodes": []}
    write_stage(folder, "calibrate", calibrate=usual | changes)
    if not (folder / "data").exists():
        shutil.copytree(root / "data" / "feats_sphere15", folder / "data")
    names = {"data": "data", "params": "calibrate.json", "work": "work", "out": "work/summary.json"}
    args = [text for key, name in names.items() for text in (f"--{key}", str(folder / name))]
    sensors = ["--sensors", str(root / "workflow" / "sensors.toml")]
    return [*args, *sensors, "--workflow", str(root / "workflow"), "--jobs", "1"]


@pytest.fixture(scope="module")
def done(root, tmp_path_factory):
    folder = tmp_path_factory.mktemp("feats")
    assert calibrate.main(stage_args(root, folder)) == 0
    return folder


def test_log_holds_the_measured_points(root, reference):
    measured = np.loadtxt(reference / "feats" / "force_depth_sphere15mm.csv", delimiter=",", skiprows=2)
    readings = calibrate.read_readings(root / "data" / "feats_sphere15" / "log.csv")
    np.testing.assert_allclose(readings.depth, measured[:, 0])
    np.testing.assert_allclose(readings.force[:, 2], -measured[:, 1])


def test_summary_says_what_is_known(done):
    summary = json.loads((done / "work" / "summary.json").read_text())
    low, high = summary["c10"]["interval95"]
    assert low < summary["c10"]["interval68"][0] < summary["c10"]["median"] < high
    assert 0.05 < summary["c10"]["median"] < 0.15  # soft silicone
    assert summary["solves_spent"]["total"] == 2
    figures = summary["diagnostics"]
    assert figures["taus"] >= 50 and figures["rhat"] < 1.01 and 0.15 <= figures["acceptance"] <= 0.6
    assert set(summary["parameters"]) == set(summary["correlations"]["names"])
    assert any("touch offset" in sentence for sentence in summary["sentences"])


def test_pictures_and_chain_are_there(done):
    work = done / "work"
    for name in ("corner", "predictive", "trace", "autocorrelation"):
        assert (work / f"{name}.png").stat().st_size > 10_000
    assert np.load(work / "chain.npz")["coordinates"].ndim == 3
    assert not list(work.glob(".*"))  # nothing half-written is left


def test_report_shows_parameters_models_and_what_they_mean(done, tmp_path):
    shutil.copytree(done / "work", tmp_path / "calibrate")
    section = calibration_section(tmp_path)
    parameters, models = (item for item in section.items if item["kind"] == "table")
    assert parameters["rows"][0][0] == "C10 (MPa)" and len({row[0] for row in parameters["rows"]}) == 7
    assert [row[0] for row in models["rows"]] == ["coulomb + offset + compliance"]
    texts = [item["text"] for item in section.items if item["kind"] == "text"]
    assert any("priors aside, come nearer than" in text for text in texts)


def test_both_predictive_means_and_the_least_error_are_reported(done):
    summary = json.loads((done / "work" / "summary.json").read_text())
    # its own error of touch explains part of a reading; three parameters cannot meet four such readings
    assert summary["own_touch_mae_n"]["fz"] < summary["predictive_mae_n"]["fz"]
    assert 0.0 < summary["least_mae_n"] < summary["predictive_mae_n"]["fz"]


def test_second_run_solves_and_samples_nothing_anew(root, done, capsys):
    before = (done / "work" / "summary.json").read_text()
    assert calibrate.main(stage_args(root, done)) == 0
    assert "0 of them new" in capsys.readouterr().out
    after = json.loads((done / "work" / "summary.json").read_text())
    assert after["c10"] == json.loads(before)["c10"]


def test_wrong_sign_leaves_no_summary(root, tmp_path):
    args = stage_args(root, tmp_path)
    log = tmp_path / "data" / "log.csv"
    log.write_text(
        log.read_text()
        .replace(",-1.6503", ",1.6503")
        .replace(",-5", ",5")
        .replace(",-13", ",13")
        .replace(",-23", ",23")
    )
    with pytest.raises(BadInput, match="opposite sign convention"):
        calibrate.main(args)
    assert not (tmp_path / "work" / "summary.json").exists()


def test_a_single_press_is_refused_before_anything_is_solved(root, tmp_path):
    args = stage_args(root, tmp_path)
    log = tmp_path / "data" / "log.csv"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:2]))
    with pytest.raises(BadInput, match="one force reading .* log two presses or more"):
        calibrate.main(args)
    assert not (tmp_path / "work").exists()


def test_unknown_solver_setting_is_named():
    with pytest.raises(BadInput, match=r"\[calibrate.solver\] sizes: unknown key; size is meant"):
        parameters(calibrate={"solver": {"sizes": 1.0}})
