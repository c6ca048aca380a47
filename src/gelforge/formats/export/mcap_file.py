"""MCAP with messages of ROS 2, as Foxglove opens it (https://mcap.dev, profile ros2).

Topics of each sensor, /SENSOR/… (its name as ROS 2 allows it): `image/compressed` (sensor_msgs/CompressedImage, the picture's file), `wrench`
(geometry_msgs/WrenchStamped, total force of the label in the gel frame, no torque), `forces/normal`, `forces/along_x`
and `forces/along_y` (sensor_msgs/Image, 32FC1, N per cell), and `sample` (std_msgs/String, the row of samples.csv as
JSON). Samples are a second apart from a start that is the same in every file, because a label has no time of its own.
The first message, on /facts, says what the numbers mean.
"""

import json
from pathlib import Path

import numpy as np

from gelforge.formats.export import ros
from gelforge.formats.export.samples import Sample, Samples
from gelforge.records.axes import CHANNEL_OF_AXIS

START_NS = 1_767_225_600 * 10**9  # 2026-01-01
NAMES = ("along_x", "along_y", "normal")  # of the maps of force along each axis of the gel
SCHEMAS = {
    "sensor_msgs/msg/CompressedImage": ros.COMPRESSED_IMAGE,
    "sensor_msgs/msg/Image": ros.IMAGE,
    "geometry_msgs/msg/WrenchStamped": ros.WRENCH_STAMPED,
    "std_msgs/msg/String": ros.STRING,
}


def messages(sample: Sample, token: str, time: int) -> list[tuple[str, str, dict]]:
    """(topic, type, message) of one sample; token: its sensor in the names of topics and frames."""
    top, frame = f"/{token}", f"{token}_gel"
    stamp = ros.header(time, frame)
    force = dict(zip("xyz", sample.total(), strict=True))
    found: list[tuple[str, str, dict]] = [
        (f"{top}/image/compressed", "sensor_msgs/msg/CompressedImage",
         {"header": stamp, "format": sample.media_type.removeprefix("image/"), "data": sample.picture}),
        (f"{top}/wrench", "geometry_msgs/msg/WrenchStamped",
         {"header": stamp, "wrench": {"force": force, "torque": {"x": 0.0, "y": 0.0, "z": 0.0}}}),
        (f"{top}/sample", "std_msgs/msg/String", {"data": json.dumps(sample.row)}),
    ]  # fmt: skip
    for name, channel in zip(NAMES, CHANNEL_OF_AXIS, strict=True):
        grid = np.ascontiguousarray(sample.label[channel], "<f4")
        image = {"header": stamp, "height": grid.shape[0], "width": grid.shape[1], "encoding": "32FC1",
                 "is_bigendian": 0, "step": 4 * grid.shape[1], "data": grid.tobytes()}  # fmt: skip
        found.append((f"{top}/forces/{name}", "sensor_msgs/msg/Image", image))
    return found


def write(path: Path, samples: Samples) -> None:
    """Write one file."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        # Pictures are compressed already; LZ4 takes the maps, which are mostly zero, in no time.
        writer = Writer(stream, chunk_size=4 * 2**20, compression=CompressionType.LZ4)
        schemas = {name: writer.register_msgdef(name, text) for name, text in SCHEMAS.items()}
        facts = {"data": samples.facts_text()}
        writer.write_message(
            "/facts", schemas["std_msgs/msg/String"], facts, log_time=START_NS, publish_time=START_NS
        )
        tokens = ros.topic_tokens(row["sensor_id"] for row in samples.rows)
        for at, sample in enumerate(samples):
            time = START_NS + at * 10**9
            for topic, kind, message in messages(sample, tokens[sample.row["sensor_id"]], time):
                writer.write_message(topic, schemas[kind], message, log_time=time, publish_time=time)
        writer.finish()
