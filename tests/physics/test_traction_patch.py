"""Patch tests of labels: uniform and linear traction over irregular meshes."""

import numpy as np
import pytest

from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import assemble
from gelforge.labelling.sensor import load_sensors
from tests.support.patch import consistent_loads, exact_cells, irregular_surface

CASES = [
    (kind, sensor, size, text)
    for kind in ("tet10", "hex8")
    for sensor in ("gelsight_mini", "mini_c")
    for size, text in ((0.75, "12x16"), (0.4, "24x32"))
]


def label_error(mesh, operator, sensor, traction) -> float:
    exact = exact_cells(mesh, traction, sensor, operator.grid)
    got = (operator.matrix.T @ consistent_loads(mesh, traction))[:-1].reshape(exact.shape)
    return float(np.abs(got - exact).max() / np.abs(exact).max())


@pytest.mark.parametrize("kind, name, size, text", CASES)
def test_uniform_and_linear_traction(kind, name, size, text):
    sensor = load_sensors("workflow/sensors.toml")[name]
    mesh = irregular_surface(kind, size, np.random.default_rng(5))
    operator = assemble(mesh, sensor, Grid.parse(text))
    # Uniform traction is exact by construction; what is left is rounding.
    assert label_error(mesh, operator, sensor, lambda x, y: np.full_like(x, 0.3)) < 1e-10
    # A part spreads its force evenly, so a gradient over a cell cut by parts of half its size is off by under 1 %.
    for slope in ((0.1, 0.0), (0.0, 0.08), (0.05, -0.05)):
        assert label_error(mesh, operator, sensor, lambda x, y, s=slope: s[0] * x + s[1] * y + 0.1) < 0.01


def test_linear_traction_converges_with_the_mesh():
    """Halving the elements under a fixed grid lowers the error about fourfold: it is of second order."""
    sensor = load_sensors("workflow/sensors.toml")["gelsight_mini"]
    errors = []
    for size in (0.8, 0.4, 0.2):
        mesh = irregular_surface("tet10", size, np.random.default_rng(6))
        errors.append(
            label_error(mesh, assemble(mesh, sensor, Grid.parse("12x16")), sensor, lambda x, y: 0.1 * x + 0.02 * y)
        )
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert rates.min() > 1.2 and rates.mean() > 1.5  # random meshes scatter the rate by some tenths


def test_exact_cells_of_one_square():
    """On one flat square the exact force per cell is the integral over the cell, done by hand."""
    from dataclasses import replace

    sensor = load_sensors("workflow/sensors.toml")["gelsight_mini"]
    mesh = irregular_surface("hex8", 1.0, np.random.default_rng(0))
    mesh = replace(
        mesh, nodes=np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), faces=np.array([[0, 1, 2, 3]])
    )
    found = exact_cells(mesh, lambda x, y: 1 + x, sensor, Grid(2, 2))
    # Row 0 is v < 120, that is x > 0: the integral of 1 + x over x in (0, 1), y in (0, 1) is 3/2, and 1/2 for x < 0.
    assert found == pytest.approx(np.array([[1.5, 1.5], [0.5, 0.5]]), abs=1e-12)
