"""Recordings of robots: which force belongs to which image, the encodings that cameras write, names that ROS 2 allows."""

import cv2
import numpy as np
import pytest
import zstandard

from gelforge.commands.mcap import main as mcap_import
from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, write_text
from gelforge.formats.export import ros
from gelforge.formats.mcap_import import Topics, import_recordings
from gelforge.labelling.sensor import load_sensors
from tests.support.exported import lay, read_mcap

START = 1_790_000_000 * 10**9
MS = 10**6
NEWTONS_A_SECOND = 10.0
IMAGE, WRENCH = "/gel/image", "/ft/wrench"
WITHOUT_HEADER = """geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z"""
LIGHTS = np.linspace([40, 160, 90], [210, 60, 140], 320).astype(np.uint8)


@pytest.fixture
def sensor(root):
    return load_sensors(root / "workflow" / "sensors.toml")["gelsight_mini"]


def coloured(shade=0):
    """A smooth image, (240, 320, 3): chroma of half resolution and Bayer patterns lose nothing of it."""
    return np.ascontiguousarray(np.tile(LIGHTS, (240, 1, 1))) + np.uint8(shade)


def raw(image, encoding="rgb8", channels=3, step=None, height=240, width=320):
    """sensor_msgs/Image without its header, of pixels as they lie in memory."""
    return {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": step or channels * width,
            "data": image.tobytes()}  # fmt: skip


def png(image):
    return {"format": "png", "data": cv2.imencode(".png", image[..., ::-1])[1].tobytes()}


def wrench(stamp, force):
    still = dict.fromkeys("xyz", 0.0)
    return {"header": ros.header(stamp, "ft"), "wrench": {"force": still | {"z": force}, "torque": still}}


def write(path, images, wrenches, bare=False):
    """A recording of (log time, message) each; bare: wrenches without a header."""
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        compressed = bool(images) and "format" in images[0][1]
        kind = (
            ("CompressedImage", ros.schema("sensor_msgs/msg/CompressedImage"))
            if compressed
            else ("Image", ros.schema("sensor_msgs/msg/Image"))
        )
        image = writer.register_msgdef(f"sensor_msgs/msg/{kind[0]}", kind[1])
        forces = (
            writer.register_msgdef("geometry_msgs/msg/Wrench", WITHOUT_HEADER)
            if bare
            else writer.register_msgdef(
                "geometry_msgs/msg/WrenchStamped", ros.schema("geometry_msgs/msg/WrenchStamped")
            )
        )
        for topic, schema, messages in ((IMAGE, image, images), (WRENCH, forces, wrenches)):
            for time, said in messages:
                writer.write_message(topic, schema, said, log_time=time, publish_time=time)
        writer.finish()
    return path


def ramp(count=300, delay=MS, clock=0):
    """Wrenches each 10 ms of a force that grows: from it the time that an image was paired with can be read."""
    return [
        (START + k * 10 * MS + delay, wrench(START + k * 10 * MS + clock, -NEWTONS_A_SECOND * k / 100))
        for k in range(count)
    ]


def filmed(times, delay, clock=0):
    """Images of these times in ms, each logged `delay` (k) ms after its stamp."""
    return [
        (
            START + int((t + delay(k)) * MS),
            {"header": ros.header(START + int(t * MS) + clock, "gel"), **png(coloured(k))},
        )
        for k, t in enumerate(times)
    ]


def imported(tmp_path, path, sensor, more=""):
    write_text(tmp_path / "topics.toml", f'image = "{IMAGE}"\nwrench = "{WRENCH}"\n{more}')
    found = import_recordings(path, tmp_path / "lab", Topics.read(tmp_path / "topics.toml"), sensor)
    rows = read_csv(tmp_path / "lab/log.csv")
    assert len(rows) == found["images"]
    return found, rows


def moments(rows):
    """Time in ms at which each row's force was measured."""
    return np.array([-1e3 * float(row["fz_n"]) / NEWTONS_A_SECOND for row in rows])


FILM = np.arange(103.0, 1600.0, 40.0)


@pytest.mark.parametrize("delay", [80.0, 200.0, 0.0, "jitter"])
def test_an_image_has_the_force_of_its_own_moment(tmp_path, sensor, delay):
    """Logged late it had the force of another one: 2 N off after 0.2 s at 10 N/s."""
    rng = np.random.default_rng(3)
    images = filmed(FILM, lambda k: rng.uniform(0, 300) if delay == "jitter" else delay)
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp()), sensor)
    assert len(rows) == len(FILM)
    assert np.abs(moments(rows) - FILM).max() <= 5.0
    assert found["largest_gap_s"] == pytest.approx(0.003, abs=1e-6)
    assert not [note for note in found["notes"] if "log's time" in note]


