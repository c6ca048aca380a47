"""Pictures that are read as they lie and turned by half: what their mean is, and by which networks they are read so."""

from dataclasses import replace

import numpy as np
import pytest
from parameters import with_values
from synthetic_presses import SETTINGS

from gelforge.networks.bothways import BothWays, OneWay, picture_reader, turned
from gelforge.networks.modelfile import SensorNet, predict_images
from gelforge.networks.newmodel import describe
from gelforge.networks.use import load_for_use
from gelforge.records.image import read_image


@pytest.fixture(scope="module")
def shipped():
    return load_for_use(None)


@pytest.fixture(scope="module")
def pair(root):
    """An untouched picture, and one of the same sensor pressed."""
    folder = root / "data/demo"
    image = sorted((folder / "images").iterdir())[0]
    return read_image(folder / "nocontact/mini_a.png"), read_image(image)


def said(trained, both_ways):
    return replace(trained, about=trained.about | {"both_ways": both_ways})


def test_what_is_told_of_a_picture_turned_by_half_is_turned_by_half(shipped, pair):
    untouched, image = pair
    forces, _ = BothWays(shipped, untouched).read(image)
    other, _ = BothWays(shipped, turned(untouched)).read(turned(image))
    np.testing.assert_allclose(other[:2, ::-1, ::-1], -forces[:2], rtol=0, atol=1e-6)
    np.testing.assert_allclose(other[2, ::-1, ::-1], forces[2], rtol=0, atol=1e-6)


def test_both_ways_are_the_mean_of_the_networks_two_readings(shipped, pair):
    untouched, image = pair
    forces, pooled = BothWays(shipped, untouched).read(image)
    one = OneWay(shipped, untouched).read(image)
    other = predict_images(SensorNet(shipped, turned(untouched)).eval(), turned(image)[None])[0].sum((1, 2))
    mean = 0.5 * (one[0].sum((1, 2)) + other * (-1, -1, 1))
    np.testing.assert_allclose(forces.sum((1, 2)), mean, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(pooled, one[1], rtol=1e-4, atol=1e-4)
    assert np.abs(mean - one[0].sum((1, 2))).max() > 1e-3  # or nothing was gained


def test_a_network_that_knows_one_light_reads_pictures_as_they_lie(shipped, pair, models, data):
    untouched, image = pair
    assert isinstance(picture_reader(shipped, untouched), BothWays)
    alone = picture_reader(said(shipped, False), untouched)
    wanted = predict_images(SensorNet(shipped, untouched).eval(), image[None])[0]
    np.testing.assert_array_equal(alone.read(image)[0], wanted)
    assert isinstance(picture_reader(said(models["small"], True), None), OneWay)
    (picture, *_) = data.nocontact.values()
    assert isinstance(picture_reader(models["pair"], picture), OneWay)


@pytest.mark.parametrize(
    ("share", "begun", "both"), [(0.0, None, False), (0.5, None, True), (0.0, True, True), (0.0, False, False)]
)
def test_a_network_is_read_both_ways_that_saw_light_of_any_direction_or_began_as_one(
    models, data, share, begun, both
):
    start = None if begun is None else said(models["pair"], begun)
    settings = with_values(SETTINGS, mirrored_share=share)
    about = describe([data], "new", {"kind": "grid", "width": 8, "blocks": 1, "reads": "pair"}, settings, 1, start)
    assert about["both_ways"] is both
    alone = describe([data], "new", {"kind": "grid", "width": 8, "blocks": 1}, settings, 1, start)
    assert alone["both_ways"] is False  # without an untouched picture it reads one way, and says so
