"""Live reading on small networks."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelforge.commands import live
from gelforge.errors import BadInput
from gelforge.live.reading import readings
from gelforge.reading.profile import Gain, make_profile, write_profile
from gelforge.reading.reader import Reader
from gelforge.records.film import Frame
from gelforge.records.nocontactimage import FEWEST, SETTLING, STILL
from tests.support.films import write_film
from tests.support.refused import refused
from tests.support.small_networks import IMAGE


@pytest.mark.processes
def test_a_corrupt_film_is_reported_by_one_line_and_not_by_its_decoder(data, tmp_path):
    """The decoder printed a line for each block that it could not make out, thousands of them."""
    noise = np.random.default_rng(0).integers(0, 256, (30, *data.images.shape[1:]), np.uint8)
    film = write_film(tmp_path / "f.mp4", noise)
    content = bytearray(film.read_bytes())
    content[len(content) // 3 : len(content) // 2] = bytes(len(content) // 2 - len(content) // 3)
    film.write_bytes(content)
    program = (
        "import sys; from pathlib import Path; from gelforge.records.film import frames, open_source\n"
        "with open_source(Path(sys.argv[1]), None) as (source, _): print(len(list(frames(source, 0, 'f', None))))"
    )
    run = [sys.executable, "-c", program, str(film)]
    quiet = subprocess.run(run, capture_output=True, text=True, check=True)
    asked = {"env": os.environ | {"OPENCV_FFMPEG_LOGLEVEL": "24"}}
    reported = subprocess.run(run, capture_output=True, text=True, check=True, **asked)
    assert quiet.stderr == "" and quiet.stdout.count("\n") == 1 < reported.stdout.count("\n")


def read_frames(path) -> list[np.ndarray]:
    source, images = cv2.VideoCapture(str(path)), []
    while True:
        good, frame = source.read()
        if not good:
            return images
        images.append(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))


def write_avi(path, images) -> Path:
    return write_film(path, (np.asarray(image)[..., ::-1] for image in images))


def test_a_film_that_is_cut_is_read_as_far_as_it_goes_into_a_folder_of_its_own(data, paths, tmp_path):
    video, out = write_avi(tmp_path / "in.avi", data.images[:24]), tmp_path / "new" / "folder" / "o.csv"
    whole = video.read_bytes()
    video.write_bytes(whole[: len(whole) // 2])  # its head announces more frames than there are
    words = ["--video", str(video), "--model", str(paths["unet"]), "--csv", str(out)]
    refused("in.avi: ended after .* of 24 frames; the file is cut short", live.main, words)
    assert 1 <= len(rows_of(out)) < 24


def rows_of(table) -> list[dict]:
    with table.open() as stream:
        return list(csv.DictReader(stream))


def test_live_takes_the_first_frames_at_rest_for_the_nocontact_image(data, models, paths, tmp_path):
    """The first ones are brighter, as of a camera that still sets its exposure."""
    rest = data.nocontact["mini0"]
    exposing = [np.clip(rest * (1.5 - 0.06 * k), 0, 255).astype(np.uint8) for k in range(8)]
    seen = [*exposing, *[rest] * 6, *data.images[:3]]
    video, table = write_avi(tmp_path / "in.avi", seen), tmp_path / "o.csv"
    live.main(["--video", str(video), "--model", str(paths["pair"]), "--csv", str(table)])
    filmed, rows = read_frames(video), rows_of(table)
    assert len(rows) == len(seen) - SETTLING
    found = Reader(filmed[10], model=models["pair"].model)(filmed[-1])
    # the film is compressed, so the mean of the frames at rest is not quite one of them
    assert float(rows[-1]["fz_n"]) == pytest.approx(found.total[2], rel=0.02, abs=0.02)


def test_live_reads_against_the_picture_of_a_profile(data, models, paths, tmp_path):
    """As `predict` does: a film may begin while something is held, and stays still then, too."""
    profile = make_profile("mine", data.nocontact["mini0"], 30.0, Gain(), models["pair"].metadata)
    write_profile(tmp_path / "mine.toml", profile)
    video, table = write_avi(tmp_path / "held.avi", [data.images[0]] * 20), tmp_path / "o.csv"
    profile = ["--profile", str(tmp_path / "mine.toml"), "--model", str(paths["pair"])]
    live.main(["--video", str(video), *profile, "--csv", str(table)])
    rows, reader = rows_of(table), Reader(data.nocontact["mini0"], model=models["pair"].model)
    assert len(rows) == 20
    assert float(rows[0]["fz_n"]) == pytest.approx(reader(read_frames(video)[0]).total[2], abs=1e-3)


def test_live_refuses_fewer_frames_than_give_the_nocontact_image(data, paths, tmp_path):
    rest = data.nocontact["mini0"]
    video, out = write_avi(tmp_path / "in.avi", [rest] * (FEWEST + 3)), tmp_path / "o.csv"
    words = ["--video", str(video), "--model", str(paths["pair"]), "--csv", str(out)]
    few = [*words, "--frames", str(FEWEST - 1)]
    refused(f"--frames {FEWEST - 1}: .* {FEWEST} at least.*--nocontact", live.main, few)
    assert not out.exists()
    live.main([*words, "--frames", str(FEWEST)])
    assert len(rows_of(out)) == STILL
    out.unlink()
    cv2.imwrite(str(tmp_path / "rest.png"), rest)
    live.main([*words, "--frames", "3", "--nocontact", str(tmp_path / "rest.png")])
    assert len(rows_of(out)) == 3


def test_live_lets_go_of_what_films_where_it_refuses_to_read(data, paths, tmp_path):
    """A camera that stays open is refused to the next program that asks for it."""
    video = write_avi(tmp_path / "in.avi", data.images[:24])
    with pytest.raises(
        BadInput, match="without movement.*--nocontact"
    ) as refused:  # keeps alive what the command still holds
        live.main(["--video", str(video), "--model", str(paths["pair"]), "--csv", str(tmp_path / "o.csv")])
    held = [each.resolve() for each in Path("/proc/self/fd").iterdir()]
    assert refused.tb and video.resolve() not in held


def test_live_flags_the_frames_that_predict_flags(models, data):
    """In its lines and on its page, with the same words."""
    frames = [np.ascontiguousarray(data.images[0]), np.zeros((*IMAGE, 3), np.uint8)]
    predictor = Reader(model=models["unet"].model)
    judged = [predictor(frame) for frame in frames]
    reported = list(readings(predictor, [Frame(k, 0.04 * k, frame[..., ::-1]) for k, frame in enumerate(frames)]))
    for lines in ([reading.row() for reading in reported], [reading.event() for reading in reported]):
        assert [line["flag"] for line in lines] == [one.flag for one in judged] == [False, True]
        assert [line["reason"] for line in lines] == [one.reason for one in judged]


def test_what_is_no_film_is_refused_and_leaves_nothing_behind(data, paths, tmp_path):
    good = write_avi(tmp_path / "good.avi", data.images[:12])
    (tmp_path / "no.avi").write_bytes(b"not a video")
    (tmp_path / "loop.avi").symlink_to("loop.avi")
    words = ["--model", str(paths["unet"]), "--csv"]
    for name, said in (
        ("", "it is a folder.*name an AVI or MP4 file"),
        ("gone.avi", "no such video.*name an AVI or MP4 file"),
        ("no.avi", "no.avi"),
        ("loop.avi", r"loop\.avi: cannot be .*symbolic links"),
    ):
        refused(said, live.main, ["--video", str(tmp_path / name), *words, str(tmp_path / "out/o.csv")])
    refused(r"loop\.avi: cannot be", live.main, ["--video", str(good), *words, str(tmp_path / "loop.avi")])
    refused("camera 97", live.main, ["--camera", "97", *words, str(tmp_path / "out/o.csv")])
    assert not (tmp_path / "out").exists()
