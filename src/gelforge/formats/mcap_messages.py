"""Messages of ROS 2 in an MCAP file, read from its beginning to its end by the library, which checks each chunk's checksum.

Source: https://mcap.dev/spec. The summary at the end counts the messages, so that a chunk whose head is damaged is missed.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO, Any

from gelforge.errors import BadInput
from gelforge.records.regular import file_fault

LATEST_NS = 2**63 - 1  # in the year 2262


def messages(path: Path, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    """(topic, log time in ns, message) of topics, in the order of the file; BadInput for one that is damaged or cannot be read.

    Some damage is noticed only at the end: nothing may be kept of what came before.
    """
    if fault := file_fault(path):
        raise BadInput(f"{path}: cannot be read ({fault}); give a recording in MCAP")
    with path.open("rb") as stream:
        try:
            yield from _decoded(path, stream, topics)
        except (BadInput, ModuleNotFoundError):
            raise
        # a corrupt file makes mcap, the ROS definitions in it, LZ4, Zstandard and struct each raise errors of their own
        except Exception as error:
            raise BadInput(f"{path}: cannot be read as MCAP with ROS 2 messages ({str(error)[:200] or type(error).__name__}); record it again, mend it with `mcap recover`, or unpack what was recorded with --compression-mode by `zstd -d` or `ros2 bag convert`") from error  # fmt: skip


def _decoded(path: Path, stream: IO[bytes], topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    from mcap_ros2.decoder import DecoderFactory  # isort: skip, it brings mcap
    from mcap.exceptions import DecoderNotFoundError
    from mcap.reader import NonSeekingReader, make_reader

    reader = NonSeekingReader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
    seen = Counter[int]()
    try:
        for _, channel, message, said in reader.iter_decoded_messages(topics, log_time_order=False):
            seen[channel.id] += 1
            if message.log_time > LATEST_NS:
                raise ValueError(f"a message of time {message.log_time}, ns since 1970")
            yield channel.topic, message.log_time, said
    except DecoderNotFoundError as error:
        raise BadInput(
            f"{path}: {', '.join(topics)} holds no ROS 2 messages ({error}); convert the recording to ROS 2, as rosbags-convert"
            " does"
        ) from error
    stream.seek(0)
    summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        return
    counted = summary.statistics.channel_message_counts
    for number, channel in summary.channels.items():
        if channel.topic in topics and counted.get(number, 0) != seen[number]:
            raise ValueError(f"{seen[number]} messages of {channel.topic} are there of {counted.get(number, 0)}")
