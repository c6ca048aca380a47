"""Frames of a Mini's camera of any size, crop and orientation are brought to the frame that networks read."""

import argparse
import itertools

import cv2
import numpy as np
import pytest

import gelforge
from gelforge.commands.camera import best_mode, camera_mode, camera_number, cameras, modes_of
from gelforge.commands.camera import main as camera
from gelforge.reading.frame import AS_IT_IS, Orientation, image_frame, same_shape
from gelforge.reading.markers import markers_in
from gelforge.reading.reader import Reader
from gelforge.records.film import open_source
from gelforge.records.image import read_image
from tests.support.crops import CROPS, FOUR, raw, resized
from tests.support.films import write_matroska
from tests.support.refused import refused

SIZE = (240, 320)
WAYS = [Orientation(*flags) for flags in itertools.product((False, True), repeat=3)]
UNITS = ["mini_a", "mini_e"]
PRESSED = "images/demo-000000.png"


def frame_of(picture):
    return image_frame(picture, SIZE)[0]


@pytest.fixture(scope="module")
def picture(demo_nocontact):
    return demo_nocontact["mini_a"]


@pytest.mark.parametrize("unit, crop", [(UNITS[k % 2], crop) for k, crop in enumerate(CROPS)])
def test_every_size_and_crop_shows_the_same_markers_in_the_same_places(demo_nocontact, unit, crop):
    picture = demo_nocontact[unit]
    made = CROPS[crop](picture)
    frame = frame_of(made)
    shown = frame(made)
    assert shown.shape == (*SIZE, 3) and shown.flags.c_contiguous
    markers = markers_in(shown)
    pitch, expected = markers.pitch, markers_in(picture).pitch
    # as the maker's driver shows it
    assert pitch == pytest.approx(expected, rel=0.01)
    grown = cv2.warpAffine(
        picture, cv2.getRotationMatrix2D((159.5, 119.5), 0, pitch / expected), SIZE[::-1], borderMode=1
    )
    found, places = markers.points, markers_in(grown).points
    found, places = found - np.median(found, axis=0), places - np.median(places, axis=0)
    apart = np.hypot(*(found[:, None] - places[None]).transpose(2, 0, 1)).min(axis=1)
    assert np.median(apart) < 0.5
    assert ("" if crop == "as it is" else f"{made.shape[1]} x {made.shape[0]}") in frame.text
    assert bool(frame.text) == (crop != "as it is")


def test_one_press_reads_the_same_force_at_four_sizes_and_crops(root):
    """Within 3 %, and not flagged for what is not flagged as the maker's driver gives it."""
    rest, pressed = (read_image(root / "data/demo" / name) for name in ("nocontact/mini_a.png", PRESSED))
    as_it_is = gelforge.Reader(nocontact=rest)(pressed)
    for crop in FOUR:
        found = gelforge.Reader(nocontact=CROPS[crop](rest))(CROPS[crop](pressed))
        assert found.total[2] == pytest.approx(as_it_is.total[2], rel=0.03), crop
        assert np.abs(found.total - as_it_is.total).max() < 0.03 * np.abs(as_it_is.total).max(), crop
        assert found.flag == as_it_is.flag, crop


def test_an_image_that_lies_otherwise_is_turned_back(demo_nocontact):
    """Bright sides of the light show which way is up, coloured fringes of the markers whether a mirror is between."""
    for unit, way in itertools.product(UNITS, WAYS):
        made = turned_so_that(way, demo_nocontact[unit])
        frame = frame_of(made)
        assert frame.orientation == way
        assert np.array_equal(frame(made), demo_nocontact[unit]), (unit, way)
        assert ("mirrored back" in frame.text) == way.mirrored


def test_a_reader_flags_images_as_opencv_reads_them(root):
    rest, pressed = (cv2.imread(str(root / "data/demo" / name)) for name in ("nocontact/mini_a.png", PRESSED))
    found = gelforge.Reader(nocontact=rest)(pressed)
    assert found.flag and "BGR" in found.reason
    assert not gelforge.Reader(nocontact=rest[..., ::-1])(pressed[..., ::-1]).flag
    mirrored = rest[:, ::-1, ::-1], pressed[:, ::-1, ::-1]
    assert not gelforge.Reader(nocontact=mirrored[0])(mirrored[1]).flag


def turned_so_that(way, picture):
    """An image that `way` turns into the picture."""
    made = picture[:: -1 if way.flip_v else 1, :: -1 if way.flip_u else 1]
    return np.ascontiguousarray(made.transpose(1, 0, 2) if way.transposed else made)


# Grasps by the camera_0 whose gel has flat markers.
FLAT = ("cheese_tube", "glass_box", "marker_pen", "nylon_thread", "tin_box", "usb_hub", "wooden_statue")


def no_contact(path):
    capture = cv2.VideoCapture(str(path))
    *_, frame = (capture.read()[1] for _ in range(13))
    capture.release()
    return np.ascontiguousarray(frame[..., ::-1])


def test_real_sensors_stay_as_they_are_and_are_turned_back(reference):
    """Of 16 films, also of gels whose flat markers leave no fringes: no mirror is found there, but which way is up and BGR."""
    for path in sorted((reference / "gripper_videos").glob("*.avi"))[::2]:
        picture = no_contact(path)
        assert frame_of(picture).orientation == AS_IT_IS, path.name
        assert frame_of(np.ascontiguousarray(picture[..., ::-1])).blue_first, path.name
        upside = frame_of(np.ascontiguousarray(picture[::-1, ::-1])).orientation
        assert upside == Orientation(False, True, True), path.name
        mirrored = frame_of(np.ascontiguousarray(picture[:, ::-1])).orientation
        flat = path.stem.startswith(FLAT) and path.stem.endswith("camera_0")
        assert mirrored == (AS_IT_IS if flat else Orientation(False, True, False)), path.name


