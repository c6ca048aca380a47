"""Moments of maps about the gel's apex."""

import numpy as np
import pytest

from gelforge.geometry.gel import load_gel
from gelforge.labelling.grid import Grid
from gelforge.labelling.moment import Arms
from gelforge.labelling.sensor import Sensor, gelsight_mini, load_sensors
from gelforge.mechanics.material import REFERENCE_C10

GRID = Grid(24, 32)
STIFF = 1e6  # MPa: a gel that does not move


def test_a_force_on_a_rigid_gel_turns_about_the_apex_by_where_its_cell_is(root):
    sensors = load_sensors(root / "workflow/sensors.toml")
    for sensor in (sensors[name] for name in ("gelsight_mini", "mini_b", "mini_c")):
        cells = np.zeros((3, 24, 32))
        cells[:, 5, 20] = force = np.array([0.3, -0.2, -2.0])
        x, y = sensor.unproject(np.array([205.0, 55.0]))
        place = [x, y, load_gel(sensor.gel).top(np.array([x]), np.array([y]))[0]]
        assert Arms(sensor, GRID).moment(cells, STIFF) == pytest.approx(np.cross(place, force), abs=1e-6)


def test_a_wide_uniform_load_moves_the_surface_as_a_sheared_layer_and_hardly_into_it():
    """Stress times thickness over the shear modulus; an incompressible layer cannot be pressed in evenly."""
    # whose middle is not over the apex
    wide = Sensor("wide", (320, 240), np.array([[0.0, -1.0, 150.0], [-1.0, 0.0, 128.0], [0.0, 0.0, 1.0]]))
    cells = np.full((3, 60, 80), 1e-3)  # N on cells of 4 by 4 mm
    x, y, z = Arms(wide, Grid(60, 80)).displacement(cells)[:, 30, 40]
    sheared = 1e-3 / 16.0 * load_gel(wide.gel).height / (2.0 * REFERENCE_C10)
    assert (x, y) == pytest.approx((sheared, sheared), rel=0.02) and abs(z) < 0.05 * sheared


def test_a_turned_map_has_the_turned_moment():
    rng = np.random.default_rng(3)
    cells = rng.normal(size=(3, 24, 32)) * np.exp(-((np.arange(32) - 14) ** 2) / 20.0)
    arms, way = Arms(gelsight_mini(), GRID), np.array([-1.0, -1.0, 1.0])
    turned = cells[:, ::-1, ::-1] * way[:, None, None]
    assert arms.moment(turned) == pytest.approx(way * arms.moment(cells), rel=1e-6)


def test_the_gels_motion_is_proportional_to_force_over_stiffness():
    cells = np.zeros((3, 24, 32))
    cells[:, 8:12, 10:15] = np.array([0.02, 0.01, -0.1])[:, None, None]
    arms = Arms(gelsight_mini(), GRID)
    assert arms.displacement(2 * cells, 0.2) == pytest.approx(arms.displacement(cells, 0.1), rel=1e-9, abs=1e-12)
    still, soft = arms.moment(cells, STIFF), arms.moment(cells, 0.1)
    assert not np.allclose(soft, still, rtol=1e-3) and arms.moment(cells, 0.2) - still == pytest.approx(
        (soft - still) / 2, rel=1e-4
    )


def test_a_map_of_one_cell_has_no_moment():
    assert np.isnan(Arms(gelsight_mini(), Grid(1, 1)).moment(np.ones((3, 1, 1)))).all()
