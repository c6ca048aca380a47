"""The light of a pair of pictures, and the no-contact image found in a film: laws on made and on shipped pictures."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.reading.frame import ImageFrame, zoom_of
from gelforge.reading.light import Reference, match_light
from gelforge.reading.markers import OF_CONTACT, MarkerTracker, markers_in, rim_shift, shifted_back
from gelforge.reading.reader import Reader
from gelforge.records.image import read_image
from tests.support.pictures import moved
from tests.support.refused import refused

SIZE = (240, 320)


def gel(seed: int) -> np.ndarray:
    """A picture with coloured light from three sides and dark spots, (240, 320, 3) uint8."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    lamps = rng.uniform(-0.3, 0.3, (3, 2))
    picture = np.stack([110 + 60 * (a * x + b * y) for a, b in lamps], axis=2)
    for u in range(30, 320, 40):
        for v in range(30, 240, 40):
            cv2.circle(picture, (u, v), 5, (40, 35, 45), -1)
    return np.clip(picture + rng.normal(0, 1.0, picture.shape), 0, 255).astype(np.uint8)


def pressed(picture: np.ndarray, fraction: float, seed: int) -> np.ndarray:
    """The same with something round pressed into `fraction` of it: bright on one side, dark on the other."""
    rng, (h, w) = np.random.default_rng(seed), SIZE
    radius = np.sqrt(fraction * h * w / np.pi)
    u, v = rng.uniform(0.3, 0.7) * w, rng.uniform(0.3, 0.7) * h
    y, x = np.mgrid[:h, :w]
    slope = np.where(np.hypot(x - u, y - v) < radius, (x - u) / max(radius, 1e-9), 0.0)
    inside = np.hypot(x - u, y - v) < radius
    return np.clip(picture + (60 * slope + 8 * inside)[..., None] * [1.0, -0.5, 0.7], 0, 255).astype(np.uint8)


@given(st.integers(0, 999), st.floats(0.8, 1.2), st.floats(-6, 6), st.floats(0.0, 0.3))
@settings(max_examples=40)
def test_light_is_found_beside_a_contact(seed, gain, offset, fraction):
    """Whatever is pressed into up to three tenths of the picture, gain and offset are those of the rest."""
    rest = gel(seed)
    seen = np.clip(np.rint(gain * pressed(rest, fraction, seed).astype(float) + offset), 0, 255).astype(np.uint8)
    light = match_light(seen, rest)
    assert light.known
    back = light.undo(seen).astype(float)
    away = np.abs(pressed(rest, fraction, seed).astype(float) - rest).sum(axis=2) == 0
    assert abs((back - rest)[away].mean()) < 1.0


@given(st.integers(0, 999), st.floats(0.8, 1.2), st.floats(-6, 6), st.floats(0.0, 0.3))
@settings(max_examples=40)
def test_light_that_was_taken_back_is_found_no_more(seed, gain, offset, fraction):
    """The rounds end where they settle: in a picture whose light was taken back another search finds half a level at most."""
    rest = gel(seed)
    seen = np.clip(np.rint(gain * pressed(rest, fraction, seed).astype(float) + offset), 0, 255).astype(np.uint8)
    again = match_light(match_light(seen, rest).undo(seen), rest)
    levels = np.percentile(rest, [10, 90], axis=(0, 1))
    assert np.abs(again.gain * levels + again.offset - levels).max() < 0.5


def test_a_picture_of_nothing_or_of_another_scene_has_no_light_of_this_one():
    noise = np.random.default_rng(3).integers(0, 255, (12, 16, 3), dtype=np.uint8)
    scene = cv2.resize(noise, SIZE[::-1], interpolation=cv2.INTER_NEAREST)
    for other in (np.zeros((*SIZE, 3), np.uint8), np.full((*SIZE, 3), 255, np.uint8), scene):
        light = match_light(other, gel(1))
        assert not light.known and np.array_equal(light.gain, np.ones(3))


@pytest.fixture(scope="module")
def nocontact(demo_nocontact):
    return [demo_nocontact["mini_a"], demo_nocontact["mini_e"]]


DRIFTS = {
    "red two levels down": lambda p: p - [2.0, 0.0, 0.0],
    "all colours a tenth darker": lambda p: 0.9 * p,
    "blue a tenth brighter, green three levels up": lambda p: p * [1.0, 1.0, 1.1] + [0.0, 3.0, 0.0],
}


