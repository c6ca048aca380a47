"""A frozen calibration: a small file that labels follow, and the report's page of labels beside the force sensor."""

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import write_json
from gelforge.flow.params import FROZEN, frozen_of, load_params, read_frozen, write_frozen
from gelforge.flow.tables import MaterialTable
from gelforge.reporting.forcesensor import COMPARED, compare_forces, force_rows, force_sentences, spreads
from gelforge.stages.report import force_section
from tests.support.parameters import parameters, write_stage
from tests.support.refused import refused

SUMMARY = {
    "c10": {"median": 0.085349, "interval68": [0.0844, 0.0863], "interval95": [0.0835, 0.0871]},
    "bench": {"offset": -0.01789, "compliance": 0.006049, "shear_compliance": -0.0},
    "law": "coulomb", "used": ["a 1", 'b"2'],
    "parameters": {"noise": {"median": 0.04}, "scatter": {"median": 0.002}, "mu": {"median": 0.6849}},
}  # fmt: skip


def frozen(tmp_path, summary=SUMMARY):
    path = tmp_path / "lab" / FROZEN
    path.parent.mkdir(exist_ok=True)
    (path.parent / "dataset.toml").write_text('[params.interface]\nlaw = "coulomb"\n')
    write_frozen(path, frozen_of("lab", summary))
    return path


def test_what_is_frozen_is_rounded_and_read_back(root, tmp_path):
    """A posterior that another processor finds differs by less than the rounding: the same file, and no press solved again."""
    path = frozen(tmp_path)
    found, text = read_frozen(path), path.read_text()
    assert found.presses == ("a 1", 'b"2') and found.name.startswith("lab-")
    near = SUMMARY | {"c10": SUMMARY["c10"] | {"median": 0.08533}, "bench": SUMMARY["bench"] | {"offset": -0.01801}}
    frozen(tmp_path, near)
    assert path.read_text() == text
    params = load_params(root / "workflow", path.parent / "dataset.toml")
    assert params.material.c10 == 0.0853 and params.material.c10_interval95 == (0.0835, 0.0871)
    poses = params.poses
    assert (poses.touch_offset_mm, poses.compliance_mm_per_n) == (-0.018, 0.006)
    assert poses.shear_compliance_mm_per_n == 0.0 and "-0.0\n" not in text
    assert params.interface.mu == 0.68


@pytest.mark.parametrize("law", ["no_slip", "frictionless"])
def test_a_calibration_of_another_law_than_the_labels_is_refused(root, tmp_path, law):
    """C10 of Coulomb's law with labels that do not slip gave forces up to 12 % too large on a slippery gel."""
    own = frozen(tmp_path).parent / "dataset.toml"
    own.write_text(f'[params.interface]\nlaw = "{law}"\n')
    refused(
        rf'found under the law "coulomb", but \[interface\] law = "{law}".*calibrated-labels',
        load_params,
        root / "workflow",
        own,
    )
    own.write_text("")
    refused(r'found under the law "coulomb", but \[interface\] law = "no_slip"', load_params, root / "workflow", own)


def test_a_value_that_a_dataset_sets_too_is_refused(root, tmp_path):
    path = frozen(tmp_path)
    own = path.parent / "dataset.toml"
    own.write_text("[params.interface]\nlaw = 'coulomb'\n[params.poses]\ncompliance_mm_per_n = 0.01\n")
    with pytest.raises(BadInput, match=r"\[params.poses\] compliance_mm_per_n is also set by .*calibration.toml"):
        load_params(root / "workflow", own)


def test_a_file_that_is_none_is_refused_in_a_sentence(root, tmp_path):
    path = frozen(tmp_path)
    whole = path.read_text()
    for old, new, said in (
        ('name = "', "name = ", "not valid TOML: .*run make freeze"),
        ("law =", "laww =", "is not a frozen calibration"),
        ("c10 =", "nu =", "a key that calibration does not set"),
        ("c10 = 0.0853", "c10 = 85.3", "c10 = 85.3: give a number from"),
    ):
        path.write_text(whole.replace(old, new))
        refused(said, load_params, root / "workflow", path.parent / "dataset.toml")


