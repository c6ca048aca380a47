"""MCAP with messages of ROS 2, as Foxglove opens it (https://mcap.dev, profile ros2).

Topics of each sensor are those of `ros.sensor_messages` and /SENSOR/sample (std_msgs/String, the row of samples.csv as
JSON). Samples are a second apart from a start that is the same in every file, because a label has no time of its own.
The first message, on /facts, says what the numbers mean.
"""

import json
from pathlib import Path

from gelforge.formats.export import ros
from gelforge.formats.export.samples import Sample, Samples

STRING = "std_msgs/msg/String"
START_NS = 1_767_225_600 * 10**9  # 2026-01-01


def messages(sample: Sample, token: str, time: int) -> list[ros.Message]:
    """Messages of one sample; token: its sensor in the names of topics and frames."""
    form = sample.media_type.removeprefix("image/")
    row = (f"/{token}/sample", STRING, {"data": json.dumps(sample.cells)})
    return [*ros.sensor_messages(token, time, sample.picture, form, sample.total(), sample.label), row]


def write(path: Path, samples: Samples) -> None:
    """Write one file."""
    with path.open("wb") as stream:
        writer = ros.RosWriter(stream, 4 * 2**20)
        facts = {"data": samples.facts_text()}
        writer.write(START_NS, "/facts", STRING, ros.encode(STRING, facts))
        tokens = ros.topic_tokens(row["sensor_id"] for row in samples.rows)
        for at, sample in enumerate(samples):
            time = START_NS + at * 10**9
            for topic, kind, message in messages(sample, tokens[sample.row["sensor_id"]], time):
                writer.write(time, topic, kind, ros.encode(kind, message))
        writer.finish()
