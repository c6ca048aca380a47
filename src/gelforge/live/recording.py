"""Recordings of a running sensor: kept as JSON lines, and replayed."""

import contextlib
import errno
import json
import os
import re
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any

from gelforge.errors import BadInput
from gelforge.formats.export import ros
from gelforge.live.topics import Encoded

NAME = re.compile(r"[0-9]{8}-[0-9]{6}(-[0-9]+)?")
MOST_A_SECOND = 1000  # recordings that may begin in one folder


class Recorder:
    """Keeps events as JSON lines, one file a recording: whole when it is stopped, absent when it fails.

    trouble: why the last recording failed, until another one begins; empty where it did not.
    """

    suffix = ".jsonl"

    def __init__(self, folder: Path):
        self.folder = folder
        self.lock = threading.Lock()
        self.stream: IO[Any] | None = None
        self.name, self.count, self.trouble = "", 0, ""

    @property
    def on(self) -> bool:
        return self.stream is not None

    def state(self) -> dict:
        """What pages are sent: whether a recording runs, and what became of the last one."""
        return {"recording": self.on, "trouble": self.trouble}

    def part(self, name: str) -> Path:
        """Where a recording goes while it runs."""
        return self.folder / f".{name}.part"

    def file(self, name: str) -> Path:
        """Where a recording lies when it is whole."""
        return self.folder / f"{name}{self.suffix}"

    def start(self) -> str:
        """Begin a recording; return its name."""
        with self.lock:
            if self.on:
                return self.name
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                self.name, self.stream = self._begun()
                self.count = 0
            except OSError as error:
                raise self._failed(
                    f"{self.folder}: nothing can be recorded there ({error.strerror}); name another --record"
                ) from error
            self.trouble = ""
            return self.name

    def _begun(self) -> tuple[str, IO[Any]]:
        """A new recording's name, which no other has, and the file it goes to.

        Two sensors may be asked in one second to record into one folder, each by a process of its own.
        """
        stem = time.strftime("%Y%m%d-%H%M%S")
        for k in range(MOST_A_SECOND):
            name = f"{stem}-{k}" if k else stem
            if self.file(name).exists():
                continue
            with contextlib.suppress(FileExistsError):
                stream = self._opened(self.part(name))
                if not self.file(name).exists():
                    return name, stream
                stream.close()  # the other has published its own meanwhile
                self.part(name).unlink()
        raise FileExistsError(errno.EEXIST, f"it has {MOST_A_SECOND} recordings of this second")

    def _opened(self, path: Path) -> IO[Any]:
        """A new file, which FileExistsError says there is."""
        return path.open("x", encoding="utf-8")

    def _write(self, stream: IO[Any], event) -> None:
        stream.write(json.dumps(event) + "\n")
        stream.flush()

    def _finish(self, stream: IO[Any]) -> None:
        stream.close()

    def add(self, event) -> None:
        """Record an event, if a recording runs; a full disk ends and removes it with BadInput."""
        with self.lock:
            if self.stream is None:
                return
            try:
                self._write(self.stream, event)
                self.count += 1
            except OSError as error:
                raise self._lost(error) from error

    def _lost(self, error: OSError) -> BadInput:
        """Give up a recording that the disk does not take; what to report of it."""
        self.drop()
        return self._failed(
            f"{self.folder}: the recording is lost ({error.strerror}); free space or permissions, then record again"
        )

    def _failed(self, sentence: str) -> BadInput:
        """The error of a recording, kept for pages that ask later."""
        error = BadInput(sentence)
        self.trouble = str(error)
        return error

    def drop(self) -> None:
        """Give up what was recorded so far."""
        stream, self.stream = self.stream, None
        with contextlib.suppress(OSError):  # what could not be written is dropped
            if stream is not None:
                stream.close()
        with contextlib.suppress(OSError):  # what a folder refuses to remove is hidden, and no recording
            self.part(self.name).unlink(missing_ok=True)

    def stop(self) -> int:
        """End a recording and publish it; return how many readings it has. One without any is not kept.

        Raises BadInput where it cannot be written to its end; it is removed then, and another one may be started.
        """
        with self.lock:
            if self.stream is None:
                return 0
            if not self.count:
                self.drop()
                return 0
            try:
                self._finish(self.stream)
                os.replace(self.part(self.name), self.file(self.name))
            except OSError as error:
                raise self._lost(error) from error
            self.stream = None
            return self.count

    def names(self) -> list[str]:
        """Recordings there are, the latest first; BadInput for a folder that cannot be looked into."""
        try:
            files = [path for path in self.folder.iterdir() if path.suffix == ".jsonl" and path.is_file()]
        except FileNotFoundError:  # the first recording makes it
            return []
        except OSError as error:
            raise BadInput(
                f"{self.folder}: cannot be read as a folder of recordings ({error.strerror}); name another --record"
            ) from error
        return sorted((path.stem for path in files if NAME.fullmatch(path.stem)), reverse=True)

    def read(self, name: str) -> Iterator[dict]:
        """Events of a recording; BadInput for a name that is none, and where its file ceases to be readable."""
        if not NAME.fullmatch(name) or name not in self.names():
            raise BadInput(f"recording {name!r}: there is none of that name in {self.folder}")
        return _events(self.file(name))


class McapRecorder(Recorder):
    """Keeps encoded messages (live.topics.RosMessages) as MCAP with the profile of ROS 2."""

    suffix = ".mcap"

    def _opened(self, path: Path) -> IO[Any]:
        from mcap.writer import CompressionType, Writer

        stream = path.open("xb")
        # Small chunks: a full disk is noticed within a second. LZ4 takes the maps, which are mostly zero, in no time.
        self.writer = Writer(stream, chunk_size=2**18, compression=CompressionType.LZ4)
        self.writer.start(profile="ros2", library="gelforge")
        self.channels: dict[str, int] = {}
        return stream

    def _write(self, stream: IO[Any], event: tuple[int, list[Encoded]]) -> None:  # noqa: ARG002, the writer has it
        time_ns, messages = event
        for topic, kind, content in messages:
            if topic not in self.channels:
                schema = self.writer.register_schema(kind, "ros2msg", ros.SCHEMAS[kind].encode())
                self.channels[topic] = self.writer.register_channel(topic, "cdr", schema)
            self.writer.add_message(self.channels[topic], log_time=time_ns, data=content, publish_time=time_ns)

    def _finish(self, stream: IO[Any]) -> None:
        self.writer.finish()
        stream.close()


def _events(path: Path) -> Iterator[dict]:
    """Events of a recording, read as they are asked for; what is none is left out."""
    try:
        with path.open("rb") as stream:
            for line in stream:
                with contextlib.suppress(ValueError):
                    event = json.loads(line)
                    if isinstance(event, dict) and isinstance(event.get("time_s"), int | float):
                        yield event
    except OSError as error:
        raise BadInput(f"{path}: the recording cannot be read ({error.strerror}); choose another one") from error


def paced(events: Iterable[dict]) -> Iterator[dict]:
    """Recorded events with the pauses they had."""
    before, count = None, 0
    for event in events:
        if before is not None:
            time.sleep(min(max(event["time_s"] - before, 0.0), 1.0))
        before = event["time_s"]
        count += 1
        yield event
    yield {"ended": f"the recording ended after {count} readings"}
