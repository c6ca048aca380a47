"""Recordings of robots as datasets: which force belongs to which image, and which forces a gel can have."""

import re
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import zstandard

from gelforge.commands.mcap import main as mcap_import
from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, write_text
from gelforge.formats.export import ros
from gelforge.formats.mcap_import import Topics, import_recordings, nearest
from gelforge.formats.messageimage import pictures
from gelforge.labelling.sensor import load_sensors
from gelforge.records.image import read_image
from gelforge.records.labelfile import read_labels
from tests.support.recordings import (
    FILM,
    IMAGE,
    MS,
    START,
    WRENCH,
    coloured,
    encoded,
    filmed,
    imported,
    moments,
    png,
    ramp,
    raw,
    wrench,
    write,
    write_bag,
    write_foxglove,
)
from tests.support.refused import refused


@pytest.fixture
def sensor(root):
    return load_sensors(root / "workflow" / "sensors.toml")["gelsight_mini"]


@pytest.mark.parametrize("delay", [200.0, "jitter"])
def test_an_image_has_the_force_of_its_own_moment(tmp_path, sensor, delay):
    """Logged late it had the force of another one: 2 N off after 0.2 s at 10 N/s."""
    rng = np.random.default_rng(3)
    images = filmed(FILM, lambda k: rng.uniform(0, 300) if delay == "jitter" else delay)
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp()), sensor)
    assert len(rows) == len(FILM)
    assert np.abs(moments(rows) - FILM).max() <= 5.0
    assert found["largest_gap_s"] == pytest.approx(0.003, abs=1e-6)
    assert not [note for note in found["notes"] if "log times" in note]


@pytest.mark.parametrize("bare", ["images", "wrenches", "a type without header"])
def test_without_stamps_the_log_is_used_and_that_is_reported(tmp_path, sensor, capsys, bare):
    images, forces = filmed(FILM, lambda k: 80.0), ramp()
    if bare == "images":
        images = [(time, said | {"header": ros.header(0, "gel")}) for time, said in images]
    if bare == "wrenches":
        forces = [(time, said | {"header": ros.header(0, "ft")}) for time, said in forces]
    if bare == "a type without header":
        forces = [(time, said["wrench"]) for time, said in forces]
    path = write(tmp_path / "a.mcap", images, forces, bare == "a type without header")
    write_text(tmp_path / "topics.toml", f'image = "{IMAGE}"\nwrench = "{WRENCH}"\n')
    mcap_import(["--from", str(path), "--topics", str(tmp_path / "topics.toml"), "--data", str(tmp_path / "lab")])
    said = capsys.readouterr().out
    assert f"messages of {IMAGE if bare == 'images' else WRENCH} have no time in their headers" in said
    assert said.count("log times were used") == 1 and "at most" in said and "ms apart" in said
    rows = read_csv(tmp_path / "lab/log.csv")
    assert np.abs(moments(rows) - FILM - 79.0).max() <= 5.0


@pytest.mark.parametrize("clock", [-START, 2 * 10**9])
def test_stamps_of_two_clocks_are_not_compared(tmp_path, sensor, clock):
    """A camera that counts from its start, and one that nobody set."""
    images = filmed(FILM, lambda k: 1.0, clock=clock)
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp()), sensor)
    assert any("different clocks" in note and "log times were used" in note for note in found["notes"])
    assert np.abs(moments(rows) - FILM).max() <= 5.0


def test_one_clock_that_is_not_the_logs_serves(tmp_path, sensor):
    """Both devices count from their start: their headers agree, whatever the log says."""
    shift = 10**12 - START
    images = filmed(FILM, lambda k: 200.0, clock=shift)
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp(clock=shift)), sensor)
    assert not [note for note in found["notes"] if "log times" in note]
    assert np.abs(moments(rows) - FILM).max() <= 5.0


def test_stamps_that_never_change_are_none(tmp_path, sensor):
    images = [(time, said | {"header": ros.header(START, "gel")}) for time, said in filmed(FILM, lambda k: 1.0)]
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp()), sensor)
    assert any("the same time in their headers" in note for note in found["notes"])
    assert np.abs(moments(rows) - FILM).max() <= 5.0


