"""Virtual units that a plan draws from ranges."""

import warnings
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.flow.params import read_sensor_tables
from gelforge.flow.schema import kinds_of, split
from gelforge.geometry.gel import USUAL_GEL, Gel
from gelforge.labelling.sensor import check_projection, sensors_of
from gelforge.reading.light import match_light
from gelforge.reading.markers import markers_in
from gelforge.virtualrig.appearance import read_appearances
from gelforge.virtualrig.render import Renderer
from gelforge.virtualrig.rigplan import DrawnUnits, orders, read_plan
from gelforge.virtualrig.units import UnitRanges, draw_units, read_ranges
from gelforge.virtualrig.writer import write_sensors
from tests.support.refused import refused
from tests.support.sandbox import ROOT

RIG = ROOT / "workflow" / "rig"
SOME = DrawnUnits("units.toml", known=4, unseen=1)


@pytest.fixture(scope="module")
def drawn():
    return draw_units(SOME, USUAL_GEL, RIG, seed=5)


def test_a_unit_depends_on_the_seed_and_its_name_alone(drawn):
    appearances, sensors = drawn
    more, _ = draw_units(replace(SOME, known=6, unseen=2), USUAL_GEL, RIG, seed=5)
    other, _ = draw_units(SOME, USUAL_GEL, RIG, seed=6)
    for name, appearance in appearances.items():
        assert np.array_equal(appearance.background, more[name].background) and appearance.seed == more[name].seed
        assert not np.array_equal(appearance.background, other[name].background)
    assert len({appearance.gain for appearance in appearances.values()}) == len(appearances)
    assert list(appearances) == list(sensors) == list(SOME.names)


def test_the_apex_of_every_unit_appears_where_its_camera_was_shifted_to(drawn):
    """Whatever its tilt: near the middle of the image, by no more than the range says."""
    most = max(np.abs(read_ranges(RIG / "units.toml").shift_px))
    for sensor in drawn[1].values():
        apex = sensor.project(np.zeros((1, 2)))[0]
        assert (
            np.abs(apex - np.array(sensor.image) / 2).max() <= most + 1e-9
            and np.abs(sensor.projection[2, :2]).max() > 0.0
        )
        # scale and turn there are those of a camera that looks straight down
        step = (sensor.project(np.array([[1e-4, 0.0], [0.0, 1e-4]])) - apex) / 1e-4
        assert np.linalg.norm(step[0]) == pytest.approx(np.linalg.norm(step[1]), rel=1e-3)
        assert abs(step[0] @ step[1]) < 1e-3 * np.linalg.norm(step[0]) ** 2


def test_values_lie_in_their_ranges(drawn):
    ranges = read_ranges(RIG / "units.toml")
    for appearance in drawn[0].values():
        for name, value in {"slope_limit": appearance.slope_limit, "gain": appearance.gain, "ink": appearance.ink, "shade_per_mm": appearance.shade,
                            "noise": appearance.noise, "specks": appearance.specks, "brightening": appearance.brightening}.items():  # fmt: skip
            low, high = getattr(ranges, name)
            assert np.all((low <= np.asarray(value)) & (np.asarray(value) <= high)), name
        assert appearance.jpeg == 0 or ranges.jpeg_quality[0] <= appearance.jpeg <= ranges.jpeg_quality[1]


