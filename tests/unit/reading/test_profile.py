"""A sensor's profile: the factor from readings, files that come back, and what is refused."""

import csv
import io
import os
import shutil

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.commands import predict, sensor
from gelforge.errors import GelforgeError
from gelforge.formats.featsfile import read_npy
from gelforge.live.weigh import GRAMS, Weighing, weigh_camera
from gelforge.reading.frame import reduced
from gelforge.reading.markers import markers_in
from gelforge.reading.model import load_model
from gelforge.reading.profile import (
    Gain,
    SensorProfile,
    check_same_sensor,
    fit_gain,
    make_profile,
    read_profile,
    with_profile,
    write_profile,
)
from gelforge.reading.reader import Reader
from gelforge.records.film import Frame
from gelforge.records.image import read_image
from gelforge.records.nocontactimage import FEWEST
from tests.support.feats_film import feats_maps
from tests.support.films import write_film
from tests.support.refused import refused


@given(st.floats(0.5, 2.0), st.integers(1, 20), st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_units_and_sign_of_a_factor(factor, count, seed):
    """Forces measured `factor` times as large move the estimate by as much, but for the prior's pull towards 1."""
    read = np.random.default_rng(seed).uniform(3.0, 30.0, count)
    gain = fit_gain(factor * read, read)
    assert gain.low < gain.value < gain.high and gain.readings == count
    assert min(1.0, factor) - 0.01 <= gain.value <= max(1.0, factor) + 0.01
    # two or three readings leave the scale's zero open, which moves the estimate by up to 0.7 % in an interval of 40 %
    assert abs(np.log(gain.value) - np.log(factor)) <= 1.3 * abs(np.log(factor)) / (1 + count) + 0.01


def test_the_interval_holds_what_it_says():
    """Over 600 made sensors of 15 % softer to harder gels and 5 readings each: nine in ten, within chance; too wide is safe."""
    for scatter in (0.03, 0.2):
        rng, inside, left = np.random.default_rng(3), 0, []
        for _ in range(600):
            truth = np.exp(rng.normal(0.0, 0.15))
            read = rng.uniform(3.0, 30.0, 5)
            gain = fit_gain(truth * read * np.exp(rng.normal(0.0, scatter, 5)), read)
            inside += gain.low <= truth <= gain.high
            left.append(abs(np.log(gain.value / truth)))
        assert inside / 600 >= 0.86, scatter
        assert np.median(left) < 1.2 * 0.6745 * np.hypot(scatter / np.sqrt(5), 0.02), scatter
    widths = []
    for count in (0, 1, 2, 5, 10, 20):  # more readings narrow it
        read = rng.uniform(5.0, 30.0, count)
        gain = fit_gain(1.1 * read, read)
        widths.append(np.log(gain.high / gain.low))
    assert widths == sorted(widths, reverse=True) and widths[-1] < 0.3 * widths[0]


@pytest.mark.parametrize("offset", [0.0, 2.0, 6.0, [0.0, 0.4, 0.8, 1.2, 1.6]], ids=["tared", "2 N", "6 N", "drifts"])
def test_a_scale_that_was_not_tared_widens_the_interval_that_holds_the_factor(offset):
    """Five readings of 300 made sensors, whose readings scatter by a tenth: the interval holds the truth in nine of ten, within chance.

    So it does where the scale drifts, which so few readings cannot tell.
    """
    rng, inside = np.random.default_rng(3), 0
    for _ in range(300):
        truth, read = np.exp(rng.normal(0.0, 0.15)), rng.uniform(3.0, 30.0, 5)
        gain = fit_gain(truth * read * np.exp(rng.normal(0.0, 0.1, 5)) + np.array(offset), read)
        inside += gain.low <= truth <= gain.high
    assert inside / 300 >= 0.85


def test_a_reading_says_the_less_the_weaker_it_is():
    """The error of a network where hardly anything touches is a large part of what it reads there."""
    read = np.array([8.0, 12.0, 20.0])
    weak, strong = (
        [fit_gain(np.append(read, 2 * one), np.append(read, one)).value for one in some]
        for some in ((0.1, 0.5), (20.0,))
    )
    assert max(weak) < 1.01 and strong[0] > 1.1


NET = {"name": "net", "sha256": "ab" * 32}


def test_a_profile_comes_back_from_its_file(demo_nocontact, tmp_path):
    picture = demo_nocontact["mini_a"]
    profile = make_profile("mine", picture, markers_in(picture).pitch, Gain(1.2, 1.1, 1.3, 5), NET)
    write_profile(tmp_path / "mine \U0001f916.toml", profile)
    found = read_profile(tmp_path / "mine \U0001f916.toml")
    np.testing.assert_array_equal(found.nocontact, picture)
    assert (found.name, found.date, found.gain, found.model) == ("mine", profile.date, profile.gain, "net")
    assert found.pitch == pytest.approx(profile.pitch, abs=1e-3) and 25 < found.pitch < 40
    check_same_sensor(found, found.pitch)
    larger = cv2.resize(picture, None, fx=1.2, fy=1.2)[24:264, 32:352]
    refused("another sensor, or cropped or scaled", check_same_sensor, found, markers_in(larger).pitch)
    # a factor holds for the network that it was found with; weights identify networks, not names
    retrained = NET | {"sha256": "12" * 32}
    assert with_profile(found, None, NET)[1] == profile.gain
    refused("another network.*gelforge sensor", with_profile, found, None, retrained)
    write_profile(tmp_path / "mine.toml", make_profile("mine", picture, markers_in(picture).pitch, Gain(), NET))
    assert (
        with_profile(read_profile(tmp_path / "mine.toml"), None, retrained)[1].value == 1.0
    )  # no factor, so none that is wrong


def test_a_profile_knows_its_sensor_in_the_camera_s_own_size(demo_nocontact, shipped, tmp_path):
    """A profile keeps a picture of at most 640 px: the same sensor at 1280 px is no other one."""
    large = cv2.resize(demo_nocontact["mini_a"], (1280, 960), interpolation=cv2.INTER_CUBIC)
    small = reduced(large)
    write_profile(
        tmp_path / "own.toml", make_profile("own", small, markers_in(small).pitch, Gain(), shipped.metadata)
    )
    assert with_profile(read_profile(tmp_path / "own.toml"), large, shipped.metadata)[0] is large


def test_a_factor_of_another_unit_is_refused_and_one_of_a_gel_that_was_seated_again_holds(
    demo_nocontact, shipped, tmp_path
):
    """Forces of 20 N were read as 32, not flagged: units of one batch have the same marker pitch."""
    path = tmp_path / "own.toml"
    for name, picture in demo_nocontact.items():
        write_profile(
            path, make_profile(name, picture, markers_in(picture).pitch, Gain(1.6, 1.5, 1.7, 5), shipped.metadata)
        )
        seated = cv2.getRotationMatrix2D((160.0, 120.0), 0.5, 1.0) + [[0, 0, 3.0], [0, 0, -2.0]]
        again = cv2.warpAffine(picture, seated, (320, 240), borderMode=cv2.BORDER_REPLICATE)
        for same in (picture, again):
            assert Reader(same, path, shipped).gain.value == 1.6
        for other in demo_nocontact.keys() - {name}:
            said = f"that of profile {name}, whose factor is 1.6: .*`gelforge sensor`|of another sensor, or cropped"
            refused(said, Reader, demo_nocontact[other], path, shipped)


def test_what_is_no_profile_is_refused(tmp_path):
    path, good = tmp_path / "a.toml", np.zeros((24, 32, 3), np.uint8)
    write_profile(path, SensorProfile("a", "2026-01-01", good, 32.0, Gain(), "m", "n"))
    lines = path.read_text().splitlines()
    for line in (f"pitch_px = {10**400}", "pitch_px = -32.0", "name = 3", "value = -1",
                 'nocontact = ""', r'nocontact = "a\u0000.png"', 'nocontact = "../a.png"'):  # fmt: skip
        key = line.split(" = ")[0]
        assert any(text.startswith(f"{key} = ") for text in lines)
        path.write_text("\n".join(line if text.startswith(f"{key} = ") else text for text in lines))
        refused("lies beside" if key == "nocontact" else "not a sensor's profile", read_profile, path)
    path.write_text("")
    refused("not a sensor's profile", read_profile, path)
    (tmp_path / "mine.png").mkdir()
    with pytest.raises(GelforgeError, match=r"/mine\.png: the image could not be written"):
        write_profile(tmp_path / "mine.toml", make_profile("mine", good, 0.0, Gain(), NET))


@pytest.fixture
def weighed(root, tmp_path):
    """Presses of the demo as if they had been weighed on a sensor whose gel is a fifth stiffer; (folder, table's rows).

    None of its bar, which is longer than the view.
    """
    rows = []
    with (root / "data/demo/log.csv").open() as stream:
        for row in list(csv.DictReader(stream))[:8]:
            if row["sensor_id"] == "mini_a" and row["indenter"] != "bar_5" and float(row["fz_n"]) < -2.0:
                (tmp_path / row["sample_id"]).with_suffix(".png").write_bytes(
                    (root / "data/demo" / row["image"]).read_bytes()
                )
                rows.append([f"{row['sample_id']}.png", f"{-1.2 * float(row['fz_n']):.3f}"])
    (tmp_path / "rest.png").write_bytes((root / "data/demo/nocontact/mini_a.png").read_bytes())
    assert len(rows) >= 3
    return tmp_path, rows


def table(path, rows):
    path.write_text("\n".join(["image,force_n", *(",".join(row) for row in rows)]) + "\n")
    return path


def make(folder, rows, *more):
    readings = ["--readings", str(table(folder / "r.csv", rows))]
    out = ["--out", str(folder / "mine.toml")]
    return sensor.main(["--name", "mine", "--nocontact", str(folder / "rest.png"), *readings, *out, *more])


def test_weighed_presses_make_a_profile_that_predict_uses(weighed, capsys):
    folder, rows = weighed
    assert make(folder, rows) == 0
    gain = read_profile(folder / "mine.toml").gain
    assert gain.readings == len(rows)
    pictures = [str(folder / row[0]) for row in rows]
    predict.main([*pictures, "--out", str(folder / "all"), "--nocontact", str(folder / "rest.png")])
    with (folder / "all/totals.csv").open() as stream:
        read = [-float(row["fz_n"]) for row in csv.DictReader(stream)]
    assert gain.low < np.median([float(row[1]) for row in rows] / np.array(read)) < gain.high
    totals = []
    for more in (["--nocontact", str(folder / "rest.png")], ["--profile", str(folder / "mine.toml")]):
        predict.main([str(folder / rows[0][0]), "--out", str(folder / "out"), *more])
        with (folder / "out/totals.csv").open() as stream:
            totals.append(float(next(csv.DictReader(stream))["fz_n"]))
    assert totals[1] / totals[0] == pytest.approx(gain.value, rel=1e-3)


def test_a_profile_that_was_weighed_is_not_replaced_by_one_that_was_not(weighed, capsys):
    """Also where its picture is gone. One that is weighed again takes its place, and says so."""
    folder, rows = weighed
    asked = ["--name", "mine", "--nocontact", str(folder / "rest.png"), "--out", str(folder / "mine.toml")]
    assert sensor.main(asked) == 0 and sensor.main(asked) == 0
    assert make(folder, rows) == 0
    reported = (folder / "mine.toml").read_text()
    for gone in ([], [folder / "mine.png"]):
        for path in gone:
            path.unlink()
        refused(f"comes from {len(rows)} readings.* remove .*mine.toml", sensor.main, asked)
        assert (folder / "mine.toml").read_text() == reported
    assert make(folder, rows[:-1]) == 0
    assert read_profile(folder / "mine.toml").gain.readings == len(rows) - 1
    assert f"from {len(rows) - 1} readings, in place of" in capsys.readouterr().out


def test_a_reading_that_cannot_be_right_is_named_by_its_picture(weighed, capsys):
    """One that is three times what the others give, as of a scale that was read wrongly; one that predict would flag."""
    folder, rows = weighed
    assert make(folder, rows) == 0
    said = capsys.readouterr().err
    assert "the usual ratio here" not in said and "FLAGGED" not in said
    make(folder, [[rows[0][0], f"{3 * float(rows[0][1]):.2f}"], *rows[1:]])
    reported = [line for line in capsys.readouterr().err.splitlines() if "the usual ratio here" in line]
    assert len(reported) == 1 and rows[0][0] in reported[0]
    spoilt = read_image(folder / rows[0][0])[..., ::-1].copy()  # swapped colours, every fourth pixel turned round
    spoilt[::2, ::2] = 255 - spoilt[::2, ::2]
    cv2.imwrite(str(folder / rows[0][0]), spoilt)
    make(folder, [[rows[0][0], "5.0"], *rows[1:]])
    reported = [line for line in capsys.readouterr().err.splitlines() if "FLAGGED" in line]
    assert len(reported) == 1 and rows[0][0] in reported[0]


def test_readings_that_cannot_be_are_refused(weighed):
    folder, rows = weighed
    image, newtons = rows[0]
    shutil.copy(folder / image, folder / "copy.png")
    for changed, said in (
        ([[image, f"-{newtons}"]], "above 0 N"),
        ([["rest.png", "5.0"]], "shows no contact"),
        ([[image, f"{102 * float(newtons):.1f}"]], "was the reading in newtons"),
        ([[image, '"3,5"']], "line 2: force_n is '3,5', not a number; write a decimal point"),
        ([["", "5.0"]], "line 2: its image is empty"),
        ([rows[0], [], [], ["gone.png", "x"]], "line 5: .*gone.png: not found"),
        ([rows[0], rows[1], rows[0]], "line 4: .*the image of line 2 again"),
        ([rows[0], rows[1], ["copy.png", "9.0"]], "line 4: copy.png shows the image of line 2 again"),
        ([], "no readings"),
    ):
        refused(said, make, folder, changed)
    cv2.imwrite(str(folder / "rest.png"), cv2.medianBlur(cv2.imread(str(folder / "rest.png")), 61))
    refused("shows no markers.*take a sharp one", make, folder, rows)
    assert not (folder / "mine.toml").exists()


def test_what_a_profile_is_made_from_keeps_its_place(weighed, shipped):
    """Also the picture of a profile whose own file was renamed, by which nothing but what the file says leads to it."""
    folder, _ = weighed
    profile = make_profile("other", read_image(folder / "rest.png"), 0.0, Gain(), shipped.metadata)
    write_profile(folder / "other.toml", profile)
    (folder / "other.toml").rename(folder / "renamed.toml")
    image = folder / "seen" / "other.png"
    image.parent.mkdir()
    shutil.copyfile(folder / "rest.png", image)
    for call, words in (
        (
            sensor.main,
            [
                "--name",
                "a",
                "--nocontact",
                str(folder / "rest.png"),
                "--readings",
                str(folder / "a.toml"),
                "--out",
                str(folder / "a.toml"),
            ],
        ),
        (predict.main, [str(image), "--profile", str(folder / "renamed.toml"), "--out", str(folder)]),
    ):
        refused("would overwrite an input file", call, words)


def lossless(path, pictures):
    """A film (.avi) of pictures (h, w, 3) uint8 RGB, compressed without loss."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 25, pictures[0].shape[1::-1])
    for picture in pictures:
        writer.write(picture[:, :, ::-1])
    writer.release()
    return path


def test_a_film_gives_the_nocontact_image_by_itself(weighed):
    """The first frames, in which a camera sets its exposure, and those of a press are none of it; a film cut short serves."""
    folder, rows = weighed
    rest, press = read_image(folder / "rest.png"), read_image(folder / rows[0][0])
    dark = [np.clip(rest * (0.5 + k / 16), 0, 255).astype(np.uint8) for k in range(8)]
    film = lossless(folder / "film.avi", [*dark, *[rest] * 20, *[press] * 40])
    whole = film.read_bytes()
    for content in (whole, whole[: len(whole) // 2]):
        film.write_bytes(content)
        assert sensor.main(["--name", "mine", "--video", str(film), "--out", str(folder / "mine.toml")]) == 0
        found = read_profile(folder / "mine.toml").nocontact.astype(int)
        assert np.abs(found - rest).mean() < 1.0 < np.abs(press.astype(int) - rest).mean()


def test_one_source_of_the_nocontact_image_and_of_the_factor_is_asked_for(weighed):
    folder, _ = weighed
    rest = ["--nocontact", str(folder / "rest.png")]
    moving = write_film(folder / "moving.avi", [np.full((60, 80, 3), 18 * k, np.uint8) for k in range(FEWEST)])
    for more, said in (
        ([], "give one of --nocontact IMAGE"),
        ([*rest, "--camera", "0"], "give one of --nocontact IMAGE"),
        (["--video", str(folder / "gone.avi")], "no such video"),
        (["--video", str(moving)], "without movement"),
    ):
        refused(said, sensor.main, ["--name", "mine", "--out", str(folder / "mine.toml"), *more])
    assert not (folder / "mine.toml").exists()


def test_a_picture_that_shows_a_part_of_the_contact_does_not_count(reference, tmp_path, capsys):
    """Of FEATS' presses two balls that lie within the picture, and a bar that the image crops."""
    rest = read_npy(reference / "feats/images/nocontact_train_sensor.npy")["gs_img"]
    pictures = [picture for picture, _ in feats_maps(reference / "feats/images/demo.gif", rest)]
    chosen = {"rest": rest, "ball": pictures[24], "small_ball": pictures[38], "bar": pictures[16]}
    for name, picture in chosen.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture[..., ::-1])
    rows = [[f"{name}.png", "10"] for name in ("ball", "small_ball", "bar")]
    assert make(tmp_path, rows) == 0
    reported = [line for line in capsys.readouterr().err.splitlines() if "whole contact" in line]
    assert len(reported) == 1 and "line 4: bar.png: is not used" in reported[0]
    assert read_profile(tmp_path / "mine.toml").gain.readings == 2
    refused("none of 1 images shows the whole contact", make, tmp_path, rows[2:])


