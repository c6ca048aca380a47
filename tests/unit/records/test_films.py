"""Films and cameras: each frame's own time, what is whole, frames before the no-contact image, memory."""

import csv
import itertools
import os
import time
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelforge.commands import live
from gelforge.records.film import Film, Frame, open_source
from gelforge.records.nocontactimage import FEWEST, MOST, SETTLING, STILL, find_nocontact
from tests.support.films import write_matroska, write_mp4
from tests.support.refused import refused

# A camera that drops frames while its computer is busy, and one that slows down in the dark.
TIMES = {
    "dropped": [0, 40, 80, 400, 440, 480, 520, 560, 600, 640, 680, 720, 760, 800],
    "slower": [*range(0, 400, 33), *range(400, 2000, 200)],
    "one pause at its end": [*range(0, 400, 40), 5000],
    "even": list(range(0, 800, 40)),
}


def shades(count):
    return [np.full((60, 80, 3), 40 + 5 * k, np.uint8) for k in range(count)]


def all_frames(path, limit=None):
    with open_source(path, None) as (source, announced):
        return list(Film(source, announced, str(path), limit, False, path))


def test_each_frame_has_its_own_time_and_a_whole_film_is_not_called_cut(tmp_path):
    """Times begin with the first frame."""
    for name, times in TIMES.items():
        found = all_frames(write_matroska(tmp_path / "a.mkv", shades(len(times)), [700 + t for t in times]))
        assert [frame.number for frame in found] == list(range(len(times))), name
        assert [frame.time_s for frame in found] == pytest.approx([t / 1000 for t in times], abs=2e-3)
        assert [frame.image.mean() for frame in found] == pytest.approx(
            [40 + 5 * k for k in range(len(times))], abs=2
        )


def test_a_camera_given_as_a_film_names_its_option():
    for device in ("/dev/video0", "/dev/v4l/by-id/usb-gel-index0"):
        refused(f"{device}: .*--camera {device}$", live.main, ["--video", device, "--csv", "-"])


def test_a_film_whose_sound_is_longer_or_whose_rate_varies_is_whole(tmp_path):
    """Its container lasts ten seconds, and frames are announced by that; an MP4 has times of its frames, too."""
    times = TIMES["dropped"]
    path = write_matroska(tmp_path / "a.mkv", shades(len(times)), times, duration_ms=10_000)
    assert len(all_frames(path)) == len(times)
    steps = [40, 40, 320, 40, 80, 40, 200, 40, 40, 160]
    found = all_frames(write_mp4(tmp_path / "a.mp4", shades(len(steps)), steps))
    expected = np.cumsum([0, *steps[:-1]]) / 1000
    assert [frame.time_s for frame in found] == pytest.approx(expected.tolist(), abs=2e-3)


def test_a_film_that_is_cut_is_still_called_so(tmp_path):
    for name in ("even", "dropped", "slower"):
        path = write_matroska(tmp_path / "a.mkv", shades(len(TIMES[name])), TIMES[name])
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        refused(r"a\.mkv: ended after \d+ of \d+ frames; the file is cut short", all_frames, path)
        assert len(all_frames(path, 3)) == 3


