"""ROS 2 messages of recordings and live views, in rosbags' types, and a writer of MCAP by MCAP's own library.

Topics are /SENSOR/… (see `topic_tokens`): `image/compressed` (sensor_msgs/CompressedImage), `wrench`
(geometry_msgs/WrenchStamped, total force and its moment about the gel's apex, the origin of the gel frame, N and N m), `forces/normal`, `forces/along_x` and
`forces/along_y` (sensor_msgs/Image, 32FC1, N per cell).
"""

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import IO, Any

import numpy as np

MAPS = ("along_x", "along_y", "normal")  # force along gel x, y, z

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
    """Definition of PACKAGE/msg/NAME and of all types in it, as MCAP and Foxglove require it (ros2msg)."""
    return _types().generate_msgdef(kind, ros_version=2)[0]


def encode(said: Any) -> bytes:
    """A message as CDR."""
    return bytes(_types().serialize_cdr(said, said.__msgtype__))


class RosWriter:
    """Writes messages as MCAP of profile ros2; `finish` completes the file."""

    def __init__(self, stream: IO[bytes], chunk_bytes: int):
        from mcap.writer import CompressionType, Writer

        # Images are compressed already; LZ4 is fast, and enough for maps that are mostly zero.
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
        """Write what is buffered, and the index."""
        self.writer.finish()


def header(nanoseconds: int, frame: str) -> Any:
    """std_msgs/Header."""
    stamp = message("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def wrench(stamp: Any, values: Sequence[float]) -> Any:
    """geometry_msgs/WrenchStamped of force and moment (6,) N and N m along gel x, y, z; stamp: its header."""
    force_of, torque = (
        message("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, part), strict=True)))
        for part in (values[:3], values[3:])
    )
    both = message("geometry_msgs/msg/Wrench", force=force_of, torque=torque)
    return message("geometry_msgs/msg/WrenchStamped", header=stamp, wrench=both)


def sensor_messages(
    token: str, time: int, picture: bytes, form: str, total: Sequence[float], label: np.ndarray
) -> list[Message]:
    """Image, wrench and force maps of one frame as messages.

    token: name of the sensor in topics and frames (`topic_tokens`). time: ns since 1970. picture: bytes of an image
    file of format `form` (jpeg, png). total: (6,) N and N m along gel x, y, z. label: (3, rows, cols) N per cell along the
    same axes.
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
    """A distinct token of a ROS 2 topic for each name: letters, digits and single underscores, a letter first.

    A legal name is its own token, whatever the other names. The token of an illegal name depends on the legal names
    and on the illegal names before it: "a b" is a_b, or a_b_2 where a_b is a name, too.
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
