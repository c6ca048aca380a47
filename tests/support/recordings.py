"""Recordings of robots in MCAP: images and wrenches with messages of ROS 2, as the library of MCAP writes them."""

import cv2
import numpy as np

from gelforge.flow.files import read_csv, write_text
from gelforge.formats.export import ros
from gelforge.formats.mcap_import import Topics, import_recordings

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


def coloured(shade=0):
    """A smooth image, (240, 320, 3): chroma of half resolution and Bayer patterns lose nothing of it."""
    return np.ascontiguousarray(np.tile(LIGHTS, (240, 1, 1))) + np.uint8(shade)


def raw(image, encoding="rgb8", channels=3, step=None, height=240, width=320):
    """sensor_msgs/Image without its header, of pixels as they lie in memory."""
    return {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": step or channels * width,
            "data": image.tobytes()}  # fmt: skip


def png(image):
    return {"format": "png", "data": cv2.imencode(".png", image[..., ::-1])[1].tobytes()}


def wrench(stamp, force, **other):
    still = dict.fromkeys("xyz", 0.0)
    return {"header": ros.header(stamp, "ft"), "wrench": {"force": still | {"z": force} | other, "torque": still}}


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