def notes_with(found, topic, word):
    """How many messages of a topic are reported to have had this fault."""
    reported = [note.split(f"{topic}: ")[1] for note in found["notes"] if f"{topic}: " in note and word in note]
    return int(reported[0].split()[0]) if reported else 0


def test_messages_out_of_order_twice_and_missing_are_reported_and_pairs_are_right(tmp_path, sensor):
    rng = np.random.default_rng(5)
    images = filmed(FILM, lambda k: rng.uniform(0, 150))
    lost, twice = {7, 8, 20}, {3, 12, 30}
    images = [one for k, one in enumerate(images) if k not in lost]
    again = [(time + 7 * MS, said) for k, (time, said) in enumerate(images) if k in twice]
    forces = [one for k, one in enumerate(ramp()) if k not in (5, 6, 7)]
    forces[150], forces[151] = (forces[150][0], forces[151][1]), (forces[151][0], forces[150][1])
    path = write(tmp_path / "a.mcap", sorted([*images, *again], key=lambda one: one[0]), forces)
    found, rows = imported(tmp_path, path, sensor)
    kept = np.delete(FILM, list(lost))
    assert np.abs(moments(rows) - kept).max() <= 5.0
    assert notes_with(found, IMAGE, "repeat") == 3 and notes_with(found, IMAGE, "missing") == 3
    assert notes_with(found, IMAGE, "out of order") > 3 and notes_with(found, WRENCH, "out of order") == 1
    assert notes_with(found, WRENCH, "missing") == 3 and notes_with(found, WRENCH, "repeat") == 0


def test_some_messages_without_a_stamp_are_left_out(tmp_path, sensor):
    images = filmed(FILM, lambda k: 80.0)
    for k in (0, 9):
        images[k] = (images[k][0], images[k][1] | {"header": ros.header(0, "gel")})
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp()), sensor)
    assert notes_with(found, IMAGE, "without a time") == 2
    assert np.abs(moments(rows) - np.delete(FILM, [0, 9])).max() <= 5.0


