"""Readings of a running sensor as messages of ROS 2, the same for a live view and for a recording.

Beside the topics of `formats.export.ros`: `wrench/low` and `wrench/high` (the 90 % interval of the total force, where the
network has one) and `flag` (diagnostic_msgs/DiagnosticArray: WARN with its reason, or OK; the values are the reading's row).
"""

import time

from gelforge.formats.export import ros
from gelforge.live.reading import Reading
from gelforge.records.image import encode_jpeg
from gelforge.reporting.parts import JPEG_QUALITY

Encoded = tuple[str, str, bytes]  # topic, type, CDR
OK, WARN = 0, 1  # levels of a DiagnosticStatus


class RosMessages:
    """Turns readings of one sensor into encoded messages.

    Stamps are the time at which the stream began plus the reading's own.
    """

    def __init__(self, sensor: str, start_ns: int | None = None):
        self.sensor, self.start_ns = sensor, time.time_ns() if start_ns is None else start_ns
        self.token = ros.topic_tokens([sensor])[sensor]

    def __call__(self, reading: Reading) -> tuple[int, list[Encoded]]:
        """Time in ns since 1970, and the messages of a reading."""
        stamp = self.start_ns + round(1e9 * reading.time_s)
        return stamp, [(topic, kind, ros.encode(kind, said)) for topic, kind, said in self.messages(reading, stamp)]

    def messages(self, reading: Reading, stamp: int) -> list[ros.Message]:
        """The messages of a reading, not encoded."""
        force = reading.found
        total = force.total
        picture = encode_jpeg(reading.image, JPEG_QUALITY)
        found = ros.sensor_messages(self.token, stamp, picture, "jpeg", total.tolist(), force.cells)
        top, header = f"/{self.token}", ros.header(stamp, f"{self.token}_gel")
        if force.half_width is not None:
            half = force.half_width
            for name, ends in (("low", total - half), ("high", total + half)):
                found.append((f"{top}/wrench/{name}", "geometry_msgs/msg/WrenchStamped", ros.wrench(header, ends)))
        status = {
            "level": WARN if force.flag else OK, "name": "reading", "message": force.reason or "OK",
            "hardware_id": self.sensor,
            "values": [{"key": key, "value": "" if value is None else str(value)} for key, value in reading.row().items()],
        }  # fmt: skip
        found.append((f"{top}/flag", "diagnostic_msgs/msg/DiagnosticArray", {"header": header, "status": [status]}))
        return found
