"""Prediction, live overlay, ONNX: the parts that people run, on small networks."""

import csv
import os
import signal
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelforge.commands import live, predict
from gelforge.commands.live_readings import readings, stopping, until
from gelforge.errors import BadInput
from gelforge.networks.inference.predictor import Predictor
from gelforge.networks.inference.sensorprofile import Gain, make_profile, write_profile
from gelforge.networks.uncertainty import ood
from gelforge.records.film import Frame
from gelforge.records.nocontactimage import FEWEST, SETTLING, STILL
from gelforge.reporting import forcemaps
from tests.benchmarks import real, real_page
from tests.support.films import write_film
from tests.support.limited import limited_python
from tests.support.small_networks import GRID, IMAGE
from tests.support.waiting import heed_interrupts


def write_png(path, image) -> Path:
    cv2.imwrite(str(path), cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2BGR))
    return path


def test_a_picture_calls_its_numbers_as_the_table_does(data, paths, tmp_path, monkeypatch):
    """A score that is explained nowhere helps nobody."""
    titles = []
    monkeypatch.setattr(
        forcemaps, "write_maps", lambda part, image, forces, title: titles.append((part.touch(), title))
    )
    image = write_png(tmp_path / "one.png", data.images[0])
    predict.main([str(image), "--model", str(paths["small"]), "--out", str(tmp_path / "out")])
    with (tmp_path / "out" / "totals.csv").open() as stream:
        (row,) = csv.DictReader(stream)
    ((_, title),) = titles
    assert title.startswith(f"one, OOD score {float(row['ood_score']):.1f}")


