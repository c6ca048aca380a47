"""Messages of ROS 2 that recordings and live views hold: their definitions, names that ROS 2 allows, and one sensor's topics.

Topics are /SENSOR/… (its name as ROS 2 allows it): `image/compressed` (sensor_msgs/CompressedImage), `wrench`
(geometry_msgs/WrenchStamped, total force in the gel frame, no torque), `forces/normal`, `forces/along_x` and
`forces/along_y` (sensor_msgs/Image, 32FC1, N per cell).
"""

import re
from collections.abc import Iterable, Sequence

import numpy as np

from gelforge.records.axes import CHANNEL_OF_AXIS

HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""
COMPRESSED_IMAGE = f"std_msgs/Header header\nstring format\nuint8[] data\n{HEADER}"
IMAGE = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    f"uint8[] data\n{HEADER}"
)
WRENCH_STAMPED = f"""std_msgs/Header header
geometry_msgs/Wrench wrench
{HEADER}
================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z"""
STRING = "string data"
DIAGNOSTIC_ARRAY = f"""std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
{HEADER}
================================================================================
MSG: diagnostic_msgs/DiagnosticStatus
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
================================================================================
MSG: diagnostic_msgs/KeyValue
string key
string value"""

SCHEMAS = {
    "sensor_msgs/msg/CompressedImage": COMPRESSED_IMAGE,
    "sensor_msgs/msg/Image": IMAGE,
    "geometry_msgs/msg/WrenchStamped": WRENCH_STAMPED,
    "diagnostic_msgs/msg/DiagnosticArray": DIAGNOSTIC_ARRAY,
    "std_msgs/msg/String": STRING,
}
MAPS = ("along_x", "along_y", "normal")  # of force along each axis of the gel

Message = tuple[str, str, dict]  # topic, type, fields


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
    `form` (jpeg, png). total: (3,) N along gel x, y, z. label: (3, rows, cols) N per cell, channels as FEATS.
    """
    top, stamp = f"/{token}", header(time, f"{token}_gel")
    maps = np.ascontiguousarray(label[list(CHANNEL_OF_AXIS)], "<f4")
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
