"""MCAP with messages of ROS 2, as Foxglove opens it (https://mcap.dev, profile ros2).

Topics of each sensor are those of `ros.sensor_messages` and /SENSOR/sample (std_msgs/String, the row of samples.csv as
JSON). Samples are a second apart from a start that is the same in every file, because a label has no time of its own.
The first message, on /facts, says what the numbers mean.
"""

import json
from pathlib import Path

from gelforge.formats.export import ros
from gelforge.formats.export.samples import Sample, Samples

START_NS = 1_767_225_600 * 10**9  # 2026-01-01


def messages(sample: Sample, token: str, time: int) -> list[ros.Message]:
    """Messages of one sample; token: its sensor in the names of topics and frames."""
    form = sample.media_type.removeprefix("image/")
    row = (f"/{token}/sample", "std_msgs/msg/String", {"data": json.dumps(sample.row)})
    return [*ros.sensor_messages(token, time, sample.picture, form, sample.total(), sample.label), row]


def write(path: Path, samples: Samples) -> None:
    """Write one file."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        # Pictures are compressed already; LZ4 takes the maps, which are mostly zero, in no time.
        writer = Writer(stream, chunk_size=4 * 2**20, compression=CompressionType.LZ4)
        schemas = {name: writer.register_msgdef(name, text) for name, text in ros.SCHEMAS.items()}
        facts = {"data": samples.facts_text()}
        writer.write_message(
            "/facts", schemas["std_msgs/msg/String"], facts, log_time=START_NS, publish_time=START_NS
        )
        tokens = ros.topic_tokens(row["sensor_id"] for row in samples.rows)
        for at, sample in enumerate(samples):
            time = START_NS + at * 10**9
            for topic, kind, message in messages(sample, tokens[sample.row["sensor_id"]], time):
                writer.write_message(topic, schemas[kind], message, log_time=time, publish_time=time)
        writer.finish()
