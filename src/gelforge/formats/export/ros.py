"""Messages of ROS 2 that recordings hold, in the words of the message definitions, and names that ROS 2 allows."""

import re
from collections.abc import Iterable

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


def header(nanoseconds: int, frame: str) -> dict:
    """std_msgs/Header."""
    return {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}, "frame_id": frame}


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