@pytest.mark.parametrize("bare", ["images", "wrenches", "both", "a type without header"])
def test_without_stamps_the_log_is_used_and_that_is_reported(tmp_path, sensor, capsys, bare):
    images, forces = filmed(FILM, lambda k: 80.0), ramp()
    if bare in ("images", "both"):
        images = [(time, said | {"header": ros.header(0, "gel")}) for time, said in images]
    if bare in ("wrenches", "both"):
        forces = [(time, said | {"header": ros.header(0, "ft")}) for time, said in forces]
    if bare == "a type without header":
        forces = [(time, said["wrench"]) for time, said in forces]
    path = write(tmp_path / "a.mcap", images, forces, bare == "a type without header")
    write_text(tmp_path / "topics.toml", f'image = "{IMAGE}"\nwrench = "{WRENCH}"\n')
    mcap_import(["--from", str(path), "--topics", str(tmp_path / "topics.toml"), "--data", str(tmp_path / "lab")])
    said = capsys.readouterr().out
    named = [IMAGE] * (bare in ("images", "both")) + [WRENCH] * (bare != "images")
    assert all(f"messages of {topic} have no time in their headers" in said for topic in named)
    assert said.count("the log's time was used") == 1 and "at most" in said and "ms apart" in said
    rows = read_csv(tmp_path / "lab/log.csv")
    assert np.abs(moments(rows) - FILM - 79.0).max() <= 5.0


@pytest.mark.parametrize("clock", [-START, 3600 * 10**9, 2 * 10**9])
def test_stamps_of_two_clocks_are_not_compared(tmp_path, sensor, clock):
    """A camera that counts from its start, one in another time zone, one that nobody set."""
    images = filmed(FILM, lambda k: 1.0, clock=clock)
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp()), sensor)
    assert any("different clocks" in note and "the log's time was used" in note for note in found["notes"])
    assert np.abs(moments(rows) - FILM).max() <= 5.0


def test_one_clock_that_is_not_the_logs_serves(tmp_path, sensor):
    """Both devices count from their start: their headers agree, whatever the log says."""
    shift = 10**12 - START
    images = filmed(FILM, lambda k: 200.0, clock=shift)
    found, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp(clock=shift)), sensor)
    assert not [note for note in found["notes"] if "log's time" in note]
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


@pytest.mark.parametrize(("offset", "reported"), [(20.0, True), (0.5, True), (0.1, False), (0.0, False)])
def test_a_sensor_that_reads_a_force_all_the_time_is_reported(tmp_path, sensor, offset, reported):
    forces = [(time, wrench(time - MS, said["wrench"]["force"]["z"] - offset)) for time, said in ramp()]
    found, _ = imported(tmp_path, write(tmp_path / "a.mcap", filmed(FILM, lambda k: 0.0), forces), sensor)
    assert any("tare the sensor" in note for note in found["notes"]) == reported


def test_messages_of_ros_1_are_reported_by_what_they_are(tmp_path, sensor):
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1")
        for topic, kind in ((IMAGE, "sensor_msgs/CompressedImage"), (WRENCH, "geometry_msgs/WrenchStamped")):
            channel = writer.register_channel(
                topic, "ros1", writer.register_schema(kind, "ros1msg", b"Header header")
            )
            writer.add_message(channel, START, bytes(40), START)
        writer.finish()
    with pytest.raises(BadInput, match="holds no ROS 2 messages .* convert the recording"):
        imported(tmp_path, tmp_path / "a.mcap", sensor)


def test_a_recording_compressed_as_a_whole_is_named_with_its_command(tmp_path, sensor):
    """As `ros2 bag record --compression-mode file` leaves it; in a folder it is not passed over beside others."""
    (tmp_path / "in").mkdir()
    whole = write(tmp_path / "in/a.mcap", filmed(FILM, lambda k: 0.0), ramp())
    write(tmp_path / "in/b.mcap", filmed(FILM, lambda k: 0.0), ramp())
    packed = whole.with_name("a.mcap.zstd")
    packed.write_bytes(zstandard.compress(whole.read_bytes()))
    whole.unlink()
    for source in (packed, packed.parent):
        with pytest.raises(BadInput, match=rf"zstd -d {packed} -o {whole}` "):
            imported(tmp_path, source, sensor)
    whole.write_bytes(zstandard.decompress(packed.read_bytes()))
    assert imported(tmp_path, packed.parent, sensor)[0]["files"] == 2