def test_wrenches_in_bursts_of_one_log_time_are_no_repeats(tmp_path, sensor):
    """A driver that reads its sensor in blocks: each reading has a stamp of its own, but not a log time."""
    forces = [(START + (k // 10 * 100 + 100) * MS, said) for k, (_, said) in enumerate(ramp())]
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", filmed(FILM, lambda k: 5.0), forces), sensor)
    assert np.abs(moments(rows) - FILM).max() <= 5.0 and notes_with(found, WRENCH, "repeat") == 0


@pytest.mark.parametrize("touched", [True, False])
def test_parts_of_one_recording_are_in_the_order_of_time_and_a_contact_goes_on(tmp_path, sensor, touched):
    (tmp_path / "bag").mkdir()
    images, forces = filmed(FILM[:24], lambda k: 0.0), ramp()
    if not touched:
        forces = [(time, wrench(time - MS, 0.0)) for time, _ in forces]
    for part in range(12):  # bag_10 and bag_11 sort before bag_2
        of_part = images[2 * part : 2 * part + 2]
        near = [said for said in forces if of_part[0][0] - 20 * MS <= said[0] <= of_part[-1][0] + 20 * MS]
        write(tmp_path / "bag" / f"bag_{part}.mcap", of_part, near)
    _, rows = imported(tmp_path, tmp_path / "bag", sensor)
    assert len(rows) == 24 and [row["sample_id"] for row in rows] == sorted(row["sample_id"] for row in rows)
    if touched:
        assert (np.diff(moments(rows)) > 0).all() and {row["press_id"] for row in rows} == {"r000-p00001"}
    else:
        assert len({row["press_id"] for row in rows}) == 12


def test_recordings_that_are_apart_are_of_several_presses(tmp_path, sensor):
    (tmp_path / "bag").mkdir()
    for part, start in enumerate((300.0, 1600.0)):
        write(tmp_path / "bag" / f"{9 - part}.mcap", filmed([start, start + 40.0], lambda k: 0.0), ramp())
    _, rows = imported(tmp_path, tmp_path / "bag", sensor)
    assert [row["press_id"] for row in rows] == ["r000-p00001"] * 2 + ["r001-p00001"] * 2
    assert (np.diff(moments(rows)) > 0).all()


@pytest.mark.parametrize(("offset", "reported"), [(0.5, True), (0.1, False)])
def test_a_sensor_that_reads_a_force_all_the_time_is_reported(tmp_path, sensor, offset, reported):
    forces = [(time, wrench(time - MS, said["wrench"]["force"]["z"] - offset)) for time, said in ramp()]
    found, _ = imported(tmp_path, write(tmp_path / "a.mcap", filmed(FILM, lambda k: 0.0), forces), sensor)
    assert any("tare the sensor" in note for note in found["notes"]) == reported


def test_a_recording_compressed_as_a_whole_is_not_passed_over_beside_others(tmp_path, sensor):
    """As `ros2 bag record --compression-mode file` leaves it."""
    (tmp_path / "in").mkdir()
    whole = write(tmp_path / "in/a.mcap", filmed(FILM, lambda k: 0.0), ramp())
    write(tmp_path / "in/b.mcap", filmed(FILM, lambda k: 0.0), ramp())
    packed = whole.with_name("a.mcap.zstd")
    packed.write_bytes(zstandard.compress(whole.read_bytes()))
    whole.unlink()
    refused(r"a\.mcap\.zstd: cannot be read as a recording .*zstd -d", imported, tmp_path, packed.parent, sensor)
    whole.write_bytes(zstandard.decompress(packed.read_bytes()))
    assert imported(tmp_path, packed.parent, sensor)[0]["files"] == 2


def test_the_largest_gap_is_that_of_all_recordings(tmp_path, sensor):
    (tmp_path / "in").mkdir()
    for name, shift in (("a", 0), ("b", 4)):
        write(tmp_path / "in" / f"{name}.mcap", filmed(FILM + shift, lambda k: 5.0), ramp())
    found, rows = imported(tmp_path, tmp_path / "in", sensor)
    assert found["files"] == 2 and len(rows) == 2 * len(FILM)
    assert found["largest_gap_s"] == pytest.approx(0.003, abs=1e-6)


@pytest.mark.parametrize("raw_images", [False, True])
def test_a_recording_becomes_pictures_with_total_force_in_the_gels_frame(tmp_path, sensor, raw_images):
    """Of every second image; the wrench is turned and its sign changed."""
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shown = [coloured(k) for k in range(20)]
    times = [START + 50 * MS * k for k in range(20)]
    images = [
        (t, {"header": ros.header(t, "gel"), **(raw(im[..., ::-1], "bgr8") if raw_images else png(im))})
        for t, im in zip(times, shown, strict=True)
    ]
    size = [5.0 if (k // 20) % 2 else 0.0 for k in range(85)]
    forces = [(START + 10 * MS * k, wrench(START + 10 * MS * k, s, x=0.1 * s, y=0.2 * s)) for k, s in enumerate(size)]
    more = f"sign = -1\nevery = 2\nrotation = {turn.tolist()}\n"
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, forces), sensor, more)
    assert (found["files"], found["images"], found["without_wrench"], found["largest_gap_s"]) == (1, 9, 1, 0.0)
    labels = read_labels(tmp_path / "lab" / "labels" / "1x1.npz")
    for k, row in enumerate(rows):
        assert np.array_equal(cv2.imread(str(tmp_path / "lab" / row["image"]))[..., ::-1], shown[2 * k])
        s = size[10 * k]
        expected = -turn @ [0.1 * s, 0.2 * s, s]
        assert [float(row[f"f{axis}_n"]) for axis in "xyz"] == pytest.approx(expected.tolist(), abs=1e-6)
        assert labels.label[k, :, 0, 0] == pytest.approx(expected, abs=1e-5)
        assert row["indenter"] == "" and row["dz_mm"] == ""
    assert len({row["press_id"] for row in rows}) == 3  # before the first contact, and two contacts


def test_readings_that_are_no_numbers_are_left_out(tmp_path, sensor):
    """As pictures without a wrench: one of them would spoil the whole dataset's labels."""
    forces = [
        (time, wrench(time, -1.0, y=np.nan if k == 2 else 0.0))
        for k, (time, _) in enumerate(filmed(FILM[:6], lambda k: 0))
    ]
    found, _ = imported(tmp_path, write(tmp_path / "a.mcap", filmed(FILM[:6], lambda k: 0), forces), sensor)
    assert found["images"] == 5 and found["without_wrench"] == 1


DATA = 'force = ["ati.data.0", "ati.data.1", "ati.data.2"]\n'
KINDS = {  # names, writers, and what the topics file says besides
    "film of Foxglove": ("a.mcap", lambda *said: write_foxglove(*said, "video"), DATA),
    "images of Foxglove": ("a.mcap", lambda *said: write_foxglove(*said, "protobuf"), DATA),
    "JSON": (
        "a.mcap",
        lambda *said: write_foxglove(*said, "json"),
        DATA + 'torque = ["ati.data.3", "ati.data.4", "ati.data.5"]',
    ),
    "bag of ROS 1": ("a.bag", write_bag, ""),
    "bag of ROS 2": ("bag", write_bag, ""),
}


@pytest.mark.parametrize(
    ("kind", "size"), [("images of Foxglove", (480, 640)), *((kind, (240, 320)) for kind in KINDS)]
)
def test_recordings_of_every_kind_give_the_same_rows(tmp_path, sensor, kind, size):
    """The public recordings of dotted Minis with a force sensor are films of Foxglove with a wrench of a schema of their own."""
    name, write_kind, more = KINDS[kind]
    times = [START + int(t) * MS for t in FILM]
    shown = [cv2.resize(coloured(2 * k), size[::-1]) for k in range(len(times))]
    forces = [(START + 10 * MS * k, (0.01 * k, 0.0, -0.1 * max(k - 30, 0))) for k in range(300)]
    found, rows = imported(
        tmp_path, write_kind(tmp_path / name, list(zip(times, shown, strict=True)), forces), sensor, more
    )
    assert len(rows) == len(FILM) and not [note for note in found["notes"] if "log times" in note]
    assert np.abs(100.0 * np.array([float(row["fx_n"]) for row in rows]) * 10 - FILM).max() <= 5.0
    moments_known = "torque" in more or not more
    assert [row["mx_nm"] for row in rows] == (["0.01"] * len(rows) if moments_known else [""] * len(rows))
    assert rows[0]["time_utc"].endswith("20.103Z") and rows[1]["time_utc"].endswith("20.143Z")
    for k in (0, 1, 17, len(rows) - 1):
        image = cv2.imread(str(tmp_path / "lab" / rows[k]["image"]))[..., ::-1].astype(int)
        assert image.shape == (240, 320, 3) and np.abs(image - coloured(2 * k)).mean() < (
            4.0 if "film" in kind else 0.6
        )
    rest = cv2.imread(str(tmp_path / "lab/nocontact/gelsight_mini.png"))[..., ::-1].astype(int)
    assert np.abs(rest - coloured(4)).mean() < 4.0  # those before the force rises


def test_fields_that_a_message_lacks_and_films_without_a_beginning_are_named(tmp_path, sensor):
    times = [START + int(t) * MS for t in FILM]
    images = [(time, coloured(k)) for k, time in enumerate(times)]
    path = write_foxglove(tmp_path / "a.mcap", images, [(times[0], (0, 0, -1))], "json")
    for more, said in (
        ("", "holds no wrench"),
        ('force = ["ati.x", "ati.y", "ati.z"]', "holds no wrench"),
        ('force = ["a"]', "give three fields"),
    ):
        refused(said, imported, tmp_path, path, sensor, more)
    frames = encoded([coloured(k) for k in range(6)])
    message = SimpleNamespace(format="h264", data=frames[3])
    with pytest.raises(BadInput, match="must begin with a keyframe"):
        list(pictures([message], {0}, "a.mcap: topic /gel/image"))


def test_forces_of_another_unit_or_axis_are_named_by_what_the_shipped_network_reads(
    tmp_path, root, capsys, monkeypatch
):
    """Counts (-284 N), pounds-force and exchanged axes passed without a word."""
    monkeypatch.chdir(root)
    # cylinders are pressed straight down, so that they have no sideways force to exchange
    rows = [
        row
        for row in read_csv(root / "data/demo/log.csv")
        if row["sensor_id"] == "mini_a" and row["indenter"] != "cylinder_8"
    ][:14]
    rest = read_image(root / "data/demo/nocontact/mini_a.png")
    pressed = [
        (read_image(root / "data/demo" / row["image"]), [float(row[f"f{axis}_n"]) for axis in "xyz"]) for row in rows
    ]
    between = [one for press in pressed for one in (press, (rest, [0.0, 0.0, 0.0]))]
    for factor, said in (
        (1.0, ""),
        (1 / 4.448, "pounds-force"),
        (20.0, "not in newtons"),
        ("axes", "fx_n follows the normal force"),
        ("turned", "Sideways forces do not follow what the shipped network reads of them: they are turned by"),
        ("drift", "The force sensor drifts"),
        ("BGR", "red and blue seem to be exchanged in the no-contact image"),
    ):
        images, forces = [], []
        for k, (image, force) in enumerate([(rest, (0.0, 0.0, 0.0)), *(between if factor == "drift" else pressed)]):
            time = START + 100 * MS * k
            shown = np.ascontiguousarray(image[..., ::-1]) if factor == "BGR" else image
            images.append((time, {"header": ros.header(time, "gel"), **png(shown)}))
            if factor == "axes":
                x, y, z = force[::-1]
            elif factor == "turned":
                x, y, z = -force[1], force[0], force[2]
            elif factor == "drift":
                x, y, z = force[0], force[1], force[2] + 0.05 * k
            else:
                x, y, z = (value if factor == "BGR" else factor * value for value in force)
            forces.append((time, wrench(time, max(z, -499.0), x=x, y=y)))
        path = write(tmp_path / f"{factor}.mcap", images, forces)
        write_text(tmp_path / "topics.toml", f'image = "{IMAGE}"\nwrench = "{WRENCH}"\n')
        mcap_import(
            ["--from", str(path), "--topics", str(tmp_path / "topics.toml"), "--data", str(tmp_path / f"lab{factor}")]
        )
        told = capsys.readouterr().out
        assert (
            (said in told)
            if said
            else not any(word in told for word in ("newtons", "drifts", "red and blue", "Sideways"))
        ), told


REFUSED_FORCES = {
    "grams": (lambda z: 102.0 * z, "fz_n = -5.+, larger than 500; check the unit"),
    "the reaction": (lambda z: -z, r"pulling force, fz_n up to \+1[0-9.]+ N; .*set sign = -1"),
    "a sensor that was not tared": (lambda z: z + 12.0, "tare the sensor"),
}


@pytest.mark.parametrize("case", REFUSED_FORCES)
def test_forces_beyond_the_limits_of_a_log_leave_nothing(tmp_path, sensor, case):
    change, said = REFUSED_FORCES[case]
    forces = [(time, wrench(time - MS, change(each["wrench"]["force"]["z"]))) for time, each in ramp()]
    path = write(tmp_path / "a.mcap", filmed(FILM, lambda k: 0.0), forces)
    refused(rf"a\.mcap: topic {WRENCH}: .*{said}", imported, tmp_path, path, sensor)
    assert not (tmp_path / "lab").exists()


def test_a_few_images_of_a_pull_are_left_out_and_reported(tmp_path, sensor):
    """A gel that sticks to what leaves it; a reading below the limit of a log counts."""
    forces = [
        (time, wrench(time - MS, {20: 3.0, 21: 0.4}.get(k // 5, each["wrench"]["force"]["z"])))
        for k, (time, each) in enumerate(ramp())
    ]
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", filmed(FILM, lambda k: 0.0), forces), sensor)
    (note,) = [note for note in found["notes"] if "pulling force" in note]
    left_out = int(re.search(r": (\d+) of 38 images", note)[1])
    assert left_out in (1, 2) and len(rows) == len(FILM) - left_out
    assert max(float(row["fz_n"]) for row in rows) == 0.4


TOML = """image = "/gel/image"
wrench = "/ft/wrench"
sign = -1
rotation = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
every = 2
"""


WRONG_TOPICS = [
    ('image = "/a"', "wrench is missing"),
    (TOML + "colour = 1", "colour is not known"),
    (TOML.replace("[0, 1, 0]", "[0, 2, 0]"), "a 3 x 3 rotation matrix"),
    (TOML.replace("[-1, 0, 0]", "[1, 0, 0]"), "no reflection"),
    (TOML + 'touch_n = "0.2 N"', "touch_n"),
    (TOML + "touch_n = [0.2]", "touch_n"),
    (TOML + "touch_n = nan", "touch_n"),
    (TOML + f"touch_n = {10**400}", "touch_n"),
    (TOML + f"latest_s = {10**400}", "latest_s is above 0"),
    (TOML.replace("[0, 1, 0]", f"[0, {10**400}, 0]"), "a 3 x 3 rotation matrix"),
    (TOML + 'sensor = ["gelsight_mini"]', "one name"),
    (TOML.replace("every = 2", "every = 0"), "whole number from 1"),
    (TOML.replace("sign = -1", "sign = 3"), "sign is 1 or -1"),
]


def test_wrong_topics_are_one_sentence(tmp_path):
    for text, said in WRONG_TOPICS:
        write_text(tmp_path / "topics.toml", text)
        refused(said, Topics.read, tmp_path / "topics.toml")


@pytest.mark.parametrize("harm", ["cut", "a time beyond all clocks", "no such topic", "no such file"])
def test_a_recording_that_cannot_be_used_leaves_nothing(tmp_path, harm, sensor):
    late = 2**63 - START if harm == "a time beyond all clocks" else 0
    images, forces = filmed(FILM[:6], lambda k: 0.0), [(time + late, said) for time, said in ramp(50)]
    path = write(tmp_path / "a.mcap", images, forces)
    if harm == "cut":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    elif harm == "no such topic":
        path = write(tmp_path / "a.mcap", images, [])
    elif harm == "no such file":
        path.unlink()
    with pytest.raises(BadInput):
        imported(tmp_path, path, sensor)
    assert not [found for found in tmp_path.iterdir() if "lab" in found.name]


def test_what_is_not_named_is_asked_for(tmp_path):
    refused("FROM=", mcap_import, ["--from", str(tmp_path / "none"), "--topics", "", "--data", str(tmp_path / "lab")])


def test_the_nearest_wrench_is_taken_within_its_time():
    times = np.array([0, 100, 200])
    assert [nearest(times, time, 40) for time in (-10, 60, 149, 151, 239, 241)] == [0, 1, None, None, 2, None]
    assert nearest(np.array([], np.int64), 5, 10) is None


def presses(times):
    """Compression, N, of three presses at times (n,) s: down in 0.6 s, held for 0.4 s, up in 0.4 s."""
    knots = np.concatenate([np.array([0.0, 0.6, 1.0, 1.4]) + start for start in (0.8, 3.1, 5.2)])
    return np.interp(times, knots, [0, 9, 9, 0, 0, 14, 14, 0, 0, 6, 6, 0])


def pressed(tmp_path, off=0.0, late=0.002, read=presses, shown=None):
    """A recording of presses by image and wrench; off: of the wrench's stamps, late: of the wrench's log times, s."""
    at = np.arange(0.0, 7.0, 0.06)
    seen = presses(at) if shown is None else shown(at)
    images = [
        (
            START + int(1e9 * (t + 0.004)),
            {"header": ros.header(START + int(1e9 * t), "gel"), **png(coloured(int(3 * f)))},
        )
        for t, f in zip(at, seen, strict=True)
    ]
    felt = np.arange(0.0, 7.0, 0.01)
    forces = [
        (START + int(1e9 * (t + late)), wrench(START + int(1e9 * (t + off)), -float(f)))
        for t, f in zip(felt, read(felt), strict=True)
    ]
    return write(tmp_path / "a.mcap", images, forces), at


def worst(rows, at):
    moments = [at[int(row["image"][-10:-4])] for row in rows]
    return np.abs(presses(np.array(moments)) + [float(row["fz_n"]) for row in rows]).max()


def test_stamps_of_another_clock_are_not_believed(tmp_path, sensor):
    """0.2 to 0.5 s off, up to 122 of 177 rows were wrong by 1 to 35 N: `at most 0.0 ms apart`."""
    for k, (off, said) in enumerate(
        ((0.3, "which is impossible on one clock"), (-0.4, "early beside what the pictures"))
    ):
        (tmp_path / str(k)).mkdir()
        path, at = pressed(tmp_path / str(k), off)
        found, rows = imported(tmp_path / str(k), path, sensor)
        assert worst(rows, at) < 0.5
        assert any(said in note or ("beside what the pictures show" in note) for note in found["notes"])
    (tmp_path / "good").mkdir()
    path, at = pressed(tmp_path / "good")
    found, rows = imported(tmp_path / "good", path, sensor)
    # forces have z alone
    assert worst(rows, at) < 0.5 and all("never changes" in note for note in found["notes"])


def test_where_neither_clock_agrees_with_the_pictures_nothing_is_imported(tmp_path, sensor):
    path, _ = pressed(tmp_path, -0.4, 0.4)
    refused("by header times .* and by log times .*: their clocks differ", imported, tmp_path, path, sensor)


def wild(times):
    force = presses(times)
    force[[120, 333]] = 84.0
    return force


def stuck(times):
    seen = presses(times)
    seen[(times > 1.0) & (times < 1.3)] = seen[times <= 1.0][-1]
    return seen


LEFT_OUT = {  # what is said, and what the recording is made of
    "wild": ("2 of 700 readings are contradicted by their neighbours", {"read": wild}),
    "clipped": (
        "at the end of its range; their images",
        {"read": lambda t: np.minimum(presses(t), 7.0) - 0.01 * (np.arange(len(t)) % 3 == 0)},
    ),
    "stuck": ("images repeat the one before them although the force changed", {"shown": stuck}),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_wild_and_clipped_forces_and_repeated_images_are_left_out_and_counted(tmp_path, sensor, name):
    told, changes = LEFT_OUT[name]
    path, at = pressed(tmp_path, **changes)
    found, rows = imported(tmp_path, path, sensor)
    assert any(told in note for note in found["notes"]), found["notes"]
    assert worst(rows, at) < 0.5


def test_forces_beside_pictures_without_contact_are_named(tmp_path, sensor):
    path, _ = pressed(tmp_path, read=lambda times: presses(times) + 0.3 * times)
    found, _ = imported(tmp_path, path, sensor)
    assert any("beside pictures that show no contact" in note for note in found["notes"])


@pytest.mark.parametrize("topic", [IMAGE, WRENCH])
def test_a_topic_of_several_frames_is_refused(tmp_path, sensor, topic):
    """A driver that changes its frame with the tool turns forces; two cameras on a topic were `pale markers`."""
    streams = {IMAGE: filmed(FILM, lambda k: 1.0), WRENCH: ramp()}
    streams[topic] = [
        (time, said | {"header": ros.header(time, "tool0" if k % 2 else "base")})
        for k, (time, said) in enumerate(streams[topic])
    ]
    path = write(tmp_path / "a.mcap", *streams.values())
    refused(f"topic {topic} has messages of several frames .'base', 'tool0'.", imported, tmp_path, path, sensor)


def test_a_topic_that_is_not_there_is_named_beside_those_that_are(tmp_path, sensor):
    """A topic of compressed images was named without its last part."""
    path = write(tmp_path / "a.mcap", filmed(FILM[:3], lambda k: 0.0), ramp(30))
    write_text(tmp_path / "topics.toml", f'image = "/gel"\nwrench = "{WRENCH}"\n')
    with pytest.raises(BadInput, match=f"has no topic /gel, but {WRENCH}, {IMAGE}"):
        import_recordings(path, tmp_path / "lab", Topics.read(tmp_path / "topics.toml"), sensor)