HOLD, REST = 8, 6  # frames


def film_of(folder, rows):
    """A gel at rest, then each press brought down in two steps, held, and released, with the noise of a camera."""
    noise, still = np.random.default_rng(0), cv2.imread(str(folder / "rest.png"))

    def frames():
        yield from [still] * 15
        for name, _ in rows:
            press = cv2.imread(str(folder / name))
            yield from (cv2.addWeighted(press, part, still, 1.0 - part, 0.0) for part in (0.33, 0.66))
            yield from [press] * HOLD + [still] * REST

    noisy = (np.clip(frame + noise.normal(0.0, 1.5, frame.shape), 0, 255).astype(np.uint8) for frame in frames())
    return write_film(folder / "film.avi", noisy)


def test_a_scale_beside_a_film_gives_the_factor_of_its_readings(weighed, monkeypatch, capsys):
    """Within 3 %; the film stops once at each press; a reading that contradicts is named, and can be dropped."""
    folder, rows = weighed
    kept = rows[:2] + rows[3:]
    make(folder, kept)
    expected = read_profile(folder / "mine.toml").gain.value
    grams = [f"{float(force) * GRAMS:.0f}" for _, force in rows]
    wrong = f"{2.5 * float(rows[2][1]) * GRAMS:.0f}"
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join([*grams[:2], "heavy", wrong, "-", *grams[3:]]) + "\n"))
    film = film_of(folder, rows)
    capsys.readouterr()
    out = folder / "scale.toml"
    assert sensor.main(["--name", "scale", "--video", str(film), "--weigh", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    gain = read_profile(out).gain
    assert gain.readings == len(kept) and gain.value == pytest.approx(expected, rel=0.03)
    assert said.count("Grams?") == len(rows) + 2 and said.count("not counted: 'heavy'") == 1 and "contradicts" in said
    with (folder / "scale-readings/readings.csv").open() as stream:
        assert [row["image"] for row in csv.DictReader(stream)] == [f"{k + 1:02d}.png" for k in range(len(kept))]
    refused(
        "scale-readings exists already",
        sensor.main,
        ["--name", "scale", "--video", str(film), "--weigh", "--out", str(out)],
    )


def test_a_running_camera_weighs_what_is_held_and_nothing_that_moves(weighed, tmp_path, monkeypatch, capsys):
    folder, rows = weighed
    name, force = rows[0]
    still, press = (cv2.imread(str(folder / file)) for file in ("rest.png", name))
    halfway = cv2.addWeighted(press, 0.5, still, 0.5, 0.0)
    end, typing = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(end))
    weighing = Weighing(tmp_path, Reader(read_image(folder / "rest.png"), model=load_model(None)))
    said, rng = [], np.random.default_rng(3)

    def noisy(frame):
        """No two frames of a camera are equal: one that repeats itself is refused."""
        return cv2.add(frame, rng.integers(0, 2, frame.shape, np.uint8))

    def camera():
        """Frames; what is typed is answered before the next one comes."""
        shown = 0
        for frames in ([still] * 6, [halfway, press, halfway, press, press], [press] * 6, [still] * 2):
            for frame in frames:
                yield Frame(shown, shown / 25.0, noisy(frame))
                shown += 1
            yield Frame(shown, shown / 25.0, noisy(frames[-1]))  # by then the one before was read
            shown += 1
            os.write(typing, f"{float(force) * GRAMS:.1f}\n".encode())
            text = ""
            while "\n" not in text:
                text += capsys.readouterr().out
            said.append(text)
        os.close(typing)

    weigh_camera(weighing, camera(), lambda reading: None)
    assert ["no contact" in said[0], "it moves" in said[1], "factor so far" in said[2], "counted" in said[3]] == [
        True
    ] * 4
    assert weighing.names == ["01.png"] and weighing.measured == [pytest.approx(float(force), rel=1e-3)]