def test_the_largest_gap_is_that_of_all_recordings(tmp_path, sensor):
    (tmp_path / "in").mkdir()
    for name, shift in (("a", 0), ("b", 4)):
        write(tmp_path / "in" / f"{name}.mcap", filmed(FILM + shift, lambda k: 5.0), ramp())
    found, rows = imported(tmp_path, tmp_path / "in", sensor)
    assert found["files"] == 2 and len(rows) == 2 * len(FILM)
    assert found["largest_gap_s"] == pytest.approx(0.003, abs=1e-6)


def mosaic(image, pattern):
    """An image (h, w, 3) as a Bayer sensor sees it, whose first rows are `pattern`, such as rggb."""
    colours = np.array(["rgb".index(letter) for letter in pattern]).reshape(2, 2)
    which = np.tile(colours, (image.shape[0] // 2, image.shape[1] // 2))
    return np.take_along_axis(image, which[..., None], 2)[..., 0]


def packed(image, first_chroma):
    """An image as packed YUV 4:2:2 (ITU-R BT.601, video range), chroma first or luma first."""
    red, green, blue = (image[..., k].astype(float) / 255 for k in range(3))
    luma = 16 + 65.481 * red + 128.553 * green + 24.966 * blue
    u = 128 - 37.797 * red - 74.203 * green + 112 * blue
    v = 128 + 112 * red - 93.786 * green - 18.214 * blue
    chroma = np.stack([u[:, ::2], v[:, ::2]], 2).reshape(luma.shape)
    pair = (chroma, luma) if first_chroma else (luma, chroma)
    return np.rint(np.stack(pair, 2)).astype(np.uint8)


def with_alpha(image):
    return np.dstack([image, np.full(image.shape[:2], 128, np.uint8)])


def padded(image):
    """Rows with eight bytes behind them, as some drivers align them."""
    return np.hstack([image.reshape(240, -1), np.full((240, 8), 77, np.uint8)])


def jpeg(image):
    return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()


RAW = {
    "rgb8": raw,
    "bgr8": lambda image: raw(image[..., ::-1], "bgr8"),
    "rgba8": lambda image: raw(with_alpha(image), "rgba8", 4),
    "bgra8": lambda image: raw(with_alpha(image[..., ::-1]), "bgra8", 4),
    "rgb8 with padded rows": lambda image: raw(padded(image), step=968),
    "yuv422 with padded rows": lambda image: raw(padded(packed(image, True)), "yuv422", step=648),
    **{name: lambda image, name=name: raw(packed(image, True), name, 2) for name in ("yuv422", "uyvy")},
    **{name: lambda image, name=name: raw(packed(image, False), name, 2) for name in ("yuv422_yuy2", "yuyv")},
    **{
        f"bayer_{name}8": lambda image, name=name: raw(mosaic(image, name), f"bayer_{name}8", 1)
        for name in ("rggb", "bggr", "gbrg", "grbg")
    },
    "png": png,
    "jpeg": lambda image: {"format": "jpeg", "data": jpeg(image)},
    "image_transport jpeg": lambda image: {"format": "rgb8; jpeg compressed bgr8", "data": jpeg(image)},
    "image_transport png": lambda image: png(image) | {"format": "bgr8; png compressed bgr8"},
}


@pytest.mark.parametrize("encoding", RAW)
def test_encodings_that_cameras_write_are_read(tmp_path, sensor, encoding):
    image = coloured()
    images = [(START, {"header": ros.header(START, "gel"), **RAW[encoding](image)})]
    _, rows = imported(tmp_path, write(tmp_path / "a.mcap", images, ramp(3)), sensor)
    seen = cv2.imread(str(tmp_path / "lab" / rows[0]["image"]))[..., ::-1].astype(int)
    lossless = encoding.startswith(("rgb", "bgr", "png", "image_transport png"))
    assert np.abs(seen - image)[2:-2, 2:-2].max() <= (0 if lossless else 4)


def grey_png():
    return cv2.imencode(".png", coloured()[..., 0])[1].tobytes()


REFUSED = {
    "mono8": (lambda: raw(coloured()[..., 0], "mono8", 1), "monochrome; record the camera's colour topic"),
    "mono16": (lambda: raw(coloured()[..., 0].astype(np.uint16), "mono16", 2), "monochrome; record the camera's"),
    "8UC1": (lambda: raw(coloured()[..., 0], "8UC1", 1), "monochrome; record the camera's colour topic"),
    "grey as rgb8": (
        lambda: raw(np.repeat(coloured()[..., :1], 3, 2)),
        "no colours.*record the camera's colour topic",
    ),
    "grey png": (lambda: {"format": "mono8; png compressed ", "data": grey_png()}, "monochrome; record the camera's"),
    "bayer png": (lambda: {"format": "bayer_rggb8; png compressed ", "data": grey_png()}, "record it before"),
    "depth": (
        lambda: {"format": "16UC1; compressedDepth png", "data": grey_png()},
        "depth; record the camera's colour",
    ),
    "16 bits": (lambda: raw(coloured(), "bayer_rggb16", 2), "is not read; republish it as bgr8"),
    "nothing": (lambda: raw(coloured(), "", 3), "is not read; republish it as bgr8"),
    "cut": (lambda: raw(coloured()[:200]), "cut short"),
    "no width": (lambda: raw(coloured(), width=0), "cut short"),
    "half a pair": (lambda: raw(coloured()[:, :319, :2], "yuv422", 2, width=319), "record it as bgr8"),
    "other bytes": (lambda: {"format": "jpeg", "data": b"h264 or anything"}, "record PNG or JPEG"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_images_that_say_no_forces_are_refused_with_what_to_do(tmp_path, sensor, case):
    made, said = REFUSED[case]
    images = [(START, {"header": ros.header(START, "gel"), **made()})]
    path = write(tmp_path / "a.mcap", images, ramp(3))
    with pytest.raises(BadInput, match=rf"(?s)a\.mcap: topic {IMAGE}, message 1.*{said}"):
        imported(tmp_path, path, sensor)
    assert not (tmp_path / "lab").exists()


def test_a_dark_frame_is_no_monochrome_camera(tmp_path, sensor):
    """Many cameras begin with one."""
    images = [(START, {"header": ros.header(START, "gel"), **raw(np.full((240, 320, 3), 3, np.uint8))})]
    assert imported(tmp_path, write(tmp_path / "a.mcap", images, ramp(3)), sensor)[0]["images"] == 1


NAMES = ["GelSight Mini R0B 2BNN", "GelSight-Mini-R0B-2BNN", "GelSight_Mini_R0B_2BNN", "2BNN", "größe", "指", "a__b_", "x" * 300,
         "x" * 301, "mini_a"]  # fmt: skip


def test_topics_have_names_that_ros_2_allows_and_no_two_sensors_share_one():
    tokens = ros.topic_tokens(NAMES)
    assert list(tokens) != [] and set(tokens) == set(NAMES) and len(set(tokens.values())) == len(NAMES)
    for token in tokens.values():
        assert token.isascii() and token.replace("_", "").isalnum() and not token[0].isdigit()
        assert "__" not in token and not token.endswith("_") and len(f"/{token}/image/compressed") < 247
    assert tokens["mini_a"] == "mini_a" and tokens["GelSight_Mini_R0B_2BNN"] == "GelSight_Mini_R0B_2BNN"
    assert ros.topic_tokens(NAMES[:1])[NAMES[0]] == "GelSight_Mini_R0B_2BNN"


def test_an_export_of_a_sensor_with_blanks_has_legal_topics_and_frames(tmp_path):
    from mcap_ros2.reader import read_ros2_messages

    from gelforge.commands.export import export

    samples = lay(tmp_path, 4)
    for row in samples.rows:
        row["sensor_id"] = "GelSight Mini R0B 2BNN" if row["sensor_id"] == "mini_a" else "GelSight-Mini R0B 2BNN"
    export(samples, "mcap", tmp_path / "out.mcap")
    found, _ = read_mcap(tmp_path / "out.mcap")
    assert {row["sensor_id"] for row, *_ in found.values()} == {row["sensor_id"] for row in samples.rows}
    topics = {}
    for message in read_ros2_messages(str(tmp_path / "out.mcap")):
        frame = getattr(getattr(message.ros_msg, "header", None), "frame_id", "")
        topics[message.channel.topic] = frame
    assert {topic.split("/")[1] for topic in topics} == {
        "facts", "GelSight_Mini_R0B_2BNN", "GelSight_Mini_R0B_2BNN_2",
    }  # fmt: skip
    assert all(set(topic) <= set("/_") | {c for c in topic if c.isascii() and c.isalnum()} for topic in topics)
    assert {frame for frame in topics.values() if frame} == {
        "GelSight_Mini_R0B_2BNN_gel",
        "GelSight_Mini_R0B_2BNN_2_gel",
    }
