"""Messages of ROS 2 that recordings and live views hold: one sensor's topics, by rosbags' types, in MCAP by its own library.

Topics are /SENSOR/… (its name as ROS 2 allows it): `image/compressed` (sensor_msgs/CompressedImage), `wrench`
(geometry_msgs/WrenchStamped, total force in the gel frame, no torque), `forces/normal`, `forces/along_x` and
`forces/along_y` (sensor_msgs/Image, 32FC1, N per cell).
"""

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import IO, Any

import numpy as np

MAPS = ("along_x", "along_y", "normal")  # of force along each axis of the gel

Message = tuple[str, Any]  # topic, message of rosbags' types


@cache
def _types() -> Any:
    """rosbags' definitions of ROS 2's own messages."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def message(kind: str, **fields: Any) -> Any:
    """A message of PACKAGE/msg/NAME."""
    return _types().types[kind](**fields)


def schema(kind: str) -> str:
    """Definition of PACKAGE/msg/NAME with those of all types in it, as MCAP and Foxglove want it (ros2msg)."""
    return _types().generate_msgdef(kind, ros_version=2)[0]


def encode(said: Any) -> bytes:
    """A message as CDR."""
    return bytes(_types().serialize_cdr(said, said.__msgtype__))


class RosWriter:
    """Writes messages as MCAP of profile ros2; `finish` makes it whole."""

    def __init__(self, stream: IO[bytes], chunk_bytes: int):
        from mcap.writer import CompressionType, Writer

        # Pictures are compressed already; LZ4 takes the maps, which are mostly zero, in no time.
        self.writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.LZ4)
        self.writer.start(profile="ros2", library="gelforge")
        self.schemas: dict[str, int] = {}
        self.channels: dict[str, int] = {}

    def write(self, time_ns: int, topic: str, said: Any) -> None:
        """Write one message."""
        kind = said.__msgtype__
        if kind not in self.schemas:
            self.schemas[kind] = self.writer.register_schema(kind, "ros2msg", schema(kind).encode())
        if topic not in self.channels:
            self.channels[topic] = self.writer.register_channel(topic, "cdr", self.schemas[kind])
        self.writer.add_message(self.channels[topic], log_time=time_ns, data=encode(said), publish_time=time_ns)

    def finish(self) -> None:
        """Write what is held, and the index."""
        self.writer.finish()


def header(nanoseconds: int, frame: str) -> Any:
    """std_msgs/Header."""
    stamp = message("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def wrench(stamp: Any, force: Sequence[float]) -> Any:
    """geometry_msgs/WrenchStamped of a force (3,) N along gel x, y, z; stamp: its header."""
    force_of, torque = (
        message("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, values), strict=True)))
        for values in (force, np.zeros(3))
    )
    both = message("geometry_msgs/msg/Wrench", force=force_of, torque=torque)
    return message("geometry_msgs/msg/WrenchStamped", header=stamp, wrench=both)


def sensor_messages(
    token: str, time: int, picture: bytes, form: str, total: Sequence[float], label: np.ndarray
) -> list[Message]:
    """Picture, total force and force maps of one frame.

    token: the sensor in names of topics and frames (`topic_tokens`). time: ns since 1970. picture: a file of format
    `form` (jpeg, png). total: (3,) N along gel x, y, z. label: (3, rows, cols) N per cell along the same.
    """
    top, stamp = f"/{token}", header(time, f"{token}_gel")
    data = np.frombuffer(picture, np.uint8)
    found: list[Message] = [
        (f"{top}/image/compressed", message("sensor_msgs/msg/CompressedImage", header=stamp, format=form, data=data)),
        (f"{top}/wrench", wrench(stamp, total)),
    ]
    for name, grid in zip(MAPS, np.ascontiguousarray(label, "<f4"), strict=True):
        rows, cols = grid.shape
        image = message(
            "sensor_msgs/msg/Image", header=stamp, height=rows, width=cols, encoding="32FC1", is_bigendian=0,
            step=4 * cols, data=grid.view(np.uint8).ravel(),
        )  # fmt: skip
        found.append((f"{top}/forces/{name}", image))
    return found


LONGEST_TOKEN = 100  # characters; a whole topic name may have 247 (rmw_validate_full_topic_name)


def topic_tokens(names: Iterable[str]) -> dict[str, str]:
    """Each name as a token of a ROS 2 topic, no two alike: letters, digits and single underscores, no digit first.

    A legal name stays as it is, and a name keeps its token whatever names follow it.
    """
    names = list(dict.fromkeys(names))
    tokens = {name: name for name in names if _token(name) == name}
    taken = set(tokens)
    for name in names:
        if name in tokens:
            continue
        stem = token = _token(name)
        number = 1
        while token in taken:
            number += 1
            token = f"{stem}_{number}"
        tokens[name] = token
        taken.add(token)
    return tokens


def _token(name: str) -> str:
    """A name with what ROS 2 forbids replaced (design.ros2.org, topic and service names)."""
    token = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", name))[:LONGEST_TOKEN].rstrip("_")
    return token if token[:1].isalpha() else f"sensor_{token.lstrip('_')}".rstrip("_")