def test_drifting_light_is_no_force(shipped, nocontact):
    """On sensors that the network never saw: below 0.01 N where it read up to 26 N of the bare difference; at rest none."""
    for picture in nocontact:
        predictor = Reader(picture, model=shipped)
        assert not predictor(picture).cells.any()
        for name, drift in DRIFTS.items():
            drifted = np.clip(np.rint(drift(picture.astype(float))), 0, 255).astype(np.uint8)
            assert np.abs(predictor(drifted).total).max() < 0.01, name
            assert predictor.compare(drifted).light.known, name


def test_what_is_read_depends_on_its_picture_alone_and_changes_none(shipped, nocontact):
    """Pictures read in turns beside two no-contact images give what each does alone."""
    pictures = [pressed(picture, 0.05 * (k + 1), k) for k, picture in enumerate(nocontact)]
    given = [picture.copy() for picture in (*pictures, *nocontact)]
    alone = [Reader(rest, model=shipped)(image) for rest, image in zip(nocontact, pictures, strict=True)]
    kept = [Reader(rest, model=shipped) for rest in nocontact]
    for _ in range(2):
        for predictor, image, first in zip(kept, pictures, alone, strict=True):
            again = predictor(image)
            assert np.array_equal(again.cells, first.cells) and again.reason == first.reason
    assert all(np.array_equal(one, other) for one, other in zip(given, (*pictures, *nocontact), strict=True))


def frame_of(picture: np.ndarray, pitch: float) -> ImageFrame:
    """The frame of a camera whose markers stand `pitch` px apart, for a network that learnt 31 to 33."""
    red, green, blue = np.rint(picture.mean(axis=(0, 1))).tolist()
    return ImageFrame(SIZE, SIZE, zoom=zoom_of(pitch, (31.0, 33.0)), fill=(red, green, blue))


def smooth(seed: int) -> np.ndarray:
    """A picture without sharp rims, which survives being scaled there and back, (240, 320, 3) uint8."""
    return cv2.GaussianBlur(gel(seed), (0, 0), 3.0)


@given(st.integers(0, 99), st.floats(0.7, 0.95))
@settings(max_examples=15)
def test_a_camera_that_sees_less_shows_the_same_where_it_sees(seed, zoom):
    """A part cut out and enlarged, as a driver that crops does, comes back to where it was; beside it all is even."""
    whole = smooth(seed)
    matrix = np.array([[1 / zoom, 0, (1 - 1 / zoom) * 159.5], [0, 1 / zoom, (1 - 1 / zoom) * 119.5]])
    cropped = cv2.warpAffine(whole, matrix, SIZE[::-1], flags=cv2.INTER_CUBIC)
    frame = frame_of(cropped, 32.0 / zoom)
    assert frame.zoom == pytest.approx(zoom)
    back, inner = frame(cropped), frame.shown
    assert np.abs(back[inner].astype(int) - whole[inner])[2:-2, 2:-2].max() <= 4
    hidden = np.ones(SIZE, bool)
    hidden[inner] = False
    hidden = cv2.erode(hidden.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    assert hidden.any() and (back[hidden] == np.rint(cropped.mean(axis=(0, 1)))).all()


def test_a_camera_of_the_learnt_scale_or_without_markers_is_left_as_it_is():
    for pitch in (31.0, 32.0, 33.0, 33.5, 0.0):
        frame = frame_of(gel(0), pitch)
        assert frame.shows_rim and frame.shown == (slice(0, 240), slice(0, 320))
        assert np.array_equal(frame(gel(1)), gel(1))
    for pitch in (15.0, 50.0):
        refused(f"stand {pitch:.1f} px apart, in training 31 to 33 px", zoom_of, pitch, (31.0, 33.0))


@given(st.integers(0, 99), st.floats(0.8, 1.2), st.floats(-6, 6))
@settings(max_examples=15)
def test_light_is_found_in_what_a_narrow_view_shows(seed, gain, offset):
    """The even rim is no evidence of equal light, and stays even whatever the light does."""
    frame = frame_of(gel(seed), 44.0)
    rest = frame(gel(seed))
    seen = frame(np.clip(np.rint(gain * gel(seed).astype(float) + offset), 0, 255).astype(np.uint8))
    lit, light = Reference(rest, frame.shown).normalised(seen)
    assert light.known and np.abs(light.gain - gain).max() < 0.03
    assert np.abs(lit.astype(float) - rest).mean() < 1.0
    outside = np.ones(SIZE, bool)
    outside[frame.shown] = False
    assert np.array_equal(lit[outside], rest[outside])


def test_specks_are_no_print():
    """Dust on a gel without markers says nothing of the camera's scale."""
    rng = np.random.default_rng(4)
    picture = np.full((*SIZE, 3), 130, np.uint8)
    for u, v in zip(rng.uniform(10, 310, 25), rng.uniform(10, 230, 25), strict=True):
        cv2.circle(picture, (int(u), int(v)), 4, (40, 40, 40), -1)
    assert markers_in(picture).pitch == 0.0
    assert markers_in(gel(1)).pitch == pytest.approx(40.0, abs=0.5)


def test_a_picture_is_flagged_for_its_shape_and_not_for_its_size(shipped, nocontact):
    rest, press = nocontact[0], pressed(nocontact[0], 0.05, 3)
    for size in ((640, 480), (1280, 960), (160, 120)):
        larger = [cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC) for picture in (rest, press)]
        found = Reader(larger[0], model=shipped)(larger[1])
        assert "aspect ratio" not in found.reason and "size" not in found.reason
    assert "aspect ratio differs" in Reader(rest, model=shipped)(np.ascontiguousarray(press[:, :240])).reason


