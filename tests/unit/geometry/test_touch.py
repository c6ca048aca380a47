"""When an indenter first meets the gel, where contact ends, and how wide a figure on a grid is."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.geometry.touch import (
    PRESSED,
    SECTION,
    SIDE_HALVINGS,
    TOUCH_STEP,
    WITHIN,
    begins_inside,
    first_touch,
    gap,
    nearest,
    sides,
    under_path,
    width_of,
)
from gelforge.records.press import Press
from tests.support.known_scenes import pad

GEL = Gel()
BODIES = [
    build("ball", {"kind": "sphere", "diameter": 8, "height": 6}),
    build("block", {"kind": "cuboid", "size": [6, 4], "fillet": 0.4, "height": 6}),
    build("slope", {"kind": "sloping_cuboid", "size": [6, 6], "slope_deg": 8, "fillet": 0.4, "height": 6}),
]


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
@pytest.mark.parametrize("press", [
    Press(0.0, 0.0, 1.0, 0.0, 0.0, -2.0), Press(5.0, -6.0, 0.5, 0.0, 0.0, -1.5, 33.0), Press(2.0, 3.0, 0.2, 1.5, -1.0, -0.15, 80.0),
])  # fmt: skip
def test_first_touch_is_where_a_step_by_step_descent_meets_the_gel(body, press):
    """Within a two-hundredth of the path, by the least gap of all points of the surface at each."""
    points, _ = under_path(GEL, body, press, TOUCH_STEP)
    steps = np.linspace(0.0, press.end, int(200 * press.end) + 1)
    met = [step for step in steps if gap(body, press, points, step).min() < 0.0]
    found = first_touch(GEL, body, press)
    if met:
        assert met[0] - 5.01e-3 < found <= met[0]
    else:
        assert found is None


TURNED = replace(GEL, name="turned", width=GEL.length, length=GEL.width, sag_x=GEL.sag_y, sag_y=GEL.sag_x)
POINTS = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 166), np.linspace(-0.5, 0.5, 202)), axis=-1).reshape(-1, 2) * [
    GEL.width,
    GEL.length,
]
TOP = np.column_stack([POINTS, GEL.top(*POINTS.T)])[GEL.inside(*POINTS.T)]  # an eighth of a millimetre apart


@pytest.mark.parametrize(
    "body", [*BODIES, build("blade", {"kind": "cuboid", "size": [5, 0.1], "fillet": 0.04, "height": 6})]
)
def test_on_all_rims_a_body_meets_what_lies_below_it_and_alike_where_all_is_turned_by_a_quarter(body):
    """On the rim, over it and beyond; by a plain grid of the whole top, which a blade passes."""
    met = []
    for aside in (0.97, 1.15, 1.6):
        for x, y in np.array([(1, 0.1), (-1, 0.1), (0.1, 1), (0.1, -1)]) * aside / 2 * [GEL.width, GEL.length]:
            press, turned = Press(x, y, 0.2, 0.4, -0.3, -1.9, 20.0), Press(-y, x, 0.2, 0.3, 0.4, -1.9, 110.0)
            met.append(first_touch(GEL, body, press))
            for one, other in (
                (met[-1], first_touch(TURNED, body, turned)),
                (nearest(GEL, body, press), nearest(TURNED, body, turned)),
            ):
                assert one == other or one == pytest.approx(other, abs=1e-3), press
            low, turned = replace(press, z0=-0.6), replace(turned, z0=-0.6)
            assert begins_inside(GEL, body, low) == begins_inside(TURNED, body, turned), press
            top = TOP[np.abs(TOP[:, :2] - [x, y]).max(axis=1) < 5.5]
            if body.name != "blade" and len(top):
                assert (nearest(GEL, body, press) < 0) == (
                    min(gap(body, press, top, t).min() for t in PRESSED) < 0
                ), press
                assert met[-1] is None or abs(gap(body, press, top, met[-1]).min()) < 0.02, press
    assert met.count(None) >= 4 and None not in met[:4]


@pytest.mark.parametrize("spacing", [(0.05, 0.05), (0.05, 0.1), (0.12, 0.04)])
def test_the_width_of_a_disc_is_its_diameter_and_of_a_ring_twice_its_wall(spacing):
    x, y = np.meshgrid(*(np.arange(-5.0, 5.0, step) for step in spacing), indexing="ij")
    away = np.hypot(x, y)
    assert width_of(away < 2.0, spacing) == pytest.approx(4.0, rel=0.03)
    assert width_of((away < 4.0) & (away > 3.2), spacing) == pytest.approx(1.6, rel=0.05)
    along = 4.0 / np.pi  # a square along the grid: no step of its rim is too long
    assert width_of((np.abs(x) < 2.0) & (np.abs(y) < 1.0), spacing) == pytest.approx(along * 4 * 8 / 12, rel=0.06)


@pytest.mark.parametrize("fillet", [0.02, 0.1, 0.3])
def test_the_contact_of_a_punch_ends_where_its_edge_reaches_a_fifth_of_the_depth(fillet):
    """And the undeformed surface meets its side, or its fillet; wherever the punch is, to what bisection leaves."""
    punch, depth, middle = (
        build("punch", {"kind": "cylinder", "diameter": 8, "fillet": fillet, "height": 10}),
        0.2,
        [0.13, -0.31],
    )
    met, contact = sides(pad(4.0), punch, Press(*middle, 0.0, 0.0, 0.0, -depth))
    left = TOUCH_STEP * (1.0 + WITHIN) / 2**SIDE_HALVINGS
    for found, height in ((met, depth), (contact, SECTION * depth)):
        low = max(fillet - height, 0.0)
        radius = 4.0 - fillet + np.sqrt(fillet**2 - low**2)
        known = np.add(middle * 2, [-radius, -radius, radius, radius])
        assert (np.abs(found - known) < left + 1e-3).all()  # the outermost point is not quite on the axis


def test_a_body_beside_the_gel_has_no_sides():
    assert not len(sides(pad(4.0), BODIES[0], Press(60.0, 0.0, 0.0, 0.0, 0.0, -0.5))[0])