def rows(sensor, label):
    return [{"id": f"s{i}", "indenter": "ball", "z0_mm": 0.0, "dz_mm": -1.0, "measured_fz": s, "label_fz": v, "outside_fz": 0.0}
            for i, (s, v) in enumerate(zip(sensor, label, strict=True))]  # fmt: skip


def of_calibration():
    material = MaterialTable(0.475, 0.0853, (0.0844, 0.0863), (0.0835, 0.0871))
    return spreads(material, SUMMARY, parameters().calibrate)


def test_presses_that_differ_by_what_is_uncertain_are_not_named_and_others_are():
    """Drawn from the very spreads that the page assumes: next to none beyond three deviations; a wrong one is named."""
    of, rng = of_calibration(), np.random.default_rng(3)
    sensor = -rng.uniform(1.0, 30.0, 400)
    sd = np.sqrt([p.variance for p in compare_forces(rows(sensor, sensor), of, set())])
    label = sensor + sd * rng.standard_normal(400)
    assert len(force_sentences(compare_forces(rows(sensor, label), of, set()))) - 1 <= 6
    label[7] = 1.4 * sensor[7]
    said = force_sentences(compare_forces(rows(sensor, label), of, set()))
    assert said[1].startswith("s7 (ball): the label says") and "standard deviations apart" in said[1]


def test_each_press_has_the_interval_of_c10_and_fractions_that_are_one():
    presses = compare_forces(rows([-4.0, -10.0], [-4.1, -9.9]), of_calibration(), {"s1"})
    assert [p.used for p in presses] == [False, True]
    for press, row in zip(presses, force_rows(presses), strict=True):
        assert press.low < press.label < press.high and row[4] == press.high
        assert press.high - press.low == pytest.approx(abs(press.label) * (0.0871 - 0.0835) / 0.0853)
        assert sum(float(text.rstrip("%")) for text in press.fractions()) == pytest.approx(100.0, abs=1.1)
    assert "1 presses above 2 N that the calibration did not use: median 1.025" in force_sentences(presses)[0]


def test_what_lies_outside_the_image_is_no_difference():
    """A force sensor feels the whole press, a label holds what the image shows of it."""
    whole, cut = rows([-35.04], [-34.9]), rows([-35.04], [-30.61])
    cut[0]["outside_fz"] = -4.29
    [one], [other] = (compare_forces(table, of_calibration(), set()) for table in (whole, cut))
    assert other.deviations == pytest.approx(one.deviations) and len(force_sentences([other])) == 1


def test_rows_without_a_label_or_a_reading_are_left_out():
    assert compare_forces([{"id": "row 3"}, *rows([np.nan, -1.0], [-1.0, np.nan])], of_calibration(), set()) == []


def test_the_report_says_what_labels_were_made_with(tmp_path):
    """Frozen or not, with a posterior or without: the page has a sentence, and a table of presses that have both forces."""
    path, results = frozen(tmp_path), tmp_path / "results" / "lab"
    frozen_params = {"c10": 0.0853, "c10_interval68": [0.0844, 0.0863], "c10_interval95": [0.0835, 0.0871]}
    write_stage(results / "00_plan" / "params", "forces", material=frozen_params)
    write_stage(results / "00_plan" / "params", "calibrate")
    own = rows([-4.0, -10.0], [-4.1, -9.9])
    section = force_section(results, path.parent, own)
    assert "calibration lab-" in section.items[0]["text"] and len(section.items[-1]["rows"]) == 2
    write_json(results / "calibrate" / "summary.json", SUMMARY)
    assert force_section(results, path.parent, own).items[-1]["columns"] == COMPARED
    path.unlink()
    write_stage(results / "00_plan" / "params", "forces")
    reported = force_section(results, path.parent, own).items[0]["text"]
    assert "No calibration was frozen" in reported and "make calibrated-labels DATASET=lab" in reported
    assert force_section(results, path.parent, []).items[0]["absent"]
