"""MCAP with messages of ROS 2, as Foxglove opens it (https://mcap.dev, profile ros2).

Topics of each sensor are those of `ros.sensor_messages` and /SENSOR/sample (std_msgs/String, the row of samples.csv as
JSON). Samples are one second apart, from the same start in every file, because a label has no time of its own.
The first message, on /facts, states units, frame and calibration.
"""

import json
from pathlib import Path
from typing import Any

from gelforge.formats.export import ros
from gelforge.formats.export.samples import Sample, Samples

START_NS = 1_767_225_600 * 10**9  # 2026-01-01


def text(said: str) -> Any:
    """std_msgs/String."""
    return ros.message("std_msgs/msg/String", data=said)


def messages(sample: Sample, token: str, time: int) -> list[ros.Message]:
    """Messages of one sample; token: name of its sensor in topics and frames."""
    form = sample.media_type.removeprefix("image/")
    row = (f"/{token}/sample", text(json.dumps(sample.cells)))
    return [*ros.sensor_messages(token, time, sample.picture, form, sample.wrench(), sample.label), row]


def write(path: Path, samples: Samples) -> None:
    """Write one file."""
    with path.open("wb") as stream:
        writer = ros.RosWriter(stream, 4 * 2**20)
        writer.write(START_NS, "/facts", text(samples.facts_text()))
        tokens = ros.topic_tokens(row["sensor_id"] for row in samples.rows)
        for at, sample in enumerate(samples):
            time = START_NS + at * 10**9
            for topic, said in messages(sample, tokens[sample.row["sensor_id"]], time):
                writer.write(time, topic, said)
        writer.finish()