def test_predict_writes_maps_and_totals(data, models, paths, tmp_path, capsys):
    images = [write_png(tmp_path / f"{i}.png", data.images[i]) for i in range(2)]
    assert predict.main([*map(str, images), "--model", str(paths["small"]), "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "totals.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    for i, row in enumerate(rows):
        forces = np.load(tmp_path / "out" / f"{i}.npy")
        assert forces.shape == (3, *GRID)
        # totals.csv has four decimals.
        assert float(row["grid_z_n"]) == pytest.approx(forces[2].sum(), abs=1e-3)
        assert row["flagged"] == "0"
        assert row["map"] == f"{i}.npy" and (tmp_path / "out" / f"{i}.png").exists()
    lines = capsys.readouterr().out.splitlines()
    assert ["CROPPED" in line for line in lines[: len(rows)]] == [float(row["edge_peak"]) >= 0.2 for row in rows]


def test_predict_refuses_before_it_writes(data, paths, tmp_path):
    good = write_png(tmp_path / "good.png", data.images[0])
    (tmp_path / "bad.png").write_bytes(b"no picture")
    for bad, word in ((tmp_path / "bad.png", "cannot be read"), (tmp_path / "absent.png", "not found")):
        with pytest.raises(BadInput, match=word):
            predict.main([str(good), str(bad), "--model", str(paths["small"]), "--out", str(tmp_path / "out")])
    with pytest.raises(BadInput, match="digit"):
        predict.main([str(good), "--model", str(paths["small"]), "--sensor", "digit", "--out", str(tmp_path / "out")])
    with pytest.raises(
        BadInput, match=rf"{tmp_path}: is a folder; name the pictures in it, such as {tmp_path}/\*\.png"
    ):
        predict.main([str(tmp_path), "--model", str(paths["small"]), "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def loop(path: Path) -> str:
    """A link that leads to itself."""
    path.symlink_to(path.name)
    return str(path)


def test_a_link_that_leads_to_itself_is_named_wherever_it_is_given(data, paths, tmp_path):
    good, where = str(write_png(tmp_path / "good.png", data.images[0])), ["--model", str(paths["small"])]
    picture, film = loop(tmp_path / "loop.png"), loop(tmp_path / "loop.avi")
    for command, given in (
        (predict, [picture, "--out", str(tmp_path / "out")]),
        (predict, [good, "--nocontact", picture, "--out", str(tmp_path / "out")]),
        (live, ["--video", film, "--csv", str(tmp_path / "o.csv")]),
        (live, ["--video", str(write_avi(tmp_path / "f.avi", data.images[:12])), "--csv", film]),
    ):
        with pytest.raises(BadInput, match=r"loop\.\w+: cannot be .*symbolic links"):
            command.main([*given, *where])


def test_an_interrupted_call_leaves_no_table_of_an_earlier_one(data, paths, tmp_path, monkeypatch):
    image = write_png(tmp_path / "p.png", data.images[0])
    asked = [str(image), "--model", str(paths["small"]), "--out", str(tmp_path / "out")]
    assert predict.main(asked) == 0 and (tmp_path / "out/totals.csv").is_file()
    monkeypatch.setattr(predict.Predictor, "predict", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        predict.main(asked)
    assert not (tmp_path / "out/totals.csv").exists()


def test_who_interrupts_keeps_the_rows_of_what_was_read(data, paths, tmp_path):
    """A person who reads a hundred pictures and presses Ctrl-C at the second line."""
    image = write_png(tmp_path / "p.png", data.images[0])
    command = [sys.executable, "-m", "gelforge.commands.predict", *[str(image)] * 100]
    command += ["--model", str(paths["small"]), "--out", str(tmp_path / "out")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        preexec_fn=heed_interrupts,
    ) as child:  # fmt: skip
        assert child.stdout.readline() and child.stdout.readline()
        child.send_signal(signal.SIGINT)
        printed = 2 + len(child.stdout.readlines())
    assert child.returncode != 0
    with (tmp_path / "out" / "totals.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert printed <= len(rows) < 100
    assert all((tmp_path / "out" / f"p{'' if k == 0 else f'-{k + 1}'}.npy").exists() for k in range(len(rows)))


@pytest.mark.parametrize(
    "name, says",
    [
        ("film.avi", "is a film; `gelforge live --video"),
        ("empty.png", "is empty"),
        ("a.png", "cannot be read as an image .of another kind"),
    ],
)
def test_predict_says_what_it_was_given_in_place_of_a_picture(tmp_path, paths, name, says):
    (tmp_path / name).write_bytes(b"" if says == "is empty" else b"no picture")
    with pytest.raises(BadInput, match=says):
        predict.main([str(tmp_path / name), "--model", str(paths["small"]), "--out", str(tmp_path / "out")])


def test_a_name_too_long_for_any_file_is_one_line(data, paths, tmp_path, capsys):
    """A picture may have the longest name that there is; that of its map is longer."""
    image = write_png(tmp_path / f"{'a' * 250}.png", data.images[0])
    with pytest.raises(SystemExit) as ended:
        predict.main.exit([str(image), "--model", str(paths["small"]), "--out", str(tmp_path / "out")])
    reported = capsys.readouterr().err
    assert ended.value.code == 2 and reported.count("\n") == 1 and "File name too long; give another name" in reported
    with pytest.raises(BadInput, match="File name too long"):
        predict.main([f"{'a' * 300}.png", "--model", str(paths["small"]), "--out", str(tmp_path / "out")])


@pytest.mark.parametrize("name, says", [("", "it is a folder"), ("gone.avi", "no such video")])
def test_what_is_no_film_is_reported(tmp_path, paths, name, says):
    with pytest.raises(BadInput, match=f"{says}.*name an AVI or MP4 file"):
        live.main(["--video", str(tmp_path / name), "--model", str(paths["small"]), "--csv", str(tmp_path / "o.csv")])


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


def test_a_network_that_compares_with_a_nocontact_image_asks_for_it(data, paths, tmp_path):
    image = write_png(tmp_path / "p.png", data.images[0])
    with pytest.raises(BadInput, match="give it with --nocontact"):
        predict.main([str(image), "--model", str(paths["pair"]), "--out", str(tmp_path / "out")])


def test_two_images_of_one_name_keep_apart():
    assert predict.output_names(["a/x.png", "b/x.png", "y.png"]) == ["x", "x-2", "y"]
    names = predict.output_names(["l/0.png", "r/0.png", "0-2.png", "m/0.png"])
    assert len(set(names)) == 4 and names[:2] == ["0", "0-2"]


def test_predict_never_takes_the_place_of_what_it_reads(data, paths, tmp_path):
    image = write_png(tmp_path / "p.png", data.images[0])
    before = image.read_bytes()
    with pytest.raises(BadInput, match="would take the place"):
        predict.main([str(image), "--model", str(paths["small"]), "--out", str(tmp_path)])
    assert image.read_bytes() == before and [path.name for path in tmp_path.iterdir()] == ["p.png"]


def test_no_table_of_totals_takes_the_place_of_what_is_read(data, paths, tmp_path):
    image = write_png(tmp_path / "p.png", data.images[0]).rename(tmp_path / "totals.csv")
    with pytest.raises(BadInput, match="totals.csv would take the place of a file that is read"):
        predict.main([str(image), "--model", str(paths["small"]), "--out", str(tmp_path)])


def test_no_map_takes_the_place_of_the_nocontact_image(data, paths, tmp_path):
    for folder in ("shots", "kept"):
        (tmp_path / folder).mkdir()
    image, rest = (write_png(tmp_path / f"{name}/nocontact.png", data.images[0]) for name in ("shots", "kept"))
    before = rest.read_bytes()
    asked = [str(image), "--nocontact", str(rest), "--model", str(paths["small"]), "--out", str(rest.parent)]
    with pytest.raises(BadInput, match="would take the place"):
        predict.main(asked)
    assert rest.read_bytes() == before


def test_any_name_of_a_file_is_only_a_name(data, paths, tmp_path):
    """Not a formula, and not text that every table can hold."""
    names = ["p$_$q.png", os.fsdecode(b"a\xff.png")]
    images = [
        write_png(tmp_path / f"{k}.png", data.images[0]).rename(tmp_path / name) for k, name in enumerate(names)
    ]
    predict.main([*map(str, images), "--model", str(paths["small"]), "--out", str(tmp_path / "out")])
    with (tmp_path / "out" / "totals.csv").open() as stream:
        assert [Path(row["image"]).name for row in csv.DictReader(stream)] == ["p$_$q.png", r"a\udcff.png"]


def test_unlike_images_are_flagged(data, models):
    predictor = Predictor(models["small"].model)
    assert not any(predictor.predict(data.images[row]).flag for row in data.splits["test"])
    black = np.zeros((*IMAGE, 3), np.uint8)
    plain = np.full((*IMAGE, 3), 120, np.uint8)
    wider = cv2.resize(np.asarray(data.images[0]), (160, 96))
    for image, reason in (
        (black, "monochrome"),
        (plain, "monochrome"),
        (data.images[0][..., ::-1] // 3, "unlike the training images in its "),
        (wider, "of another shape"),
    ):
        found = predictor.predict(image)
        assert found.flag and reason in found.reason


def read_frames(path) -> list[np.ndarray]:
    source, images = cv2.VideoCapture(str(path)), []
    while True:
        good, frame = source.read()
        if not good:
            return images
        images.append(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))


def test_markers_of_real_sensors_are_counted(reference):
    image = cv2.imread(str(reference / "feats" / "images" / "cuboid_10-2-284.png"))
    # 7 x 9 markers, two of which lie at the rim.
    assert ood.count_markers(ood.grey_of(cv2.split(image)))[0] == pytest.approx(63, abs=4)
    assert ood.count_markers(ood.grey_of(cv2.split(cv2.medianBlur(image, 61))))[0] <= 3


def test_score_separates_real_sensors(reference):
    videos = {
        name: read_frames(reference / "slip_videos" / f"{name}.avi")
        for name in ("cheese_tube_camera_0", "cheese_tube_camera_2", "glass_box_camera_0")
    }
    own = np.stack([ood.describe(image) for image in videos["cheese_tube_camera_0"]])
    model = ood.fit(own[::2], own[1::4])
    assert not any(ood.score(model, row) > model["threshold"] for row in own[3::4])
    image = videos["cheese_tube_camera_0"][0]
    feats = cv2.cvtColor(cv2.imread(str(reference / "feats" / "images" / "cuboid_10-2-284.png")), cv2.COLOR_BGR2RGB)
    unlike = {
        "black": np.zeros_like(image),
        "no markers": cv2.medianBlur(image, 61),
        "red and blue swapped": image[..., ::-1],
        "other sensor": videos["cheese_tube_camera_2"][0],
        "FEATS' sensor": feats,
    }
    assert [
        name for name, other in unlike.items() if not ood.pair_score_fault(model, np.ascontiguousarray(other))[1]
    ] == []


def write_avi(path, images) -> Path:
    return write_film(path, (np.asarray(image)[..., ::-1] for image in images))


def test_live_overlays_a_video(data, paths, tmp_path, capsys):
    video = write_avi(tmp_path / "in.avi", data.images[:12])
    out = tmp_path / "out.avi"
    assert live.main(["--video", str(video), "--model", str(paths["small"]), "--out", str(out)]) == 0
    frames = read_frames(out)
    assert len(frames) == 12 and frames[0].shape[1] == 2 * IMAGE[1]
    assert "12 frames" in capsys.readouterr().out


def test_live_refuses_what_it_would_not_write(data, paths, tmp_path):
    video = write_avi(tmp_path / "in.avi", data.images[:12])
    asked = ["--video", str(video), "--model", str(paths["small"])]
    for more in (["--csv", "r.csv", "--out", "o.avi"], ["--web", "--jsonl", "r.jsonl"], ["--web", "--out", "o.avi"]):
        with pytest.raises(BadInput, match="do not go together"):
            live.main([*asked, *more])
    for both in (str(tmp_path / "r"), "-"):  # lines and rows mixed are neither
        with pytest.raises(BadInput, match="name two files"):
            live.main([*asked, "--jsonl", both, "--csv", both])
    before = video.read_bytes()
    with pytest.raises(BadInput, match="would take the place"):
        live.main([*asked, "--out", str(video)])
    assert video.read_bytes() == before


@pytest.mark.parametrize("while_reading", [False, True])
def test_an_interrupt_keeps_what_was_filmed_and_read(data, models, tmp_path, while_reading):
    """Wherever it comes: while a frame is awaited, or while one is read."""
    overlay, seen = live.Overlay(Predictor(models["small"].model)), [0]

    def interrupt(here: bool) -> None:
        if here == while_reading and seen[0] == 4:
            os.kill(os.getpid(), signal.SIGINT)

    def images():
        for image in data.images[:8]:
            seen[0] += 1
            interrupt(False)
            yield cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2BGR)

    def overlaid(frame):
        interrupt(True)
        return overlay(frame)

    before = signal.getsignal(signal.SIGINT)
    with stopping() as over:
        written = live.write_video((overlaid(frame) for frame in until(over, images())), tmp_path / "o.avi", 25.0)
    assert written == 3 + while_reading and len(read_frames(tmp_path / "o.avi")) == written
    assert signal.getsignal(signal.SIGINT) is before


def test_a_film_of_no_frames_is_not_written(tmp_path):
    with pytest.raises(BadInput, match="before the first frame"):
        live.write_video(iter(()), tmp_path / "none.avi", 25.0)
    assert not list(tmp_path.iterdir())


WRITES_A_FILM = """
import sys
from pathlib import Path
import numpy as np
from gelforge.commands.live import write_video

rng = np.random.default_rng(0)
write_video((rng.integers(0, 255, (120, 160, 3), np.uint8) for _ in range(60)), Path(sys.argv[1]), 25.0)
"""


def test_a_film_for_which_there_is_no_room_is_refused_whole(tmp_path):
    """OpenCV says nothing, and what it has written looks like a film."""
    ran = limited_python(200, "-c", WRITES_A_FILM, tmp_path / "o.avi")
    assert "BadInput" in ran.stderr and "a film of 60 frames could not be written whole; free space" in ran.stderr, (
        ran.stderr
    )
    assert not list(tmp_path.iterdir())


def cut_film(path: Path, images) -> Path:
    """A film of a camera that lost its power: its head announces more frames than there are."""
    write_avi(path, images)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    return path


@pytest.mark.parametrize("face", ["out", "csv", "jsonl"])
def test_a_film_that_is_cut_is_read_as_far_as_it_goes_into_a_folder_of_its_own(data, paths, tmp_path, capsys, face):
    """Rows were kept and a film was thrown away; the one made its folder, the others refused."""
    video = cut_film(tmp_path / "in.avi", data.images[:24])
    out = tmp_path / "new" / "folder" / f"o.{'avi' if face == 'out' else face}"
    with pytest.raises(BadInput, match="in.avi: ended after .* of 24 frames; the file is cut short"):
        live.main(["--video", str(video), "--model", str(paths["small"]), f"--{face}", str(out)])
    if face == "out":
        kept = len(read_frames(out))
        assert f"o.avi: kept, and ends after {kept} frames" in capsys.readouterr().out
    else:
        kept = len(out.read_text().splitlines()) - (face == "csv")
    assert 1 <= kept < 24


@pytest.mark.parametrize("face", ["out", "csv", "jsonl"])
def test_a_file_in_the_place_of_a_folder_is_one_sentence(data, paths, tmp_path, face):
    video = write_avi(tmp_path / "in.avi", data.images[:2])
    with pytest.raises(BadInput, match="o.avi: its folder cannot be made"):
        live.main(["--video", str(video), "--model", str(paths["small"]), f"--{face}", str(video / "o.avi")])


def test_the_film_names_axes_as_everything_else_does():
    """x is force along gel x, the channel grid_y."""
    forces = np.zeros((3, *GRID), np.float32)
    forces[:, 0, 0] = 1.0, 2.0, -3.0
    assert live.force_line(forces).split() == ["x", "+2.00", "y", "+1.00", "z", "-3.00", "N"]
    lines = real_page.total_lines(np.array([1.0, 2.0, -3.0]), np.array([0.1, 0.2, 0.3]))
    assert lines == ["z -3.0 +- 0.3 N", "x +2.00 +- 0.2  y +1.00 +- 0.1 N"]


def test_a_folder_without_real_pictures_is_named_with_what_it_lacks(tmp_path):
    with pytest.raises(
        BadInput,
        match=f"{tmp_path}: holds no gripper_videos/.*avi and no feats/images/.*gif and no balls/unit_a/.*png; .*REFERENCE=FOLDER",
    ):
        real.main(["--reference", str(tmp_path)])
    (tmp_path / "gripper_videos").mkdir()
    (tmp_path / "gripper_videos/a.avi").touch()
    with pytest.raises(BadInput, match="holds no feats/images/.*gif and no balls"):
        real.main(["--reference", str(tmp_path)])


def test_live_takes_the_first_frames_at_rest_for_the_nocontact_image(data, models, paths, tmp_path):
    """The first ones are brighter, as of a camera that still sets its exposure."""
    rest = data.nocontact["mini0"]
    exposing = [np.clip(rest * (1.5 - 0.06 * k), 0, 255).astype(np.uint8) for k in range(8)]
    seen = [*exposing, *[rest] * 6, *data.images[:3]]
    video = write_avi(tmp_path / "in.avi", seen)
    live.main(["--video", str(video), "--model", str(paths["pair"]), "--out", str(tmp_path / "o.avi")])
    filmed = read_frames(video)
    overlay = live.Overlay(Predictor(models["pair"].model, filmed[10]))
    expected = overlay(cv2.cvtColor(filmed[-1], cv2.COLOR_RGB2BGR))
    got = read_frames(tmp_path / "o.avi")
    assert len(got) == len(seen) - SETTLING
    # the video is compressed; the lines with times differ
    assert np.median(np.abs(got[-1].astype(int) - expected[..., ::-1])) <= 2


def test_live_reads_against_the_picture_of_a_profile(data, models, paths, tmp_path):
    """As `predict` does: a film may begin while something is held, and stays still then, too."""
    profile = make_profile("mine", data.nocontact["mini0"], 30.0, Gain(), models["pair"].metadata)
    write_profile(tmp_path / "mine.toml", profile)
    args = Namespace(profile=tmp_path / "mine.toml", sensor=None, device="cpu", threads=1)
    held = cv2.cvtColor(data.images[0], cv2.COLOR_RGB2BGR)
    found, seen = live.predictor_of(args, models["pair"].model, None, iter([held] * 20), "held.avi")
    np.testing.assert_array_equal(found.prepare.nocontact.sized, data.nocontact["mini0"])
    assert len(list(seen)) == 20


def test_live_refuses_fewer_frames_than_give_the_nocontact_image(data, paths, tmp_path):
    rest = data.nocontact["mini0"]
    video, out = write_avi(tmp_path / "in.avi", [rest] * (FEWEST + 3)), tmp_path / "o.avi"
    words = ["--video", str(video), "--model", str(paths["pair"]), "--out", str(out)]
    with pytest.raises(BadInput, match=f"--frames {FEWEST - 1}: .* {FEWEST} at least.*--nocontact"):
        live.main([*words, "--frames", str(FEWEST - 1)])
    assert not out.exists()
    live.main([*words, "--frames", str(FEWEST)])
    assert len(read_frames(out)) == STILL
    cv2.imwrite(str(tmp_path / "rest.png"), rest)
    live.main([*words, "--frames", "3", "--nocontact", str(tmp_path / "rest.png")])
    assert len(read_frames(out)) == 3


def test_live_lets_go_of_what_films_where_it_refuses_to_read(data, paths, tmp_path):
    """A camera that stays open is refused to the next program that asks for it."""
    video = write_avi(tmp_path / "in.avi", data.images[:24])
    with pytest.raises(
        BadInput, match="without movement.*--nocontact"
    ) as refused:  # keeps alive what the command still holds
        live.main(["--video", str(video), "--model", str(paths["pair"]), "--out", str(tmp_path / "o.avi")])
    held = [each.resolve() for each in Path("/proc/self/fd").iterdir()]
    assert refused.tb and video.resolve() not in held


def test_live_on_a_real_video(reference, paths, tmp_path, capsys):
    video = reference / "slip_videos" / "plier_camera_2.avi"
    live.main(
        ["--video", str(video), "--model", str(paths["small"]), "--frames", "5", "--out", str(tmp_path / "o.avi")]
    )
    assert "5 flagged" in capsys.readouterr().out


def test_films_that_hold_nothing_leave_nothing_behind(paths, tmp_path):
    (tmp_path / "no.avi").write_bytes(b"not a video")
    out = tmp_path / "out" / "o.avi"
    for name in ("no", "absent"):
        with pytest.raises(BadInput, match=name):
            live.main(["--video", str(tmp_path / f"{name}.avi"), "--model", str(paths["small"]), "--out", str(out)])
    assert not out.parent.exists()


def test_camera_that_is_not_there_is_named(paths):
    with pytest.raises(BadInput, match="camera 97"):
        live.main(["--camera", "97", "--model", str(paths["small"]), "--out", "unused.avi"])


def test_live_flags_the_frames_that_predict_flags(models, data):
    """In its lines and on its page, with the same words."""
    frames = [np.ascontiguousarray(data.images[0]), np.zeros((*IMAGE, 3), np.uint8)]
    predictor = Predictor(models["small"].model)
    judged = [predictor.predict(frame) for frame in frames]
    reported = list(readings(predictor, [Frame(k, 0.04 * k, frame[..., ::-1]) for k, frame in enumerate(frames)]))
    for lines in ([reading.row() for reading in reported], [reading.event() for reading in reported]):
        assert [line["flag"] for line in lines] == [one.flag for one in judged] == [False, True]
        assert [line["reason"] for line in lines] == [one.reason for one in judged]


def test_a_film_has_the_time_of_its_frames(data, models):
    times = [0.0, 0.04, 2.13]
    frames = [Frame(k, time, np.ascontiguousarray(data.images[0])) for k, time in enumerate(times)]
    predictor = Predictor(models["small"].model)
    assert [reading.time_s for reading in readings(predictor, frames)] == times
