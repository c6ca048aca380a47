"""The calibration stage on curves that others measured: the four points of FEATS, and a small ball on a thin pad."""

import re
import shutil

import numpy as np
import pytest

from gelforge.calibration.readings import read_readings
from gelforge.errors import BadInput
from gelforge.flow.files import read_json, read_toml, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import read_dataset_file, read_indenter_tables
from gelforge.records.press import COLUMNS
from gelforge.stages import calibrate, plots
from gelforge.stages.plan import logged_rows, write_shards
from gelforge.stages.report import calibration_section
from tests.support.parameters import parameters, place_workflow, write_stage

COARSE = {"size": 1.2, "layers": 3, "widened": []}
# A ball of 4 mm diameter pressed into the flat gel, 2 mm thick, of another type of sensor (DIGIT): depth, mm, and force, N.
BALL_ON_PAD = ((0.344, 0.236), (0.468, 0.500), (0.782, 1.495), (1.215, 3.895), (1.461, 6.290))


def prepared(root, folder, law="no_slip", **changes):
    """The stage's dataset in a folder of its own, with the parameters that it gets; its layout."""
    of = Layout(place_workflow(folder) / "results/lab")
    usual = {"solver": COARSE, "refine": "none"}
    write_stage(of.params, "calibrate", calibrate=usual | changes, interface={"law": law})
    write_json(of.parameters("sensors"), read_toml(root / "workflow/sensors.toml"))
    if not of.data.exists():
        shutil.copytree(root / "data" / "feats_sphere15", of.data)
    return planned(of)


def planned(of):
    """That layout with the log's rows and the indenters that they name, as the plan writes them."""
    about = read_dataset_file(of.data / "dataset.toml")
    write_json(of.parameters("indenters"), read_indenter_tables(of.workflow, of.data, about.catalogue))
    write_shards(of, logged_rows(of.log, about.sensor), 8, {})
    return of


@pytest.fixture(scope="module")
def done(root, tmp_path_factory):
    of = prepared(root, tmp_path_factory.mktemp("feats"))
    assert calibrate.main([str(of.root)]) == 0
    return of


def test_log_holds_the_measured_points(root, reference):
    measured = np.loadtxt(reference / "feats" / "force_depth_sphere15mm.csv", delimiter=",", skiprows=2)
    readings = read_readings(root / "data" / "feats_sphere15" / "log.csv")
    np.testing.assert_allclose(readings.depth, measured[:, 0])
    np.testing.assert_allclose(readings.force[:, 2], -measured[:, 1])


@pytest.mark.slow
def test_summary_and_report_say_what_is_known(done, tmp_path):
    summary = read_json(done.calibration())
    low, high = summary["c10"]["interval95"]
    assert low < summary["c10"]["interval68"][0] < summary["c10"]["median"] < high
    assert 0.05 < summary["c10"]["median"] < 0.15  # soft silicone
    assert summary["solves_spent"]["total"] == 1
    figures = summary["diagnostics"]
    assert figures["taus"] >= 25 and figures["rhat"] < 1.04
    assert set(summary["parameters"]) == set(summary["correlations"]["names"])
    assert summary["evidence"] == []
    assert 0.0 < summary["left_out_mae_n"]["fz"] < 2.0
    assert plots.main([str(done.root)]) == 0
    captions = read_json(done.plots())
    assert captions and all((done.folder("calibrate") / name).stat().st_size > 10_000 for name in captions)
    assert not list(done.folder("calibrate").glob(".*"))  # nothing half-written is left
    section = calibration_section(done.root)
    assert [item["caption"] for item in section.items if item["kind"] == "picture"] == list(captions.values())
    (table,) = (item for item in section.items if item["kind"] == "table")
    assert table["rows"][0][0] == "C10 (MPa)" and len({row[0] for row in table["rows"]}) == 7
    assert set(summary["sentences"]) <= {item["text"] for item in section.items if item["kind"] == "text"}


@pytest.mark.slow
def test_second_run_solves_nothing_anew_and_says_what_it_sees(done, tmp_path, capsys):
    again = Layout(shutil.copytree(done.root.parent.parent, tmp_path / "again") / "results/lab")
    log = again.log
    weighed = [line.split(",") for line in log.read_text().splitlines()]
    for line in weighed[1:]:
        line[14] = f"{float(line[14]) / 4.44822:.4f}"
    assert weighed[0][14] == "fz_n"
    log.write_text("\n".join(",".join(line) for line in weighed) + "\n")
    planned(again)
    assert calibrate.main([str(again.root)]) == 0
    (said,), out = read_json(again.calibration())["evidence"], capsys.readouterr().out
    assert "0 of them new" in out and "pounds-force" in said and f"note: {said}" in out.splitlines()


@pytest.mark.slow
def test_a_calibration_follows_a_ball_on_a_thin_pad_that_others_measured(root, tmp_path):
    """Each press that is left out is predicted, with a touch offset and a compliance that a hand-held bench may have.

    Under Coulomb's law; without slip: tests/physics/test_published_curve.py.
    """
    data = tmp_path / "data/lab"
    data.mkdir(parents=True)
    header = ",".join(COLUMNS)
    rows = [f"p{k},,digit,,ball,0,0,0,0,0,-{depth},0,,,-{force},,,," for k, (depth, force) in enumerate(BALL_ON_PAD)]
    (data / "log.csv").write_text("\n".join([header, *rows]) + "\n")
    (data / "dataset.toml").write_text('sensor = "digit"\ngel = "flat_2mm"\n')
    (data / "indenters.toml").write_text('[ball]\nkind = "sphere"\ndiameter = 4.0\nheight = 4.0\n')
    sensors = data / "sensors.toml"
    sensors.write_text(
        '[digit]\ngel = "flat_2mm"\nimage = [240, 320]\nprojection = [[0.0, -15.0, 120.0], [-15.0, 0.0, 160.0], [0.0, 0.0, 1.0]]\n'
    )
    of = prepared(root, tmp_path, "coulomb", refine="draft", solver={"size": 0.5})
    write_json(of.parameters("sensors"), read_toml(sensors))
    assert calibrate.main([str(of.root)]) == 0
    summary = read_json(of.calibration())
    assert 0.06 < summary["c10"]["median"] < 0.11 and summary["evidence"] == []
    assert summary["law"] == "coulomb" and "mu" in summary["parameters"]
    # the most and the least deep of five presses are predicted beyond the others
    assert summary["left_out_mae_n"]["fz"] < 0.15 * np.mean([force for _, force in BALL_ON_PAD])


def test_a_wrong_log_says_why_in_its_summary_and_solves_nothing(root, tmp_path, capsys):
    of = prepared(root, tmp_path)
    log = of.log
    whole = log.read_text()
    for text, said in (
        (whole.replace(",-1.6503", ",1.6503").replace(",-5", ",5").replace(",-13", ",13").replace(",-23", ",23"),
         "opposite sign convention"),
        ("".join(whole.splitlines(keepends=True)[:2]), "one force reading .* log two presses or more"),
    ):  # fmt: skip
        log.write_text(text)
        assert calibrate.main([str(planned(of).root)]) == 0
        failed = read_json(of.calibration())["failed"]
        assert re.search(said, failed) and f"note: no calibration: {failed}" in capsys.readouterr().out
        section = calibration_section(of.root)
        assert section.items[0]["absent"] and failed in section.items[0]["text"]
        assert not of.solves.exists()
    with pytest.raises(BadInput, match=r"\[calibrate.solver\] sizes: unknown key; did you mean size"):
        parameters(calibrate={"solver": {"sizes": 1.0}})