def test_a_whole_mkv_is_read_to_its_end_without_an_error(tmp_path, root):
    """By the command, with the times in its table; one cut in half ends in status 2."""
    rest = cv2.resize(cv2.imread(str(root / "data/demo/nocontact/mini_a.png")), (320, 240))
    times = [*range(0, 520, 40), 900, 2000, 2130]
    path = write_matroska(tmp_path / "a.mkv", [rest] * len(times), times)
    assert live.main(["--video", str(path), "--csv", str(tmp_path / "a.csv")]) == 0
    with (tmp_path / "a.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["time_s"]) for row in rows] == pytest.approx([t / 1000 for t in times[SETTLING:]], abs=2e-3)
    assert [int(row["frame"]) for row in rows] == list(range(SETTLING, len(times)))


def as_frames(images):
    return (Frame(k, 0.04 * k, image) for k, image in enumerate(images))


def moving(count, seed=0):
    rng = np.random.default_rng(seed)
    return [np.full((60, 80, 3), rng.integers(0, 255), np.uint8) for _ in range(count)]


REST = np.full((60, 80, 3), 90, np.uint8)
EXPOSING = [np.clip(REST * (1.6 - 0.07 * k), 0, 255).astype(np.uint8) for k in range(SETTLING)]


def test_frames_before_the_sensor_rests_are_not_given_back():
    """They were read against a picture of a settled camera: 7 N of pressing in the first eight of a gripper's film."""
    for before in (EXPOSING, moving(40), [], [*EXPOSING, *moving(30, 1)]):
        still = [REST] * (20 if len(before) >= SETTLING else FEWEST + 20)
        picture, stream = find_nocontact(as_frames([*before, *still]), "film")
        assert np.array_equal(picture, REST)
        first = max(len(before), SETTLING)
        assert [frame.number for frame in stream] == list(range(first, len(before) + len(still)))


def test_frames_of_a_real_film_before_the_camera_settled_are_left_out(reference):
    """Of all real films: what is read begins at rest."""
    for path in sorted((reference / "gripper_videos").glob("*.avi"))[:6]:
        with open_source(path, None) as (source, announced):
            picture, stream = find_nocontact(Film(source, announced, str(path), 60, False, path), str(path))
            frames = list(itertools.islice(stream, STILL))
        assert frames[0].number >= SETTLING
        assert max(np.abs(frame.image.astype(int) - picture).mean() for frame in frames) < 3.0


def test_a_large_camera_that_never_rests_keeps_few_frames():
    """3280 x 2464 pixels, 24 MB a frame: 300 of them were kept."""
    large = (2464, 3280, 3)
    noise = np.random.default_rng(0).integers(0, 255, large, np.uint8)

    def endless():
        for number in range(40):
            yield Frame(number, 0.1 * number, np.roll(noise, 997 * number))

    tracemalloc.start()
    refused("no 5 frames in a row without movement", find_nocontact, endless(), "camera 0")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < (STILL + 4) * np.prod(large)


def test_a_stream_that_never_rests_is_given_up_in_time():
    seen = itertools.count()
    endless = (Frame(next(seen), 0.0, image) for image in moving(MOST + 50))
    refused(f"of {MOST} looked at", find_nocontact, endless, "camera 0")
    assert next(seen) == MOST
    refused(f"ends after {FEWEST - 1}", find_nocontact, as_frames([REST] * (FEWEST - 1)), "film")


class Opened:
    """What a camera's driver gives that is set to another size while it runs: OpenCV's interface of a source."""

    def __init__(self, *captures):
        self.captures = list(captures)

    def get(self, what):
        return self.captures[0].get(what)

    def read(self):
        good, image = self.captures[0].read()
        if not good and len(self.captures) > 1:
            self.captures.pop(0)
            return self.read()
        return good, image


def test_a_source_that_changes_its_size_is_one_sentence(tmp_path):
    small, large = (
        cv2.VideoCapture(
            str(
                write_matroska(
                    tmp_path / f"{n}.mkv", [cv2.resize(REST, size) + np.uint8(8 * k) for k in range(3)], [0, 40, 80]
                )
            )
        )
        for n, size in enumerate([(80, 60), (160, 120)])
    )
    film = iter(Film(Opened(small, large), 0, "camera 0", None, camera=True))
    assert [next(film).number for _ in range(3)] == [0, 1, 2]
    refused("camera 0: frames changed from 80 x 60 to 160 x 120 after 3 frames; set the size", next, film)


def test_a_camera_that_gives_its_last_frame_again_gives_none(tmp_path, monkeypatch):
    """`live` read -5.7 N of a free gel from the last frame of a press."""
    images = [REST, REST + np.uint8(8), REST + np.uint8(8), REST + np.uint8(8), REST + np.uint8(16)]
    path = write_matroska(tmp_path / "a.mkv", images, [0, 40, 80, 120, 160])
    with open_source(path, None) as (source, _):
        assert len(list(Film(source, 0, "camera 0", None, camera=True))) == 3
    with open_source(path, None) as (source, _):
        assert len(list(Film(source, 0, "film", None, camera=False))) == 5
    monkeypatch.setattr("gelforge.records.film.STILL_S", 0.0)
    with open_source(path, None) as (source, _):
        refused("camera 0: has given the same frame", list, Film(source, 0, "camera 0", None, camera=True))


def test_paths_that_the_decoder_cannot_open_are_one_sentence(tmp_path):
    """A byte that is no UTF-8 ended the process; an address was `no such video`."""
    folder = tmp_path / os.fsdecode(b"lab\xff")
    folder.mkdir()
    path = folder / "a.mkv"
    path.write_bytes(write_matroska(tmp_path / "a.mkv", [REST], [0, 40][:1], duration_ms=40).read_bytes())

    def opened(path):
        with open_source(path, None):
            pass

    refused("a byte that is no UTF-8", opened, path)
    refused("a network stream is not read", opened, Path("rtsp://lab/stream"))


def test_a_cameras_frames_have_the_time_at_which_they_came(tmp_path):
    """A film in its place, which says times of its own."""
    path = write_matroska(tmp_path / "a.mkv", [REST + np.uint8(8 * k) for k in range(4)], [0, 1000, 2000, 3000])
    started = time.perf_counter()
    with open_source(path, None) as (source, _):
        film = Film(source, 0, "camera 0", None, camera=True)
        found = list(film)
    assert film.taken == 4 and found[0].time_s == 0.0
    assert 0.0 < found[1].time_s < found[2].time_s < found[3].time_s < time.perf_counter() - started