@pytest.mark.slow
def test_feats_sensor_is_turned_back_whichever_way(reference):
    sample = np.load(reference / "feats/images/nocontact_train_sensor.npy", allow_pickle=True).item()
    picture = np.ascontiguousarray(sample["gs_img"])
    for way in WAYS:
        assert frame_of(turned_so_that(way, picture)).orientation == way


def test_an_image_without_markers_or_of_a_part_of_the_gel_is_resized_whole(picture):
    blank = cv2.GaussianBlur(picture, (0, 0), 25)
    assert frame_of(blank).text == ""
    part = resized(picture[40:200, 50:263], 640, 480)
    frame = frame_of(part)
    assert frame.text == "images of 640 x 480 are scaled to 320 x 240"
    assert np.abs(frame(part).astype(int) - cv2.resize(part, (320, 240), interpolation=cv2.INTER_AREA)).max() == 0


def test_a_square_crop_keeps_the_gels_shape(picture):
    square = resized(picture[:, 40:280], 480, 480)
    shown = frame_of(square)(square)
    points = markers_in(shown).points
    across, along = (np.abs(np.subtract.outer(points[:, k], points[:, k])) for k in (0, 1))
    right = np.where((along < 6) & (across > 6), across, np.inf).min(axis=1)
    down = np.where((across < 6) & (along > 6), along, np.inf).min(axis=1)
    assert np.median(right) == pytest.approx(np.median(down), rel=0.06)


def test_an_image_that_is_squeezed_into_a_square_is_flagged(picture, shipped):
    """A fifth more or less of the force was read of it, without a word."""
    squeezed, square = resized(picture, 224, 224), resized(picture[:, 40:280], 480, 480)
    for given, flagged in ((squeezed, True), (square, False), (picture, False), (resized(picture, 640, 480), False)):
        assert ("the no-contact image is stretched" in Reader(given, model=shipped).fault) == flagged


def test_an_image_of_another_mode_than_the_no_contact_image_is_resized_whole_and_flagged(picture):
    frame = frame_of(resized(picture, 640, 480))
    assert frame(raw(picture)).shape == (*SIZE, 3) and same_shape(raw(picture).shape, frame.shape)
    for other in (resized(picture, 640, 360), np.ascontiguousarray(np.rot90(picture))):
        whole = cv2.resize(other, SIZE[::-1], interpolation=cv2.INTER_AREA)
        assert np.array_equal(frame(other), whole) and not same_shape(other.shape, frame.shape)


def test_a_mode_is_a_size_and_a_camera_a_number_or_a_device_file(tmp_path):
    link = tmp_path / "usb-GelSight_Mini"
    link.symlink_to("/dev/video12")
    assert camera_mode("3280x2464") == (3280, 2464)
    assert [camera_number(text) for text in ("3", "/dev/video4", str(link))] == [3, 4, 12]
    for read, texts in (
        (camera_mode, ("640", "640 x 480", "0x480", "640x", "axb", "-640x480")),
        (camera_number, ("-1", "video3", "/dev/v4l/by-id/none", str(tmp_path))),
    ):
        for text in texts:
            with pytest.raises(argparse.ArgumentTypeError):
                read(text)
    refused("camera 97 cannot be opened", camera, ["97"])


def test_the_smallest_mode_that_is_large_and_fast_enough_is_taken():
    for modes, best in (
        ({(640, 480): 25.0, (3280, 2464): 5.0}, (640, 480)),
        ({(1280, 720): 30.0, (1640, 1232): 25.0}, (1640, 1232)),
        ({(1280, 720): 30.0, (3280, 2464): 5.0}, (1280, 720)),
        ({(3280, 2464): 5.0, (1640, 1232): 12.0}, (1640, 1232)),
        ({(160, 120): 60.0, (640, 480): 25.0}, (640, 480)),
        ({(640, 480): 0.0}, None),
        ({}, None),
    ):
        assert best_mode(modes) == best, modes


def test_a_source_of_one_size_has_one_mode(tmp_path, picture):
    """A film in a camera's place, which no driver sets to another size."""
    path = write_matroska(tmp_path / "a.mkv", [picture[..., ::-1]] * 30, list(range(0, 1200, 40)))
    with open_source(path, None) as (source, _):
        modes = modes_of(source)
    assert list(modes) == [(320, 240)] and modes[320, 240] > 0 and best_mode(modes) == (320, 240)


@pytest.mark.skipif(bool(cameras()), reason="this machine has a camera")
def test_no_camera_is_one_sentence():
    refused("no camera found.*plug it in", camera, [])


def test_an_image_that_shows_more_of_the_gel_than_its_no_contact_image_is_flagged(picture):
    """As where the one went through the maker's driver, which cuts off a seventh of each side, and the other did not."""

    def part(image, cut):
        height, width = image.shape[:2]
        y, x = round(cut * height), round(cut * width)
        return resized(image[y : height - y, x : width - x], 320, 240)

    for cut in (1 / 7, 1 / 9):
        cropped = gelforge.Reader(nocontact=part(picture, cut))
        assert "crop and scale both alike" in cropped(picture).reason
        assert cropped(part(picture, cut)).reason == ""
