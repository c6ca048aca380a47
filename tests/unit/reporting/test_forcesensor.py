"""Labels against a force sensor: what of their difference is expected, by hand."""

import pytest

from gelforge.reporting.forcesensor import PARTS, STEEPEST, Spreads, compare_forces, force_rows

OF = Spreads(c10=0.02, low=0.95, high=1.06, mesh=0.01, noise=0.05, touch=0.01, seating=0.1, tilt={"block": 0.03})


def test_a_difference_is_judged_by_all_that_contributes_to_it():
    """The label with what lies outside the image; the steeper a press, the more an error of touch weighs. A ball does not
    feel tilt, and an error of friction changes the normal force by its part of the total one."""
    row = {
        "id": "a",
        "indenter": "ball",
        "label_fx": 7.65,
        "label_fz": -9.5,
        "outside_fz": -0.7,
        "measured_fz": -10.0,
        "z0_mm": 0.0,
        "dz_mm": -0.5,
        "friction_error_n": 0.25,
    }
    block = row | {"id": "b", "indenter": "block"}
    found, other = compare_forces([row, row | {"measured_fz": None}, row | {"label_fz": None}, block], OF, {"a"})
    assert found.label == pytest.approx(-10.2) and found.used and not other.used
    assert [found.low, found.high] == pytest.approx([-10.2 * 1.06, -10.2 * 0.95])
    total = (7.65**2 + 9.5**2) ** 0.5
    errors = {"sensor": 0.05, "mesh": 0.1, "material": 0.2, "friction": 0.25 * 10.2 / total, "tilt": 0.0, "seating": 1.0,
              "zero": STEEPEST * 10.0 / 0.5 * 0.01}  # fmt: skip
    assert found.parts == pytest.approx({name: errors[name] ** 2 for name in PARTS}, rel=1e-9)
    assert other.parts == pytest.approx({**found.parts, "tilt": 0.3**2})
    variance = sum(error**2 for error in errors.values())
    assert found.deviations == pytest.approx(-0.2 / variance**0.5) and found.ratio == pytest.approx(1.02)
    assert force_rows([found])[0][8:-1] == [f"{found.parts[name] / variance:.0%}" for name in PARTS]
