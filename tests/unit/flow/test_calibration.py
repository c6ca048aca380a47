"""A calibration that labels follow, frozen or not, and the report's page of labels beside the force sensor."""

import pytest

from gelforge.commands import freeze
from gelforge.flow.calibration import (
    FROZEN,
    calibrated,
    calibration_of,
    found_in,
    read_posterior,
    read_values,
    refuse_twice,
    write_values,
)
from gelforge.flow.files import read_json, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import load_params, read_dataset_file, read_parameters
from gelforge.reporting.forcesensor import COMPARED
from gelforge.stages.report import force_section
from tests.support.parameters import write_stage
from tests.support.refused import refused

SUMMARY = {
    "c10": {"median": 0.085349, "interval68": [0.0844, 0.0863], "interval95": [0.0835, 0.0871]},
    "bench": {"offset": -0.01789, "compliance": 0.006049, "shear_compliance": -0.0, "mountings": {"": {"offset": -0.01789}}, "stated_tilt_deg": {}},
    "law": "coulomb", "used": ["a 1", 'b"2'],
    "parameters": {"noise": {"median": 0.04}, "scatter": {"median": 0.002}, "mu": {"median": 0.6849, "interval68": [0.64, 0.74], "interval95": [0.612, 0.791]}},
}  # fmt: skip


def frozen(tmp_path, summary=SUMMARY):
    path = tmp_path / "data/lab" / FROZEN
    path.parent.mkdir(parents=True, exist_ok=True)
    (path.parent / "dataset.toml").write_text('[params.interface]\nlaw = "coulomb"\n')
    write_values(path, found_in("lab", summary))
    return path


def followed(root, toml):
    """The calibration that labels of a dataset follow."""
    params = load_params(root / "workflow", toml)
    found = calibration_of(params, toml, toml.parents[2] / "results/lab/calibrate/summary.json")
    refuse_twice(read_dataset_file(toml).params, toml, found)
    return found


def test_what_is_frozen_is_rounded_and_read_back(root, tmp_path):
    """A posterior that another processor finds differs by less than the rounding: the same file, and no press solved again."""
    path = frozen(tmp_path)
    found, text = read_values(path), path.read_text()
    assert found.presses == ("a 1", 'b"2') and found.name.startswith("lab-")
    near = SUMMARY | {"c10": SUMMARY["c10"] | {"median": 0.08533}, "bench": SUMMARY["bench"] | {"offset": -0.01801}}
    frozen(tmp_path, near)
    assert path.read_text() == text and "-0.0\n" not in text
    assert followed(root, path.parent / "dataset.toml") == path


def stage_with(tmp_path, stage, calibration, **tables):
    """Parameters of a stage that follows a calibration, as it reads them."""
    write_stage(tmp_path, stage, **tables)
    read = read_json(tmp_path / f"{stage}.json") | {"calibration": calibration}
    write_json(tmp_path / f"{stage}.json", read)
    return calibrated(read_parameters(tmp_path / f"{stage}.json"), tmp_path)


def test_stages_follow_a_posterior_as_they_follow_what_was_frozen_from_it(tmp_path):
    frozen(tmp_path)
    of = Layout(tmp_path / "results/lab")
    write_json(of.calibration(), SUMMARY)
    freeze.main(["follow", str(of.root)])
    held = of.followed().read_bytes()
    (of.data / FROZEN).unlink()
    freeze.main(["follow", str(of.root)])
    assert of.followed().read_bytes() == held
    freeze.main(["keep", str(of.root)])
    assert (of.data / FROZEN).read_bytes() == held
    for path in ("data/lab/calibration.toml", "results/lab/calibrate/followed.toml"):
        material = stage_with(tmp_path, "forces", path, material={"c10": "calibrated"}).material
        assert material.c10 == 0.0853 and material.c10_interval95 == (0.0835, 0.0871) and material.nu == 0.475
        poses = stage_with(tmp_path, "poses", path).poses
        assert (poses.touch_offset_mm, poses.compliance_mm_per_n) == (-0.018, 0.006)
        assert poses.shear_compliance_mm_per_n == 0.0 and poses.images
        assert stage_with(tmp_path, "fea", path, interface={"law": "coulomb", "mu": 2.0}).interface.mu == 0.68
    assert stage_with(tmp_path, "fea", "", interface={"law": "coulomb", "mu": 2.0}).interface.mu == 2.0


