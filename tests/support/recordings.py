"""Recordings of robots: images and wrenches in MCAP (ROS 2, Foxglove's protobuf, JSON) and in bags.

Each is written by the library of its format.
"""

import base64
from fractions import Fraction
from pathlib import Path

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
    """An image (240, 320, 3) so smooth that chroma subsampling and Bayer patterns do not change it."""
    return np.ascontiguousarray(np.tile(LIGHTS, (240, 1, 1))) + np.uint8(shade)


def raw(image, encoding="rgb8", channels=3, step=None, height=240, width=320):
    """sensor_msgs/Image without its header, with pixels as in memory."""
    return {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": step or channels * width,
            "data": image.tobytes()}  # fmt: skip


def png(image):
    return {"format": "png", "data": cv2.imencode(".png", image[..., ::-1])[1].tobytes()}


def wrench(stamp, force, **other):
    still = dict.fromkeys("xyz", 0.0)
    return {"header": ros.header(stamp, "ft"), "wrench": {"force": still | {"z": force} | other, "torque": still}}


def write(path, images, wrenches, bare=False):
    """Write a recording of images and wrenches, (log time, message) each; bare: wrenches without a header."""
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
    """Wrenches every 10 ms with a growing force, which gives the time at which a wrench was paired with an image."""
    return [
        (START + k * 10 * MS + delay, wrench(START + k * 10 * MS + clock, -NEWTONS_A_SECOND * k / 100))
        for k in range(count)
    ]


def filmed(times, delay, clock=0):
    """Images stamped at `times` in ms, each logged `delay(k)` ms after its stamp."""
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


def stamped(kind, time, data, form):
    """A message of Foxglove's schema `kind`."""
    import foxglove.messages as schemas

    stamp = schemas.Timestamp(sec=time // 10**9, nsec=time % 10**9)
    return getattr(schemas, kind)(timestamp=stamp, frame_id="gel", data=data, format=form)


def encoded(images):
    """H.264 of images (h, w, 3) RGB, the bytes of each frame."""
    import av

    height, width = images[0].shape[:2]
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.time_base = width, height, "yuv420p", Fraction(1, 25)
    codec.options = {"tune": "zerolatency", "preset": "ultrafast", "crf": "4", "bf": "0"}
    found = []
    for at, image in enumerate(images):
        frame = av.VideoFrame.from_ndarray(image, format="rgb24")
        frame.pts = at
        found += [bytes(packet) for packet in codec.encode(frame)]
    return found + [bytes(packet) for packet in codec.encode(None)]


def write_foxglove(path, images, forces, form):
    """Write images (time, array) as protobuf or JSON, and wrenches (time, (3,) N) as JSON of a custom schema."""
    import foxglove
    from foxglove.channels import CompressedImageChannel, CompressedVideoChannel

    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        if form == "json":
            channel = foxglove.Channel(IMAGE, message_encoding="json", context=context)
            for time, image in images:
                data = base64.b64encode(cv2.imencode(".png", image[..., ::-1])[1]).decode()
                stamp = {"sec": time // 10**9, "nsec": time % 10**9}
                channel.log(
                    {"timestamp": stamp, "frame_id": "gel", "format": "png", "data": data}, log_time=time + MS
                )
        elif form == "video":
            channel = CompressedVideoChannel(IMAGE, context=context)
            for (time, _), data in zip(images, encoded([image for _, image in images]), strict=True):
                channel.log(stamped("CompressedVideo", time, data, "h264"), log_time=time + MS)
        else:
            channel = CompressedImageChannel(IMAGE, context=context)
            for time, image in images:
                channel.log(stamped("CompressedImage", time, png(image)["data"], "png"), log_time=time + MS)
        channel = foxglove.Channel(WRENCH, message_encoding="json", context=context)
        for time, force in forces:
            stamp = {"sec": time // 10**9, "nsec": time % 10**9}
            channel.log({"timestamp": stamp, "ati": {"data": [*force, 0.01, 0.02, 0.03]}}, log_time=time + MS)
    return path


def write_bag(path, images, forces):
    """The same as a bag of ROS 1 if the name ends in .bag, else of ROS 2."""
    from rosbags.rosbag1 import Writer as One
    from rosbags.rosbag2 import Writer as Two
    from rosbags.typesys import Stores, get_typestore

    old = Path(path).suffix == ".bag"
    types = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)
    header = types.types["std_msgs/msg/Header"]

    def headed(time):
        stamp = types.types["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
        return header(**({"seq": 0} if old else {}), stamp=stamp, frame_id="gel")

    kinds = {IMAGE: "sensor_msgs/msg/CompressedImage", WRENCH: "geometry_msgs/msg/WrenchStamped"}
    vector, both = (types.types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Wrench"))
    said = [(IMAGE, time, types.types[kinds[IMAGE]](header=headed(time), format="png", data=np.frombuffer(png(image)["data"], np.uint8)))
            for time, image in images]  # fmt: skip
    said += [(WRENCH, time, types.types[kinds[WRENCH]](header=headed(time), wrench=both(force=vector(*force), torque=vector(0.01, 0.02, 0.03))))
             for time, force in forces]  # fmt: skip
    encode = types.serialize_ros1 if old else types.serialize_cdr
    with One(path) if old else Two(path, version=9) as writer:
        topics = {topic: writer.add_connection(topic, kind, typestore=types) for topic, kind in kinds.items()}
        for topic, time, message in sorted(said, key=lambda one: one[1]):
            writer.write(topics[topic], time + MS, encode(message, kinds[topic]))
    return path
