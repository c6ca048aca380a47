"""Stage 40: the material's C10."""

from gelforge.flow.tables import MaterialTable
from gelforge.stages.forces import material_c10


def test_c10_has_its_intervals_where_it_was_calibrated():
    assert material_c10(MaterialTable(0.475, 0.08)) == (0.08, {})
    found = MaterialTable(0.475, 0.08, (0.079, 0.081), (0.078, 0.082))
    assert material_c10(found) == (0.08, {"c10_interval68": [0.079, 0.081], "c10_interval95": [0.078, 0.082]})
