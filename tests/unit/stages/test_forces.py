"""Stage 40: the material's C10, and what counts as contact and as balance."""

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import write_json
from gelforge.flow.tables import MaterialTable
from gelforge.geometry.gel import GELS
from gelforge.records.status import Status
from gelforge.stages.forces import dat_forces, material_c10
from tests.support.blocks import symmetric_block

MESH = symmetric_block(GELS["gelsight_mini"], 6.0, 1)


def table(quantity, name, nodes, values):
    head = f"\n {quantity} for set {name} and time  0.1000000E+01\n\n"
    return head + "".join(
        f"{n:10d} {v[0]:13.6E} {v[1]:13.6E} {v[2]:13.6E}\n" for n, v in zip(nodes, values, strict=True)
    )


def text(push, base_error=0.0):
    top, base = MESH.surface_nodes + 1, MESH.base + 1
    forces = np.full((len(top), 3), 1e-9)
    forces[3] = push
    reaction = np.zeros((len(base), 3))
    reaction[0] = -np.asarray(push) * (1 + base_error)
    return (
        table("displacements (vx,vy,vz)", "NTOP", top, 0.1 * np.ones((len(top), 3)))
        + table("forces (fx,fy,fz)", "NTOP", top, forces)
        + table("forces (fx,fy,fz)", "NBASE", base, reaction)
    )


def test_residual_is_not_contact():
    status, _, forces, displacement = dat_forces(text([0.5, 0.0, -4.0]), MESH, 1e-6)
    assert status is Status.OK
    assert np.flatnonzero(forces.any(axis=1)).tolist() == [3]
    assert displacement.shape == forces.shape


def test_imbalance_is_no_result():
    status, reason, forces, _ = dat_forces(text([0.5, 0.0, -4.0], 1e-5), MESH, 1e-6)
    assert status is Status.UNBALANCED and "1e-05" in reason and not len(forces)


def test_corrupt_output_is_no_result():
    whole = text([0.5, 0.0, -4.0])
    for corrupt in ("", whole[:-30], whole.replace("-4.000000E+00", "NaN")):
        assert dat_forces(corrupt, MESH, 1e-6)[0] is Status.UNREADABLE


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
