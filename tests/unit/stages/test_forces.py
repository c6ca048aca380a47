"""Stage 40: the material's C10."""

import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import write_json
from gelforge.flow.tables import MaterialTable
from gelforge.stages.forces import material_c10

CALIBRATED = MaterialTable(0.475, "calibrated")


def test_c10_from_a_number_or_a_calibration(tmp_path):
    assert material_c10(MaterialTable(0.475, 0.08), tmp_path / "none.json") == (0.08, {})
    frozen = MaterialTable(0.475, 0.08, (0.079, 0.081), (0.078, 0.082))
    assert material_c10(frozen, tmp_path / "none.json")[1] == {
        "c10_interval68": [0.079, 0.081],
        "c10_interval95": [0.078, 0.082],
    }
    path = tmp_path / "summary.json"
    write_json(path, {"c10": {"median": 0.081, "interval68": [0.08, 0.082], "interval95": [0.07, 0.09]}})
    c10, intervals = material_c10(CALIBRATED, path)
    assert c10 == 0.081 and intervals["c10_interval95"] == [0.07, 0.09]


def test_calibration_that_is_missing_or_broken_is_refused(tmp_path):
    with pytest.raises(BadInput, match="make calibrate DATASET=mine"):
        material_c10(CALIBRATED, tmp_path / "results/mine/calibrate/summary.json")
    write_json(tmp_path / "summary.json", {"c10": {"mean": 1}})
    with pytest.raises(BadInput, match="make calibrate"):
        material_c10(CALIBRATED, tmp_path / "summary.json")
