"""Decode messages of recordings: MCAP (ROS 2, protobuf, JSON), and bags of ROS 1 and ROS 2.

MCAP is read from start to end, and the checksum of each chunk is verified (https://mcap.dev/spec). Message counts are
compared with the summary at the end, which reveals chunks that are skipped because their header is corrupt.
"""

import json
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

from gelforge.errors import BadInput, printable
from gelforge.records.regular import file_fault

LATEST_NS = 2**63 - 1  # latest valid time, in the year 2262
BAG = ".bag"  # of ROS 1
ACTIVE = ".active"  # of a bag of ROS 1 while it is recorded
METADATA = "metadata.yaml"  # in the folder of a bag of ROS 2


def recordings_of(source: Path) -> tuple[list[Path], list[str]]:
    """Recordings in a folder and below, and notes on its other files. For a file, the file itself.

    MCAP files, ROS 1 bags, folders of ROS 2 bags; unfinished and compressed ones too, so that they are refused and not
    passed over.
    """
    if not source.is_dir():
        return ([source] if source.is_file() else []), []
    files = sorted(
        path
        for path in source.rglob("*")
        if path.is_file()
        and not any(part.startswith(".") and not part.startswith("._") for part in path.relative_to(source).parts)
    )
    bags = {path.parent for path in files if path.name == METADATA}
    found, companions, others = set(bags), [], []
    for path in files:
        name = path.name
        if bags & {path.parent, *path.parents}:
            continue
        if name.startswith("._"):
            companions.append(path)  # of a Mac: attributes of the file of the same name
        elif (
            name.endswith(".mcap")
            or _is_bag(path)
            or (re.search(r"\.mcap\.zst", name) and not path.with_suffix("").exists())
        ):
            found.add(path)
        elif ".db3" in name:
            found.add(path.parent)
        else:
            others.append(path)
    notes = []
    for paths, what in (
        (companions, "companion files of a Mac"),
        (others, "other files, no recordings by their names"),
    ):
        if paths:
            named = ", ".join(str(path.relative_to(source)) for path in paths[:5]) + (", …" if len(paths) > 5 else "")
            notes.append(f"{source}: {len(paths)} {what} are not read: {printable(named)}")
    return sorted(found), notes


def _is_bag(path: Path) -> bool:
    return path.name.endswith((BAG, f"{BAG}{ACTIVE}"))


def _unread(path: Path) -> str:
    """What to do about a recording that cannot be read as it lies there; empty where nothing is known."""
    if path.name.endswith(ACTIVE):
        return f"its recorder was killed, so it has no index: run `rosbag reindex {path.name}` and rename it to .bag"
    if path.is_dir() and not (path / METADATA).is_file():
        return f"a bag of ROS 2 without its {METADATA}: run `ros2 bag reindex {path.name}`"
    if path.is_dir() and (unlisted := _unlisted(path)):
        return f"its {METADATA} does not name {unlisted[0].name}, which lies beside it: run `ros2 bag reindex {path.name}`"
    if ".db3" in path.name:
        return f"a file of a bag of ROS 2: give its folder; without {METADATA} run `ros2 bag reindex` on it first"
    return ""


def _unlisted(bag: Path) -> list[Path]:
    """Recordings in the folder of a bag of ROS 2 that its metadata do not name, so that their messages would be lost."""
    text = (bag / METADATA).read_text(encoding="utf-8", errors="replace")
    found = sorted(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
    return [path for path in found if not re.search(rf"(?<![\w-]){re.escape(path.name)}\b", text)]


def messages(path: Path, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield (topic, log time in ns, message) of topics in file order; BadInput for a recording that cannot be read.

    Some corruption is noticed only at the end. The caller must then discard all messages of the file.
    """
    bag = _is_bag(path) or path.is_dir()
    if cure := _unread(path):
        raise BadInput(f"{path}: cannot be read: {cure}")
    if fault := "" if path.is_dir() else file_fault(path):
        raise BadInput(f"{path}: cannot be read ({fault}); give a recording in MCAP, or a bag")
    try:
        yield from (_of_bag if bag else _of_mcap)(path, topics)
    except (BadInput, ModuleNotFoundError):
        raise
    # a corrupt file makes mcap, the definitions in it, LZ4, Zstandard, SQLite and struct each raise errors of their own
    except Exception as error:
        mend = (
            f"run `{'ros2 bag reindex' if path.is_dir() else 'rosbag reindex'} {path.name}` if its recorder was killed, or record it again"
            if bag
            else "record it again, repair it with `mcap recover`, or decompress a recording of --compression-mode with `zstd -d` or `ros2 bag convert`"
        )
        raise BadInput(
            f"{path}: cannot be read as a recording ({str(error)[:200] or type(error).__name__}); {mend}"
        ) from error


def topics_in(path: Path) -> list[str]:
    """Sorted topics of a recording, for messages; none where they cannot be listed."""
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader

    try:
        if _is_bag(path) or path.is_dir():
            with AnyReader([path]) as bag:
                return sorted({connection.topic for connection in bag.connections})
        with path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
            return sorted({channel.topic for channel in summary.channels.values()}) if summary else []
    except Exception:  # as in `messages`: a corrupt file makes each library raise errors of its own
        return []


def _of_bag(path: Path, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in topics]
        for connection, time, content in reader.messages(wanted):
            yield connection.topic, _sound(time), reader.deserialize(content, connection.msgtype)


def _of_mcap(path: Path, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    with path.open("rb") as stream:
        yield from _decoded(path, stream, topics)


class Json:
    """A decoder factory of JSON for MCAP's library."""

    def decoder_for(self, encoding: str, _schema: Any) -> Callable[[bytes], Any] | None:
        """A function that turns a JSON message into an object with attributes; None for other encodings."""
        return (
            (lambda data: json.loads(data, object_hook=lambda part: SimpleNamespace(**part)))
            if encoding == "json"
            else None
        )


def _decoded(path: Path, stream: IO[bytes], topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    from mcap_ros2.decoder import DecoderFactory  # isort: skip, it brings mcap
    from mcap.exceptions import DecoderNotFoundError
    from mcap.reader import NonSeekingReader, make_reader
    from mcap_protobuf.decoder import DecoderFactory as Protobuf

    factories: list[Any] = [DecoderFactory(), Protobuf(), Json()]
    reader = NonSeekingReader(stream, validate_crcs=True, decoder_factories=factories)
    seen = Counter[int]()
    try:
        for _, channel, message, said in reader.iter_decoded_messages(topics, log_time_order=False):
            seen[channel.id] += 1
            yield channel.topic, _sound(message.log_time), said
    except DecoderNotFoundError as error:
        raise BadInput(
            f"{path}: messages of {', '.join(topics)} are neither ROS 2, protobuf nor JSON ({error}); record one of these, or convert a"
            " recording of ROS 1 with `rosbags-convert`"
        ) from error
    stream.seek(0)
    summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        return
    counted = summary.statistics.channel_message_counts
    for number, channel in summary.channels.items():
        if channel.topic in topics and counted.get(number, 0) != seen[number]:
            raise ValueError(f"{seen[number]} of {counted.get(number, 0)} messages of {channel.topic} were found")


def _sound(time: int) -> int:
    """A log time in ns; ValueError where it is beyond LATEST_NS."""
    if time > LATEST_NS:
        raise ValueError(f"a message has an impossible time, {time} ns since 1970")
    return time