@pytest.mark.parametrize("view", ["whole", "narrow"])
def test_a_picture_without_colour_is_flagged_with_what_to_do(shipped, nocontact, view):
    """It was read a third too high without a word, and by a camera of a narrow view three times: the margin has colour."""
    part = (slice(None), slice(None)) if view == "whole" else (slice(34, 206), slice(46, 274))
    rest, image = (
        cv2.resize(np.ascontiguousarray(one[part]), (320, 240))
        for one in (nocontact[0], pressed(nocontact[0], 0.05, 3))
    )
    grey = [np.repeat(cv2.cvtColor(one, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2) for one in (rest, image)]
    predictor = Reader(rest, model=shipped)
    assert (predictor.frame.zoom < 0.8) == (view == "narrow")
    for found in (predictor(grey[1]), Reader(grey[0], model=shipped)(grey[1])):
        assert found.flag and "monochrome" in found.reason and "set the camera to colour" in found.reason
    for level in (0, 120):
        assert "dark, covered or of one colour" in predictor(np.full_like(image, level)).reason
    assert "monochrome" not in predictor(image).reason


def test_force_does_not_jump_where_a_press_begins(shipped, root):
    """Small changes of a picture are small changes of force: no part of the reader switches on."""
    press, still = (read_image(root / f"data/demo/{name}.png") for name in ("images/demo-000000", "nocontact/mini_a"))
    predictor, rest = Reader(still, model=shipped), still.astype(float)
    blends = [np.rint(rest + weight * (press - rest)).astype(np.uint8) for weight in np.linspace(0.0, 1.0, 41)]
    normal = np.array([predictor(image).total[2] for image in blends])
    assert np.abs(np.diff(normal)).max() < 0.15 * np.ptp(normal)


def test_a_gel_that_was_shifted_in_its_holder_is_shifted_back(nocontact):
    """As far as contact cannot have done it: not at all below, nearly all of it far beyond."""
    rest = nocontact[0]
    markers = MarkerTracker(rest, markers_in(rest))
    for far in (0.0, 2.0, 4.0, 8.0):
        expected = far * np.array([0.8, 0.6])
        left = expected - rim_shift(markers, markers.track(moved(rest, tuple(expected))))
        assert np.hypot(*left) == pytest.approx(min(far, OF_CONTACT**2 / far) if far else 0.0, abs=0.15)
        back = shifted_back(moved(rest, tuple(expected)), expected).astype(int)
        assert np.abs(back - rest)[20:-20, 20:-20].mean() < 1.0


def test_what_a_shift_does_to_force_grows_without_a_jump(shipped, root):
    """Also where it begins to be taken back."""
    press, rest = (read_image(root / f"data/demo/{name}.png") for name in ("images/demo-000002", "nocontact/mini_a"))
    predictor = Reader(rest, model=shipped)
    normal = np.array([predictor(moved(press, (far, 0.0))).total[2] for far in np.linspace(2.0, 3.5, 16)])
    assert np.abs(np.diff(normal)).max() < 0.05 * np.abs(normal).max()
