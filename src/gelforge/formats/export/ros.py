"""Messages of ROS 2 that recordings and live views hold: their definitions, their bytes, and one sensor's topics.

Topics are /SENSOR/… (its name as ROS 2 allows it): `image/compressed` (sensor_msgs/CompressedImage), `wrench`
(geometry_msgs/WrenchStamped, total force in the gel frame, no torque), `forces/normal`, `forces/along_x` and
`forces/along_y` (sensor_msgs/Image, 32FC1, N per cell).
"""

import re
import struct
from collections.abc import Iterable, Sequence
from typing import IO, Any

import numpy as np

# Fields of each type (https://docs.ros.org, the packages common_interfaces and rcl_interfaces), NAME=VALUE a constant.
DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/Image": "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
    "uint32 step\nuint8[] data",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "diagnostic_msgs/KeyValue": "string key\nstring value",
    "diagnostic_msgs/DiagnosticStatus": "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\n"
    "string message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
}
NUMBERS = {"byte": "<B", "uint8": "<B", "int32": "<i", "uint32": "<I", "float64": "<d"}
CDR_LITTLE_ENDIAN = b"\0\1\0\0"
MAPS = ("along_x", "along_y", "normal")  # of force along each axis of the gel

Message = tuple[str, str, dict]  # topic, type (PACKAGE/msg/NAME), fields


def fields(kind: str) -> list[tuple[str, str]]:
    """(type, name) of each field of PACKAGE/NAME."""
    lines = [line.split() for line in DEFINITIONS[kind].splitlines()]
    return [(of, name) for of, name in lines if "=" not in name]


def schema(kind: str) -> str:
    """Definition of PACKAGE/msg/NAME with those of all types in it, as MCAP and Foxglove want it (ros2msg)."""
    needed = [kind.replace("/msg/", "/")]
    for each in needed:
        inner = [of.removesuffix("[]") for of, _ in fields(each)]
        needed += [of for of in dict.fromkeys(inner) if of in DEFINITIONS and of not in needed]
    first, *others = needed
    return "\n".join([DEFINITIONS[first], *(f"{'=' * 80}\nMSG: {name}\n{DEFINITIONS[name]}" for name in others)])


def encode(kind: str, message: dict) -> bytes:
    """A message of PACKAGE/msg/NAME as CDR: each number aligned to its size (OMG DDS-XTypes 1.3, 7.4.3)."""
    out = bytearray()
    _put(out, kind.replace("/msg/", "/"), message)
    return CDR_LITTLE_ENDIAN + bytes(out)


def _put(out: bytearray, kind: str, value: Any) -> None:
    if kind in NUMBERS:
        number = struct.pack(NUMBERS[kind], value)
        out += bytes(-len(out) % len(number)) + number
    elif kind == "string":
        text = value.encode() + b"\0"
        _put(out, "uint32", len(text))
        out += text
    elif kind == "uint8[]":
        _put(out, "uint32", len(value))
        out += value
    elif kind.endswith("[]"):
        _put(out, "uint32", len(value))
        for each in value:
            _put(out, kind.removesuffix("[]"), each)
    else:
        for of, name in fields(kind):
            _put(out, of, value[name])


class RosWriter:
    """Writes messages as MCAP of profile ros2; `finish` makes it whole."""

    def __init__(self, stream: IO[bytes], chunk_bytes: int):
        from mcap.writer import CompressionType, Writer

        # Pictures are compressed already; LZ4 takes the maps, which are mostly zero, in no time.
        self.writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.LZ4)
        self.writer.start(profile="ros2", library="gelforge")
        self.schemas: dict[str, int] = {}
        self.channels: dict[str, int] = {}

    def write(self, time_ns: int, topic: str, kind: str, content: bytes) -> None:
        """Write one encoded message."""
        if kind not in self.schemas:
            self.schemas[kind] = self.writer.register_schema(kind, "ros2msg", schema(kind).encode())
        if topic not in self.channels:
            self.channels[topic] = self.writer.register_channel(topic, "cdr", self.schemas[kind])
        self.writer.add_message(self.channels[topic], log_time=time_ns, data=content, publish_time=time_ns)

    def finish(self) -> None:
        """Write what is held, and the index."""
        self.writer.finish()


def header(nanoseconds: int, frame: str) -> dict:
    """std_msgs/Header."""
    return {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}, "frame_id": frame}


def wrench(stamp: dict, force: Sequence[float]) -> dict:
    """geometry_msgs/WrenchStamped of a force (3,) N along gel x, y, z."""
    no_torque = dict.fromkeys("xyz", 0.0)
    return {
        "header": stamp,
        "wrench": {"force": dict(zip("xyz", map(float, force), strict=True)), "torque": no_torque},
    }


def sensor_messages(
    token: str, time: int, picture: bytes, form: str, total: Sequence[float], label: np.ndarray
) -> list[Message]:
    """Picture, total force and force maps of one frame.

    token: the sensor in names of topics and frames (`topic_tokens`). time: ns since 1970. picture: a file of format
    `form` (jpeg, png). total: (3,) N along gel x, y, z. label: (3, rows, cols) N per cell along the same.
    """
    top, stamp = f"/{token}", header(time, f"{token}_gel")
    maps = np.ascontiguousarray(label, "<f4")
    found: list[Message] = [
        (f"{top}/image/compressed", "sensor_msgs/msg/CompressedImage", {"header": stamp, "format": form, "data": picture}),
        (f"{top}/wrench", "geometry_msgs/msg/WrenchStamped", wrench(stamp, total)),
    ]  # fmt: skip
    for name, grid in zip(MAPS, maps, strict=True):
        image = {"header": stamp, "height": grid.shape[0], "width": grid.shape[1], "encoding": "32FC1",
                 "is_bigendian": 0, "step": 4 * grid.shape[1], "data": grid.tobytes()}  # fmt: skip
        found.append((f"{top}/forces/{name}", "sensor_msgs/msg/Image", image))
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
