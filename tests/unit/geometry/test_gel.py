"""The gel's shape."""

import numpy as np
import pytest

from gelforge.geometry.gel import USUAL_GEL, Gel, is_gel, load_gel
from gelforge.geometry.triangles import is_watertight, volume
from tests.support.refused import refused


def test_measured_heights():
    gel = Gel()
    # read off the published solid: apex, both sags, a point of the dome, start of the corner, rim
    x = [0.0, 7.5354, 0.0, 4.5, 7.5354, 8.875, 10.375, 0.0]
    y = [0.0, 0.0, 9.7165, 6.0, 9.7165, 11.125, 0.0, 12.625]
    z = [0.0, -0.25, -0.25, -0.1605, -0.3240, -0.6907, -1.25, -1.25]
    np.testing.assert_allclose(gel.top(x, y), z, atol=0.012)
    np.testing.assert_allclose(gel.top(x[:5], y[:5]), z[:5], atol=0.001)


def test_symmetric_and_falling_outwards():
    gel = Gel()
    x, y = np.random.default_rng(0).uniform(0, [10.3, 12.6], (400, 2)).T
    z = gel.top(x, y)
    for sx, sy in ((-1, 1), (1, -1), (-1, -1)):
        np.testing.assert_array_equal(gel.top(sx * x, sy * y), z)
    inside = gel.inside(x, y)
    # towards the centre the top rises everywhere; 1e-9 is rounding
    assert (gel.top(0.98 * x, 0.98 * y)[inside] >= z[inside] - 1e-9).all()


def test_no_steps_across_the_patches():
    gel = Gel()
    for y in np.linspace(0.0, 12.6, 43):
        x = np.linspace(0.0, 10.375, 5001)
        # nowhere steeper than 2.2 within the outline, so that 0.0021 mm aside is at most 0.005 mm lower
        z = gel.top(x, np.full_like(x, y))[gel.inside(x, y)]
        assert np.abs(np.diff(z)).max() < 0.005


def test_scalars_and_arrays_broadcast():
    gel = Gel()
    assert gel.top(0.0, 0.0) == 0.0
    assert gel.top(np.zeros((3, 1)), np.zeros(4)).shape == (3, 4)
    assert gel.top(30.0, 30.0) == pytest.approx(gel.rim, abs=1e-12)


def test_outline_lies_on_the_edge():
    gel = Gel()
    ring = gel.outline(0.7)
    # rounding of the arcs only
    assert np.abs(gel.edge_distance(*ring.T)).max() < 1e-9
    assert np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).max() <= 0.7 + 1e-9


def test_surface_is_closed_and_holds_the_published_volume():
    gel = Gel()
    for size in (2.0, 1.0, 0.5):
        vertices, faces = gel.surface(size)
        assert is_watertight(faces)
        # the published solid holds 1898.8 mm^3; chords over the dome and fall take up to 0.2 mm^3 per mm^2 of size
        assert volume(vertices, faces) == pytest.approx(1898.8, abs=1.0 + 4.0 * size**2)
        top = vertices[vertices[:, 2] >= gel.rim]
        np.testing.assert_allclose(top[:, 2], gel.top(*top[:, :2].T), atol=1e-9)


def test_a_name_that_is_no_gels_is_refused():
    for name in ("digit", "digit-3.6mm", "gelsight_max", "gelsight_mini-", "gelsight_mini-3.6", "gelsight_mini--3.6mm",
                 "gelsight_mini-0.5mm", "gelsight_mini-9mm", "gelsight_mini-nanmm", "gelsight_mini-3.6mm\n"):  # fmt: skip
        assert not is_gel(name)
        refused("gel '", load_gel, name)
    assert not any(is_gel(value) for value in (None, 4.0, ["gelsight_mini"], {}))
    refused("size_mm", Gel().surface, 0.0)


def test_a_gel_of_a_stated_thickness_differs_in_its_base_alone():
    usual, thin = load_gel(USUAL_GEL), load_gel(f"{USUAL_GEL}-3.6mm")
    x, y = np.random.default_rng(1).uniform(-10, 10, (2, 50))
    np.testing.assert_array_equal(thin.top(x, y), usual.top(x, y))
    assert (thin.height, thin.name) == (3.6, f"{USUAL_GEL}-3.6mm")
    size = thin.surface(1.0)
    assert size[0][:, 2].min() == -3.6 and is_watertight(size[1])
    # what is missing lies below, over the whole outline
    flat = volume(*load_gel(f"{USUAL_GEL}-4mm").surface(1.0)) - volume(*size)
    assert flat == pytest.approx(0.4 * (usual.width * usual.length - (4 - np.pi) * usual.corner_radius**2), rel=2e-3)
