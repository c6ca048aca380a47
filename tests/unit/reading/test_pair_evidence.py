"""Diagnostics that an image and a no-contact image do not belong together: on the demo's pictures, corrupted one by one."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelforge.reading.faults import (
    LIMITS,
    MarkerSigns,
    PairSigns,
    pair_fault,
    pair_limits,
    pair_signs,
    rim_signs,
    rimless_signs,
    unevenness,
    wider,
)
from gelforge.reading.light import Light
from gelforge.reading.markers import COLS, ROWS, MarkerTracker, Tracks, markers_in
from gelforge.reading.pair import Preprocessor
from gelforge.reading.predictor import Predictor, load_for_use
from gelforge.reading.profile import Gain
from gelforge.reading.untouched import touch_of
from gelforge.reading.wear import painted_over
from gelforge.records.image import read_image
from gelforge.records.log import read_presses
from tests.support.pictures import moved


@pytest.fixture(scope="module")
def presses(root):
    """Sensor, picture and normal force of every press of the demo."""
    folder = root / "data/demo"
    return [(p.sensor_id, read_image(folder / p.image), -p.fz_n) for p in read_presses(folder / "log.csv")]


@pytest.fixture(scope="module")
def limits(demo_nocontact, presses):
    prepare = {name: preprocessor(picture) for name, picture in demo_nocontact.items()}
    return pair_limits([pair_signs(prepare[name](image)) for name, image, _ in presses])


def preprocessor(picture):
    """Of the shipped network, whose pictures are all at their own scale."""
    metadata = load_for_use(None).metadata
    return Preprocessor(metadata | {"frame": metadata["frame"] | {"pitch_px": []}}, picture)


def touch(picture):
    return touch_of(picture, MarkerTracker(picture, markers_in(picture)))


def stained(picture, points, diameter):
    """A picture with round stains of other colour at some points (n, 2) px."""
    there = np.zeros(picture.shape[:2])
    for u, v in np.rint(points).astype(int).tolist():
        cv2.circle(there, (u, v), round(0.75 * diameter), 1.0, -1)
    return np.clip(picture * (1.0 + there[..., None] * (0.15, 0.0, -0.15)), 0, 255).astype(np.uint8)


def diagnostics(image, picture):
    return pair_signs(preprocessor(picture)(image))


CORRUPTION = {
    "a turn": (lambda image: moved(image, turn=-4.5), "rim"),
    "a zoom": (lambda image: moved(image, zoom=1.12), "rim|markers|no-contact"),
    "out of focus": (lambda image: cv2.GaussianBlur(image, (0, 0), 6.0), "markers at the rim"),
}


def test_every_limit_that_is_set_is_one_that_a_file_is_checked_for(limits):
    assert limits.keys() | {"largest_touch", "least_sharp"} == set(LIMITS)


def test_good_pairs_are_good(demo_nocontact, presses, limits):
    faults = [pair_fault(limits, diagnostics(image, demo_nocontact[name])) for name, image, _ in presses]
    assert sum(map(bool, faults)) <= 0.05 * len(faults)


def test_what_happened_to_a_picture_is_named(demo_nocontact, presses, limits):
    for what, (corrupt, named) in CORRUPTION.items():
        faults = [
            pair_fault(limits, diagnostics(corrupt(image), demo_nocontact[name])) for name, image, _ in presses[::3]
        ]
        seen = [fault for fault in faults if fault]
        assert len(seen) >= 0.85 * len(faults), what
        assert any(any(word in fault for word in named.split("|")) for fault in seen), what


def test_the_picture_of_another_unit_is_no_nocontact_image(demo_nocontact, presses, limits):
    units = list(demo_nocontact)
    other = dict(zip(units, [*units[1:], units[0]], strict=True))
    faults = [pair_fault(limits, diagnostics(image, demo_nocontact[other[name]])) for name, image, _ in presses]
    assert sum(map(bool, faults)) >= 0.9 * len(faults)


BEYOND = {
    "largest_distance": 1.0,
    "largest_residual": 1.0,
    "least_share": -0.01,
    "largest_rim_px": 1.0,
    "largest_rim_lost": 0.1,
    "largest_uneven": 0.1,
}


def pair_at(limits):
    """A pair that lies exactly at all limits."""
    light = Light(np.ones(3), np.zeros(3), limits["largest_residual"], limits["least_share"], known=True)
    markers = MarkerSigns(limits["largest_rim_px"], limits["largest_rim_lost"], limits["largest_uneven"])
    return PairSigns(limits["largest_distance"], light, markers)


def test_a_pair_beyond_a_single_limit_is_reported_and_a_wider_limit_lets_it_pass(limits):
    """The wider one of two datasets, where a network is fine-tuned from the one on the other."""
    assert limits.keys() == BEYOND.keys()
    for name, beyond in BEYOND.items():
        looser = limits | {name: limits[name] + beyond}
        assert pair_fault(limits, pair_at(limits)) == "" != pair_fault(limits, pair_at(looser)), name
        for before, new in ((limits, looser), (looser, limits)):
            assert pair_fault(wider(before, new), pair_at(looser)) == "", name


def test_a_gel_that_pulls_on_what_touches_it_is_reported(demo_nocontact, presses, shipped):
    name, image, _ = max(presses, key=lambda press: press[2])
    for gain, pulls in ((1.0, False), (-1.0, True)):
        judged = Predictor(shipped, demo_nocontact[name], Gain(gain, gain, gain, 9)).predict(image)
        assert ("the gel seems to pull" in judged.reason) == pulls and judged.flag >= pulls


def test_a_factor_multiplies_a_reading_and_that_of_images_that_change_places_alike(demo_nocontact, presses, shipped):
    name, image, _ = max(presses, key=lambda press: press[2])
    readers = [Predictor(shipped, demo_nocontact[name], Gain(gain, gain, gain, 9)) for gain in (1.0, 2.0)]
    for read in (lambda reader: reader.predict(image).total[2], lambda reader: reader.exchanged(image)):
        once, twice = map(read, readers)
        assert abs(once) > 0.1 and twice == pytest.approx(2.0 * once, rel=1e-5)


def test_a_no_contact_image_that_is_dark_blurred_or_grey_is_named(demo_nocontact, shipped):
    def fault(picture):
        return Predictor(shipped, picture).fault

    for picture in demo_nocontact.values():
        assert fault(picture) == ""
        assert "is dark" in fault((0.15 * picture).astype(np.uint8))
        assert "is blurred" in fault(cv2.GaussianBlur(picture, (0, 0), 3.0))
        assert "monochrome" in fault(np.repeat(picture[..., :1], 3, axis=2))


def test_a_no_contact_image_that_shows_a_press_is_named(demo_nocontact, presses):
    """From half a newton on, of a unit of weak contrast as of a strong one."""
    assert all(touch(picture) < 1.0 for picture in demo_nocontact.values())
    for unit in demo_nocontact:
        named = [touch(image) > 1.0 for name, image, force in presses if name == unit and force > 0.5]
        assert sum(named) >= 0.9 * len(named) > 5, unit


def test_what_is_left_of_worn_markers_is_no_touch(demo_nocontact):
    """Stains that are a seventh off in colour where eight markers were; between markers they are a touch."""
    for picture in demo_nocontact.values():
        markers = markers_in(picture)
        for seed in range(3):
            lost = np.random.default_rng(seed).permutation(len(markers.points))[:8]
            points = markers.points[lost] - 0.5
            gone = painted_over(picture, points, markers.diameter)
            assert touch(stained(gone, points, markers.diameter)) < 1.0
            assert touch(stained(gone, points + markers.pitch / 2, markers.diameter)) > 1.0


def test_a_drag_farther_than_the_network_learnt_is_flagged(demo_nocontact, shipped):
    """Markers that moved more than half their distance were taken for their neighbours: 2.6 to 3.8 times the force."""
    (picture, *_) = demo_nocontact.values()
    reader, (rows, cols) = Predictor(shipped, picture), picture.shape[:2]
    pitch = markers_in(picture).pitch
    v, u = np.mgrid[:rows, :cols].astype(np.float32)
    near = np.exp(-(((u - cols / 2) ** 2 + (v - rows / 2) ** 2) / (2.0 * pitch) ** 2))
    for angle in (0.0, 1.0, 2.5):
        for pitches, flagged in ((0.15, False), (0.75, True), (1.0, True)):
            across, along = pitches * pitch * np.cos(angle), pitches * pitch * np.sin(angle)
            dragged = cv2.remap(
                picture,
                u - (across * near).astype(np.float32),
                v - (along * near).astype(np.float32),
                cv2.INTER_LINEAR,
            )
            reason = reader.predict(dragged).reason
            assert ("its markers moved by" in reason) == flagged, (angle, pitches, reason)


# By what a no-contact image is multiplied that was taken under another fall of light; x, y from -1 to 1 over the image.
FALLS = {
    "corners 30 % darker": lambda x, y: 1.0 - 0.15 * (x**2 + y**2),
    "10 % from left to right": lambda x, y: 1.0 - 0.05 * x,
    "20 % from top to bottom": lambda x, y: 1.0 + 0.1 * y,
}


@pytest.mark.parametrize("fall", FALLS)
def test_a_no_contact_image_under_another_fall_of_light_is_flagged(demo_nocontact, presses, shipped, fall):
    name, image, _ = presses[0]
    picture = demo_nocontact[name]
    y, x = (np.linspace(-1.0, 1.0, size)[:, None] for size in picture.shape[:2])
    otherwise = np.clip(picture * FALLS[fall](x[:, 0], y)[..., None], 0, 255).astype(np.uint8)
    assert Predictor(shipped, picture).predict(image).reason == ""
    assert "light is distributed differently" in Predictor(shipped, otherwise).predict(image).reason


def test_light_alone_is_no_relief_and_no_fault(demo_nocontact, presses, limits):
    """Twice the contrast between the sides, or a tenth less of everything, is light, not contact."""
    for picture in demo_nocontact.values():
        dimmer = np.clip(np.rint(0.9 * picture), 0, 255).astype(np.uint8)
        assert touch(dimmer) < 1.0
    name, image, _ = presses[0]
    dimmer = np.clip(np.rint(0.93 * image), 0, 255).astype(np.uint8)
    assert pair_fault(limits, diagnostics(dimmer, demo_nocontact[name])) == ""


def test_a_picture_without_markers_has_no_rim_to_look_at():
    grey = np.full((240, 320, 3), 128, np.uint8)
    markers = MarkerTracker(grey, markers_in(grey))
    assert rim_signs(markers, markers.track(grey)) == MarkerSigns()
    assert touch(grey) < 1.0


# Of 40 markers of a view without rim: px that the first ten and the others moved, how many look otherwise, and what is reported.
RIMLESS = {
    "a gel at rest": (0.1, 0.2, 0, ""),
    "a press that shades markers": (0.7, 18.0, 18, ""),
    "a drag": (3.0, 8.0, 4, ""),
    "a gel that is mounted differently": (3.0, 3.2, 0, "nearly all markers moved"),
    "another gel": (3.0, 8.0, 16, "nearly all markers moved"),
    "another gel whose markers were taken for others": (0.3, 8.0, 24, "60% of its markers do not look"),
    "no marker that is found again": (np.nan, np.nan, 40, "100% of its markers do not look"),
}


def test_another_gel_is_reported_where_no_rim_is_shown(limits):
    for what, (near, far, unlike, reported) in RIMLESS.items():
        motion = np.where(np.arange(40)[:, None] < 10, near, far) * [1.0, 0.0]
        evidence = rimless_signs(Tracks(motion, np.arange(40) < unlike))
        light = Light(np.ones(3), np.zeros(3), 0.0, 1.0, known=True)
        fault = pair_fault(limits, PairSigns(0.0, light, evidence))
        assert fault.startswith(reported) and bool(fault) == bool(reported), what
    assert rimless_signs(Tracks(np.zeros((0, 2)), np.zeros(0, bool))) == MarkerSigns()  # no marker at all


@given(st.tuples(*[st.floats(-5, 5)] * 4), st.floats(0, 0.3), st.integers(0, 99))
def test_what_moves_all_markers_alike_is_not_uneven(parts, lost, seed):
    """Whatever the shift, turn and zoom, and whichever markers are lost; markers of another print are distinguished from them."""
    rng = np.random.default_rng(seed)
    right, down, turn, zoom = (part * unit for part, unit in zip(parts, (1, 1, 0.01, 0.01)))
    v, u = 32.0 * np.mgrid[:ROWS, :COLS] - 32.0 * np.array([ROWS // 2, COLS // 2])[:, None, None]
    aside = np.stack([right + zoom * u - turn * v, down + zoom * v + turn * u])
    found = (rng.random((1, ROWS, COLS)) >= lost).astype(np.float32)
    assert unevenness(np.concatenate([found * aside, found])) < 1e-4
    print_ = aside + rng.normal(0, 1.0, aside.shape)
    assert unevenness(np.concatenate([found * print_, found])) > 0.3
    assert unevenness(np.zeros((3, ROWS, COLS))) == 0.0