def test_markers_are_found_where_the_sensor_has_them(drawn):
    """What the camera shows is what the sensor's table says: a unit can be calibrated from its no-contact image."""
    appearances, sensors = drawn
    most_deg = max(np.abs(read_ranges(RIG / "units.toml").grid_turn_deg))
    for name, appearance in appearances.items():
        sensor = sensors[name]
        check_projection(sensor.projection, name)
        apex, beside = (sensor.project(np.array([[0.0, y]]))[0] for y in (0.0, -0.01))  # along a row of markers
        turn_deg = np.rad2deg(np.arctan2(*(beside - apex)[::-1]))
        assert abs(turn_deg - sensor.markers["rotation_deg"]) < most_deg + 0.01, name
        unworn = replace(appearance, drift=replace(appearance.drift, worn=0.0))
        picture = Renderer(unworn, sensor.projection, Gel()).image(rng=np.random.default_rng(1))
        found = markers_in(picture).grid(sensor.markers["rows"], sensor.markers["cols"], name)
        whole = {tuple(index) for index in found.index.tolist()}
        assert found.count >= 0.85 * len(appearance.markers) and len(whole) == found.count
        nearest = np.sqrt(((found.points[:, None] - appearance.markers[None]) ** 2).sum(axis=2)).min(axis=1)
        assert np.median(nearest) < 0.5, name


def test_only_drawn_units_differ_in_light_from_picture_to_picture(drawn):
    appearances, sensors = drawn
    name = SOME.names[0]
    steady = replace(appearances[name].drift, relit=0.0, refocus=(0.0, 0.0), worn=0.0)
    calm = replace(appearances[name], noise=np.zeros(3), jpeg=0, drift=steady)
    camera = Renderer(calm, sensors[name].projection, Gel())
    one, other = (camera.image(rng=np.random.default_rng(k)) for k in (1, 2))
    assert np.abs(one.astype(int) - other).mean() > 1.0
    light = match_light(one, other)
    assert light.known
    # one gain and one offset a colour take back all but the smooth field
    assert np.abs(light.undo(one).astype(int) - other).mean() < 0.5 * np.abs(one.astype(int) - other).mean()
    # under another fall of light no gain of a colour takes it back
    relit = Renderer(
        replace(calm, drift=replace(steady, relit=1.0, gradient=(0.2, 0.2))), sensors[name].projection, Gel()
    )
    lopsided = relit.image(rng=np.random.default_rng(1)) / np.maximum(one.astype(float), 1.0)
    assert lopsided[-60:, -60:].mean() > 1.2 * lopsided[:60, :60].mean()
    still = Renderer(replace(calm, drift=None), sensors[name].projection, Gel())
    assert np.array_equal(*(still.image(rng=np.random.default_rng(k)) for k in (1, 2)))
    assert all(appearance.drift is None for appearance in read_appearances(RIG / "sensors.toml").values())


def test_worn_pictures_show_fewer_markers(drawn):
    appearances, sensors = drawn
    name = SOME.names[0]
    counts = []
    for count in (0, 6):
        drift = replace(
            appearances[name].drift, relit=0.0, worn=1.0, worn_markers=(count, count), worn_ink=(0.0, 0.0)
        )
        camera = Renderer(replace(appearances[name], drift=drift), sensors[name].projection, Gel())
        counts.append(len(markers_in(camera.image(rng=np.random.default_rng(3))).points))
    assert counts[0] - counts[1] == 6


def test_sensors_of_a_dataset_are_read_as_they_were_drawn(drawn, tmp_path):
    (tmp_path / "data").mkdir()
    write_sensors(tmp_path / "data/sensors.toml", drawn[1])
    tables = read_sensor_tables(ROOT / "workflow", tmp_path / "data")
    assert "mini_a" in tables
    read = sensors_of({name: tables[name] for name in drawn[1]}, "sensors.toml")
    for name, sensor in drawn[1].items():
        np.testing.assert_allclose(read[name].projection, sensor.projection, rtol=1e-8)
        assert read[name].markers == sensor.markers
    (tmp_path / "data/sensors.toml").write_text("[mini_a]\nimage = [320, 240]\n")
    with pytest.raises(BadInput, match="sensors.toml also defines mini_a"):
        read_sensor_tables(ROOT / "workflow", tmp_path / "data")


