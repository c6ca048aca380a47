"""Diagnostics that an image and a no-contact image do not belong together: on the demo's pictures, corrupted one by one."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelforge.evidence.logimages import LogPairs
from gelforge.live.reading import exchanged
from gelforge.reading.faults import PAIR, Asked, pair_fault
from gelforge.reading.markers import COLS, ROWS, MarkerTracker, Tracks, markers_in
from gelforge.reading.measures import common_motion, rim_px, uneven, unevenness
from gelforge.reading.pair import NoContact
from gelforge.reading.profile import Gain
from gelforge.reading.reader import Reader, reader_with
from gelforge.reading.untouched import touch_of
from gelforge.reading.wear import painted_over
from gelforge.records.image import read_image
from gelforge.records.log import read_presses
from tests.support.pictures import moved


@pytest.fixture(scope="module")
def presses(root):
    """Sensor, picture and normal force of every press of the demo."""
    folder = root / "tests/data/presses"
    return [(p.sensor_id, read_image(folder / p.image), -p.fz_n) for p in read_presses(folder / "log.csv")]


def touch(picture):
    return touch_of(picture, MarkerTracker(picture, markers_in(picture)))


def stained(picture, points, diameter):
    """A picture with round stains of other colour at some points (n, 2) px."""
    there = np.zeros(picture.shape[:2])
    for u, v in np.rint(points).astype(int).tolist():
        cv2.circle(there, (u, v), round(0.75 * diameter), 1.0, -1)
    return np.clip(picture * (1.0 + there[..., None] * (0.15, 0.0, -0.15)), 0, 255).astype(np.uint8)


def fault(image, picture):
    """What a reader says of a pair before it predicts."""
    nocontact = NoContact(picture, picture.shape[:2])
    return pair_fault(nocontact.compare(image), Asked.READER)


CORRUPTION = {
    "a turn": (lambda image: moved(image, turn=-4.5), "rim"),
    "a zoom": (lambda image: moved(image, zoom=1.12), "rim|markers|no-contact"),
    "out of focus": (lambda image: cv2.GaussianBlur(image, (0, 0), 6.0), "fainter"),
}


def test_every_fault_names_the_data_behind_its_limit():
    assert all(one.data and one.asked for one in PAIR)


def test_good_pairs_are_good(demo_nocontact, presses):
    assert not any(fault(image, demo_nocontact[name]) for name, image, _ in presses[::2])


def test_what_happened_to_a_picture_is_named(demo_nocontact, presses):
    for what, (corrupt, named) in CORRUPTION.items():
        faults = [fault(corrupt(image), demo_nocontact[name]) for name, image, _ in presses[::5]]
        seen = [one for one in faults if one]
        assert len(seen) >= 0.85 * len(faults), what
        assert any(any(word in one for word in named.split("|")) for one in seen), what


def test_the_picture_of_another_unit_is_no_nocontact_image(demo_nocontact, presses):
    units = list(demo_nocontact)
    other = dict(zip(units, [*units[1:], units[0]], strict=True))
    faults = [fault(image, demo_nocontact[other[name]]) for name, image, _ in presses[::3]]
    assert sum(map(bool, faults)) >= 0.9 * len(faults)


# One fault each, from harmless to beyond its limit: the judge of a log and a reader must agree on what both ask for.
SPOILT = {
    "blurred": lambda image, rest, by: cv2.GaussianBlur(image, (0, 0), 0.5 + 3.0 * by),
    "dimmed": lambda image, rest, by: np.rint(image * (1.0 - 0.7 * by)).astype(np.uint8),
    "shifted": lambda image, rest, by: moved(image, (8.0 * by, 6.0 * by)),
    "torn": lambda image, rest, by: np.concatenate([image[: int(240 - 160 * by)], rest[int(240 - 160 * by) :]]),
    "mirrored": lambda image, rest, by: np.ascontiguousarray(image[:, ::-1]) if by > 0.5 else image,
}


def test_the_judge_of_a_log_and_a_reader_say_the_same(demo_nocontact, presses, shipped):
    """Images a little out of focus were all rejected by the one and all passed by the other."""
    judges = {name: LogPairs(picture) for name, picture in demo_nocontact.items()}
    readers = {name: Reader(picture, model=shipped) for name, picture in demo_nocontact.items()}
    both = [one for one in PAIR if Asked.LOG in one.asked]
    differ = []
    for what, spoil in SPOILT.items():
        for by in (0.2, 1.0):
            for name, image, _ in presses[::16]:
                spoilt = spoil(image, demo_nocontact[name], by)
                logged, pair = pair_fault(judges[name](spoilt), Asked.LOG), readers[name].compare(spoilt)
                # a reader may find more: what makes a network read a wrong force
                if logged != next((text for one in both if (text := one.of(pair))), ""):
                    differ.append((what, by, logged))
                assert bool(logged) <= bool(pair_fault(pair, Asked.READER))
    assert not differ


def test_an_image_a_little_out_of_focus_is_used_and_one_far_out_is_not(demo_nocontact, presses, shipped):
    """Forces change by 1 to 2 % at 1.5 px of blur, by a tenth and more at 3 px and beyond."""
    for name, image, _ in presses[::16]:
        judge, reader = LogPairs(demo_nocontact[name]), Reader(demo_nocontact[name], model=shipped)
        for blur, flagged in ((0.6, False), (1.5, False), (5.0, True)):
            seen = cv2.GaussianBlur(image, (0, 0), blur)
            assert bool(pair_fault(judge(seen), Asked.LOG)) == flagged == bool(reader(seen).reason), (name, blur)


def test_a_torn_frame_is_flagged(demo_nocontact, presses):
    """Half of a press beside half of a free gel was read as a tenth of its force, and no such frame was flagged.

    Four of five frames whose lower part is the free gel, or their own that lies aside.
    """
    found = []
    for name, image, normal in presses[::2]:
        if normal > 5.0:
            rest = demo_nocontact[name]
            row = int(np.abs(image.astype(int) - rest).sum(axis=(1, 2)).argmax())  # through the contact
            lower = rest[row:], np.roll(image[row:], 30, axis=1)
            found.append(["torn" in fault(np.concatenate([image[:row], one]), rest) for one in lower])
    assert len(found) > 10 and (np.mean(found, axis=0) >= 0.8).all(), np.mean(found, axis=0)


def test_a_gel_that_pulls_on_what_touches_it_is_reported(demo_nocontact, presses, shipped):
    name, image, _ = max(presses, key=lambda press: press[2])
    for gain, pulls in ((1.0, False), (-1.0, True)):
        judged = reader_with(shipped, demo_nocontact[name], Gain(gain, gain, gain, 9))(image)
        assert ("the gel seems to pull" in judged.reason) == pulls and judged.flag >= pulls


def test_a_factor_multiplies_a_reading_and_that_of_images_that_change_places_alike(demo_nocontact, presses, shipped):
    name, image, _ = max(presses, key=lambda press: press[2])
    readers = [reader_with(shipped, demo_nocontact[name], Gain(gain, gain, gain, 9)) for gain in (1.0, 2.0)]
    for read in (lambda reader: reader(image).total[2], lambda reader: exchanged(reader, image)):
        once, twice = map(read, readers)
        assert abs(once) > 0.1 and twice == pytest.approx(2.0 * once, rel=1e-5)


def test_a_no_contact_image_that_is_dark_blurred_or_grey_is_named(demo_nocontact, shipped):
    def fault(picture):
        return Reader(picture, model=shipped).fault

    for picture in demo_nocontact.values():
        assert fault(picture) == ""
        assert "is dark" in fault((0.15 * picture).astype(np.uint8))
        assert "is blurred" in fault(cv2.GaussianBlur(picture, (0, 0), 3.0))
        assert "monochrome" in fault(np.repeat(picture[..., :1], 3, axis=2))


def test_a_no_contact_image_that_shows_a_press_is_named(demo_nocontact, presses):
    """From half a newton on, of a unit of weak contrast as of a strong one."""
    assert all(touch(picture) < 1.0 for picture in demo_nocontact.values())
    for unit in demo_nocontact:
        own = [image for name, image, force in presses if name == unit and force > 0.5]
        named = [touch(image) > 1.0 for image in own[:10]]
        assert sum(named) >= 0.9 * len(named) > 5, unit


def test_what_is_left_of_worn_markers_is_no_touch(demo_nocontact):
    """Stains that are a seventh off in colour where eight markers were; between markers they are a touch."""
    for picture in demo_nocontact.values():
        markers = markers_in(picture)
        lost = np.random.default_rng(0).permutation(len(markers.points))[:8]
        points = markers.points[lost] - 0.5
        gone = painted_over(picture, points, markers.diameter)
        assert touch(stained(gone, points, markers.diameter)) < 1.0
        assert touch(stained(gone, points + markers.pitch / 2, markers.diameter)) > 1.0


def test_a_drag_farther_than_the_network_learnt_is_flagged(demo_nocontact, shipped):
    """Markers that moved more than half their distance were taken for their neighbours: 2.6 to 3.8 times the force."""
    (picture, *_) = demo_nocontact.values()
    reader, (rows, cols) = Reader(picture, model=shipped), picture.shape[:2]
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
            reason = reader(dragged).reason
            assert ("its markers moved by" in reason) == flagged, (angle, pitches, reason)


def test_a_drag_of_most_of_the_gel_is_no_torn_frame(demo_nocontact, shipped):
    """It moves the markers of one row alike, whose edges then are steps from one row to the next."""
    noise = np.random.default_rng(3)
    for picture in demo_nocontact.values():
        reader, (rows, cols) = Reader(picture, model=shipped), picture.shape[:2]
        pitch = markers_in(picture).pitch
        v, u = np.mgrid[:rows, :cols].astype(np.float32)
        near = np.exp(-(((u - cols / 2) ** 2 + (v - rows / 2) ** 2) / (3.0 * pitch) ** 2)).astype(np.float32)
        for pitches in (0.15, 0.5):
            for across, along in ((0.0, 1.0), (0.8, 0.6)):
                moved = [side - np.float32(pitches * pitch * way) * near for side, way in ((u, across), (v, along))]
                dragged = cv2.remap(picture, *moved, cv2.INTER_LINEAR) + noise.normal(0.0, 1.5, picture.shape)
                assert "torn" not in reader(np.clip(np.rint(dragged), 0, 255).astype(np.uint8)).reason


# By what a no-contact image is multiplied that was taken under another fall of light; x, y from -1 to 1 over the image.
FALLS = {
    "corners 60 % darker": lambda x, y: 1.0 - 0.3 * (x**2 + y**2),
    "50 % from left to right": lambda x, y: 1.0 - 0.25 * x,
    "10 % from top to bottom": lambda x, y: 1.0 + 0.05 * y,
}


def test_a_no_contact_image_under_another_fall_of_light_is_flagged_or_changes_a_force_within_its_interval(
    demo_nocontact, presses, shipped
):
    name, image, _ = max(presses, key=lambda press: press[2])
    picture = demo_nocontact[name]
    usual = Reader(picture, model=shipped)(image)
    assert usual.reason == ""
    y, x = (np.linspace(-1.0, 1.0, size)[:, None] for size in picture.shape[:2])
    for fall, field in FALLS.items():
        otherwise = np.clip(picture * field(x[:, 0], y)[..., None], 0, 255).astype(np.uint8)
        found = Reader(otherwise, model=shipped)(image)
        print(fall, found.reason, found.total, usual.total, found.half_width)
        assert found.flag or (np.abs(found.total - usual.total) < found.half_width).all(), fall


def test_light_alone_is_no_relief_and_no_fault(demo_nocontact, presses):
    """Twice the contrast between the sides, or a tenth less of everything, is light, not contact."""
    for picture in demo_nocontact.values():
        dimmer = np.clip(np.rint(0.9 * picture), 0, 255).astype(np.uint8)
        assert touch(dimmer) < 1.0
    name, image, _ = presses[0]
    dimmer = np.clip(np.rint(0.93 * image), 0, 255).astype(np.uint8)
    assert fault(dimmer, demo_nocontact[name]) == ""


def test_a_picture_without_markers_has_no_rim_to_look_at():
    grey = np.full((240, 320, 3), 128, np.uint8)
    pair = NoContact(grey, grey.shape[:2]).compare(grey)
    assert rim_px(pair) == uneven(pair) == 0.0
    assert touch(grey) < 1.0


# Of 40 markers of a view without rim: px that the first ten and the others moved, how many look otherwise, and the motion
# that is common to most of them.
RIMLESS = {
    "a gel at rest": (0.1, 0.2, 0, 0.0),
    "a press that shades markers": (0.7, 18.0, 18, 0.0),
    "a drag": (3.0, 8.0, 4, 0.0),
    "a gel that is mounted differently": (3.0, 3.2, 0, 3.0),
    "another gel": (3.0, 8.0, 16, 3.0),
    "no marker that is found again": (np.nan, np.nan, 40, 0.0),
}


def test_common_motion_is_that_of_a_gel_and_not_of_a_drag():
    for what, (near, far, unlike, expected) in RIMLESS.items():
        motion = np.where(np.arange(40)[:, None] < 10, near, far) * [1.0, 0.0]
        assert common_motion(Tracks(motion, np.arange(40) < unlike)) == pytest.approx(expected, abs=1e-6), what
    assert common_motion(Tracks(np.zeros((0, 2)), np.zeros(0, bool))) == 0.0  # no marker at all


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