def test_a_posterior_that_is_none_stops_what_follows_it(tmp_path):
    path = tmp_path / "results/lab/calibrate/summary.json"
    refused("is missing, and labels follow it; run `make calibrate DATASET=lab`", read_posterior, path)
    write_json(path, {"failed": "R-hat 1.033; log more presses"})
    refused("follow failed: R-hat 1.033; log more presses; correct that", read_posterior, path)
    for text in ("{}", "[]", "{"):
        path.write_text(text)
        refused("is not the summary of a calibration", read_posterior, path)


@pytest.mark.parametrize("law", ["no_slip", "frictionless"])
def test_a_calibration_of_another_law_than_the_labels_is_refused(root, tmp_path, law):
    """C10 of Coulomb's law with labels that do not slip gave forces up to 12 % too large on a slippery gel."""
    own = frozen(tmp_path).parent / "dataset.toml"
    own.write_text(f'[params.interface]\nlaw = "{law}"\n')
    refused(rf'found under the law "coulomb", but \[interface\] law = "{law}".*make calibrate', followed, root, own)


def test_a_value_that_a_dataset_sets_too_is_refused(root, tmp_path):
    path = frozen(tmp_path)
    own = path.parent / "dataset.toml"
    law = "[params.interface]\nlaw = 'coulomb'\n"
    own.write_text(law + "[params.poses]\ncompliance_mm_per_n = 0.01\n")
    refused(r"\[params.poses\] compliance_mm_per_n is also set by .*calibration.toml", followed, root, own)
    own.write_text(law + "[params.material]\nc10 = 0.08\n")
    refused(r"\[params.material\] c10 is also set by .*calibration.toml", followed, root, own)
    own.write_text(law + "[params.material]\nc10 = 'calibrated'\n")
    assert followed(root, own) == path
    path.unlink()
    assert followed(root, own) == tmp_path / "results/lab/calibrate/summary.json"
    own.write_text(law)
    assert followed(root, own) is None


def test_a_file_that_is_none_is_refused_in_a_sentence(root, tmp_path):
    path = frozen(tmp_path)
    whole = path.read_text()
    for old, new, said in (
        ('name = "', "name = ", "not valid TOML: .*run make freeze"),
        ("law =", "laww =", "is not a calibration"),
        ("c10 =", "nu =", "a key that calibration does not set"),
        ("c10 = 0.0853", "c10 = 85.3", "c10 = 85.3: give a number from"),
    ):
        path.write_text(whole.replace(old, new))
        refused(said, followed, root, path.parent / "dataset.toml")


def rows(sensor, label):
    return [{"id": f"s{i}", "indenter": "ball", "z0_mm": 0.0, "dz_mm": -1.0, "measured_fz": s, "label_fz": v, "outside_fz": 0.0}
            for i, (s, v) in enumerate(zip(sensor, label, strict=True))]  # fmt: skip


def test_the_report_says_what_labels_were_made_with_and_what_they_do_not_follow(tmp_path):
    """Of a frozen calibration, of a posterior, of none: the page has a sentence, and a table of presses with both forces."""
    frozen(tmp_path)
    results, own = tmp_path / "results" / "lab", rows([-4.0, -10.0], [-4.1, -9.9])
    params = results / "00_plan" / "params"
    for stage in ("calibrate", "poses", "fea"):
        write_stage(params, stage)
    write_json(results / "calibrate" / "summary.json", SUMMARY)
    for path in ("data/lab/calibration.toml", "results/lab/calibrate/summary.json"):
        freeze.main(["follow", str(results)])
        write_stage(params, "forces", material={"c10": "calibrated"})
        write_json(
            params / "forces.json",
            read_json(params / "forces.json") | {"calibration": "results/lab/calibrate/followed.toml"},
        )
        section, common = force_section(results, own)
        (tmp_path / "data/lab" / FROZEN).unlink(missing_ok=True)
        assert f"Labels follow {path}: lab-" in section.items[0]["text"] and not common
        assert section.items[-1]["columns"] == COMPARED and len(section.items[-1]["rows"]) == 2
    write_stage(params, "forces")
    section, (common,) = force_section(results, rows([-4.7, -11.8], [-4.0, -10.0]))
    assert "Labels follow no calibration" in section.items[0]["text"] and section.items[1]["text"] == common
    assert (
        common.startswith("C10 (MPa): labels assume 0.0725, the calibration finds 0.0853")
        and "explains 100% of the squared" in common
    )
    section, common = force_section(results, [])
    assert section.items[0]["absent"] and not common
