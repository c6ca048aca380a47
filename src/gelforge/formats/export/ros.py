"""Messages of ROS 2 that recordings hold, in the words of the message definitions."""

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