def test_ranges_without_meaning_are_refused(tmp_path):
    text = (RIG / "units.toml").read_text(encoding="utf-8")
    (tmp_path / "sensors.toml").write_text((RIG / "sensors.toml").read_text(encoding="utf-8"), encoding="utf-8")
    for old, new, said in (
        ("scale_px_per_mm = [15.2, 16.3]", "scale_px_per_mm = [16.3, 15.2]", "the lower one first"),
        ("scale_px_per_mm = [15.2, 16.3]", "scale_px_per_mm = [0, 16.3]", "each a number from 1 to 1000 px/mm"),
        ("contrast = [0.32, 1.6]", "contrasts = [0.32, 1.6]", "contrasts: unknown key; did you mean contrast"),
        ('"mini_d", "mini_e"]', '"mini_d", "mini_z"]', "no appearance mini_z"),
        ("noise = [0.8, 2.3]", 'noise = ["a", "b"]', "noise"),
        ("missing_markers = [0, 10]", "missing_markers = [0, 70]", "missing_markers"),
        ("misprint_px = [0.2, 0.7]", "misprint_px = [-0.5, 0.7]", "misprint_px"),
        ("jpeg_quality = [65, 95]", "jpeg_quality = [65, 300]", "jpeg_quality"),
        ("jpeg_fraction = 0.5", "jpeg_fraction = 7", "jpeg_fraction"),
        ("camera_mm = [20, 31]", "camera_mm = [1, 31]", "camera_mm"),
        ("slope_limit = [0.45, 1.1]", "slope_limit = [0, 1.1]", "slope_limit"),
        ('backgrounds = ["mini_a", "mini_d", "mini_e"]', "backgrounds = []", "backgrounds"),
    ):
        assert old in text
        (tmp_path / "units.toml").write_text(text.replace(old, new), encoding="utf-8")
        refused(said, draw_units, SOME, USUAL_GEL, tmp_path, seed=1)


def test_each_press_is_seen_by_as_many_units_as_asked_for():
    plan = replace(read_plan(RIG / "train.toml"), presses=60)
    seen = {}
    for order in orders(plan):
        seen.setdefault(order.press_id, []).append(order.sensor)
    counts = {len(names) for names in seen.values()}
    assert counts == {kind.seen_by for kind in plan.kinds}
    assert all(len(set(names)) == len(names) for names in seen.values())
    with_more = replace(plan, kinds=tuple(replace(kind, seen_by=len(kind.sensors) + 1) for kind in plan.kinds))
    assert with_more.identity() != plan.identity()


@pytest.mark.parametrize("end", [0, 1])
def test_a_unit_at_the_end_of_any_bound_has_a_picture(end):
    """Without shadow, noise, blur, ink and specks, and with as much of each as the schema lets through."""
    appearance, sensor = (values["known_01"] for values in draw_units(SOME, USUAL_GEL, RIG, seed=5))
    spans = {
        name: get_args(split(kind)[0])
        for name, kind in kinds_of(UnitRanges).items()
        if not name.endswith("_fraction")
    }
    bounds = {name: split(span[0])[1][0] for name, span in spans.items() if name != "backgrounds"}
    extreme = {
        field: np.full(3, limit) if np.ndim(getattr(appearance, field)) else limit
        for field, name in {"noise": "noise", "noise_blur": "noise_blur_px", "blur": "blur_px", "ink": "ink",
                            "flecks": "flecks", "shadow_depth": "shadow_depth", "raggedness": "raggedness",
                            "slope_limit": "slope_limit", "vignette": "vignette", "brightening": "brightening"}.items()
        for limit in [float((bounds[name].low, min(bounds[name].high, 20.0))[end])]
    }  # fmt: skip
    shadow = np.full(3, (0.0, 20.0)[end])
    one = replace(appearance, **extreme, shadow_length=shadow, specks=(0, 50)[end])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        picture = Renderer(one, sensor.projection, Gel()).image(rng=np.random.default_rng(0))
    assert picture.std() > 1.0 and (picture.max(axis=(0, 1)) > 20).all()
