"""Messages of ROS 2 in an MCAP file, read from its beginning to its end and held to every checksum that it has.

Source: https://mcap.dev/spec. Each chunk of messages has a checksum, and so has the summary at the end. The summary also counts
the messages, so that a chunk whose head is damaged is missed. The library does not look at the checksums of attachments.
"""

import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO, Any

from gelforge.errors import BadInput
from gelforge.records.regular import file_fault

LATEST_NS = 2**63 - 1  # in the year 2262
MCAP = b"\x89MCAP0\r\n"  # what a file begins with
ZSTD = b"\x28\xb5\x2f\xfd"  # what a Zstandard frame begins with (RFC 8878, 3.1.1)
AFTER_SUMMARY = 12  # bytes behind what the summary's checksum is of: itself, and the file's last eight
ATTACHMENT, DATA_END = 0x09, 0x0F  # opcodes
UNCHECKED = "has no checksums, so damage to it would not be noticed"


def messages(path: Path, topics: Collection[str], notes: list[str] | None = None) -> Iterator[tuple[str, int, Any]]:
    """(topic, log time in ns, message) of topics, in the order of the file; BadInput for one that is damaged or cannot be read.

    Some damage is noticed only at the end: nothing may be kept of what came before. notes: takes what to report of the file.
    """
    if fault := file_fault(path):
        raise BadInput(f"{path}: cannot be read ({fault}); give a recording in MCAP")
    with path.open("rb") as stream:
        if stream.read(len(ZSTD)) == ZSTD:
            whole = path.with_suffix("") if ".mcap" in path.stem else "NAME.mcap"
            raise BadInput(
                f"{path}: is compressed as a whole; decompress it with `zstd -d {path} -o {whole}` and import what that makes"
            )
        stream.seek(0)
        try:
            yield from _decoded(path, stream, topics, notes)
        except (BadInput, ModuleNotFoundError):
            raise
        # a corrupt file makes mcap, the ROS definitions in it, LZ4, Zstandard and struct each raise errors of their own
        except Exception as error:
            raise BadInput(f"{path}: cannot be read as MCAP with ROS 2 messages ({str(error)[:200] or type(error).__name__}); record it again, mend it with `mcap recover`, or unpack by `ros2 bag convert` what was recorded with --compression-mode") from error  # fmt: skip


def _decoded(
    path: Path, stream: IO[bytes], topics: Collection[str], notes: list[str] | None
) -> Iterator[tuple[str, int, Any]]:
    from mcap_ros2.decoder import DecoderFactory  # isort: skip, it brings mcap
    from mcap import records as of
    from mcap.stream_reader import StreamReader, breakup_chunk

    factory = DecoderFactory()
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    count, unchecked = 0, False
    for outer in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
        checked = isinstance(outer, of.Chunk) and outer.uncompressed_crc != 0
        for record in breakup_chunk(outer, validate_crc=True) if isinstance(outer, of.Chunk) else [outer]:
            if isinstance(record, of.Schema):
                schemas[record.id] = record
            elif isinstance(record, of.Channel):
                channels[record.id] = record
            elif isinstance(record, of.Statistics) and record.message_count != count:
                raise ValueError(f"{count} messages are there of {record.message_count}")
            elif isinstance(record, of.Footer):
                _check_summary(stream, record)
                _check_attachments(stream)
            elif isinstance(record, of.Message):
                count += 1
                unchecked |= not checked
                channel = channels[record.channel_id]
                if channel.topic not in topics:
                    continue
                decode = factory.decoder_for(channel.message_encoding, schemas.get(channel.schema_id))
                if decode is None:
                    raise BadInput(
                        f"{path}: topic {channel.topic} holds no ROS 2 messages ({channel.message_encoding}); convert the"
                        " recording to ROS 2, as rosbags-convert does"
                    )
                if record.log_time > LATEST_NS:
                    raise ValueError(f"a message of time {record.log_time}, ns since 1970")
                yield channel.topic, record.log_time, decode(record.data)
    if unchecked and notes is not None:
        notes.append(UNCHECKED)


def _check_attachments(stream: IO[bytes]) -> None:
    """ValueError where an attachment is not that of its checksum, its last four bytes; 0 is none."""
    place = stream.tell()
    stream.seek(len(MCAP))
    while len(head := stream.read(9)) == 9:
        kind, size = struct.unpack("<BQ", head)
        if kind == DATA_END:
            break
        if kind != ATTACHMENT:
            stream.seek(size, 1)
            continue
        body = memoryview(stream.read(size))
        checksum = int.from_bytes(body[-4:], "little")
        if checksum and zlib.crc32(body[:-4]) != checksum:
            raise ValueError("an attachment is not that of its checksum")
    stream.seek(place)


def _check_summary(stream: IO[bytes], footer: Any) -> None:
    """ValueError where the index at the end of the file is not that of its checksum."""
    place = stream.tell()
    stream.seek(-AFTER_SUMMARY, 2)
    end = stream.tell()
    stream.seek(footer.summary_start)
    if (
        footer.summary_start
        and footer.summary_crc
        and zlib.crc32(stream.read(end - footer.summary_start)) != footer.summary_crc
    ):
        raise ValueError("its index is not that of its checksum")
    stream.seek(place)
