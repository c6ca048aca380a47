"""Readings of a running sensor as messages of ROS 2, the same for a live view and for a recording.

Beside the topics of `formats.export.ros`: `wrench/low` and `wrench/high` (the 90 % intervals of force and moment, where the
network has them) and `flag` (diagnostic_msgs/DiagnosticArray: WARN with its reason, or OK; the values are the reading's row).
"""

import time

import numpy as np

from gelforge.formats.export import ros
from gelforge.live.reading import Reading
from gelforge.records.press import N_M

OK, WARN = 0, 1  # levels of a DiagnosticStatus


class RosMessages:
    """Turns readings of one sensor into messages.

    A stamp is the time at which the stream began plus the reading's time.
    """

    def __init__(self, sensor: str, start_ns: int | None = None):
        self.sensor, self.start_ns = sensor, time.time_ns() if start_ns is None else start_ns
        self.token = ros.topic_tokens([sensor])[sensor]

    def __call__(self, reading: Reading) -> tuple[int, list[ros.Message]]:
        """Time in ns since 1970, and the messages of a reading."""
        stamp, force = self.start_ns + round(1e9 * reading.time_s), reading.found
        found = ros.sensor_messages(self.token, stamp, reading.jpeg, "jpeg", force.wrench.tolist(), force.cells)
        top, header = f"/{self.token}", ros.header(stamp, f"{self.token}_gel")
        if force.half_width is not None and force.moment_half_width is not None:
            half = np.concatenate([force.half_width, N_M * force.moment_half_width])
            for name, ends in (("low", force.wrench - half), ("high", force.wrench + half)):
                found.append((f"{top}/wrench/{name}", ros.wrench(header, ends.tolist())))
        values = [
            ros.message("diagnostic_msgs/msg/KeyValue", key=key, value="" if value is None else str(value))
            for key, value in reading.row().items()
        ]
        status = ros.message(
            "diagnostic_msgs/msg/DiagnosticStatus", level=WARN if force.flag else OK, name="reading",
            message=force.reason or "OK", hardware_id=self.sensor, values=values,
        )  # fmt: skip
        found.append(
            (f"{top}/flag", ros.message("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[status]))
        )
        return stamp, found
