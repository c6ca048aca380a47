"""Labels against a force sensor: what of their difference is expected, by hand."""

import pytest

from gelforge.reporting.forcesensor import STEEPEST, Spreads, compare_forces

OF = Spreads(c10=0.02, low=0.95, high=1.06, mesh=0.01, noise=0.05, touch=0.01)


def test_a_difference_is_judged_by_noise_touch_stiffness_and_mesh():
    """The label with what lies outside the image; the steeper a press, the more an error of touch weighs."""
    row = {
        "id": "a",
        "indenter": "ball",
        "label_fz": -9.5,
        "outside_fz": -0.7,
        "measured_fz": -10.0,
        "z0_mm": 0.0,
        "dz_mm": -0.5,
    }
    (found,) = compare_forces([row, row | {"measured_fz": None}, row | {"label_fz": None}], OF, {"a"})
    assert found.label == pytest.approx(-10.2) and found.used
    assert [found.low, found.high] == pytest.approx([-10.2 * 1.06, -10.2 * 0.95])
    bench = 0.05**2 + (STEEPEST * 10.0 / 0.5 * 0.01) ** 2
    assert [found.bench, found.material, found.mesh] == pytest.approx([bench, 0.2**2, 0.1**2])
    assert found.deviations == pytest.approx(-0.2 / (bench + 0.05) ** 0.5) and found.ratio == pytest.approx(1.02)
