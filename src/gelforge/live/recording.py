"""Recordings of a running sensor: kept as JSON lines, and replayed."""

import contextlib
import json
import os
import re
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TextIO

from gelforge.errors import BadInput

NAME = re.compile(r"[0-9]{8}-[0-9]{6}(-[0-9]+)?")


class Recorder:
    """Keeps events as JSON lines, one file a recording: whole when it is stopped, absent when it fails."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.lock = threading.Lock()
        self.stream: TextIO | None = None
        self.name, self.count = "", 0

    @property
    def on(self) -> bool:
        return self.stream is not None

    def part(self) -> Path:
        return self.folder / f".{self.name}.part"

    def start(self) -> str:
        """Begin a recording; return its name."""
        with self.lock:
            if self.on:
                return self.name
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                stem = time.strftime("%Y%m%d-%H%M%S")
                taken = (f"{stem}-{k}" if k else stem for k in range(1000))
                self.name = next(name for name in taken if not (self.folder / f"{name}.jsonl").exists())
                self.count = 0
                self.stream = self.part().open("w", encoding="utf-8")
            except OSError as error:
                raise BadInput(
                    f"{self.folder}: nothing can be recorded there ({error.strerror}); name another --record"
                ) from error
            return self.name

    def add(self, event: dict) -> None:
        """Record an event, if a recording runs; a full disk ends and removes it with BadInput."""
        with self.lock:
            if self.stream is None:
                return
            try:
                self.stream.write(json.dumps(event) + "\n")
                self.stream.flush()
                self.count += 1
            except OSError as error:
                self.drop()
                raise BadInput(
                    f"{self.folder}: the recording stopped ({error.strerror}) and was removed; free space"
                ) from error

    def drop(self) -> None:
        """Give up what was recorded so far."""
        stream, self.stream = self.stream, None
        try:
            if stream is not None:
                stream.close()
        except OSError:
            pass  # what could not be written is not wanted
        self.part().unlink(missing_ok=True)

    def stop(self) -> int:
        """End a recording and publish it; return how many readings it has. One without any is not kept."""
        with self.lock:
            if self.stream is None:
                return 0
            if not self.count:
                self.drop()
                return 0
            self.stream.close()
            self.stream = None
            os.replace(self.part(), self.folder / f"{self.name}.jsonl")
            return self.count

    def names(self) -> list[str]:
        """Recordings there are, the latest first."""
        return sorted((path.stem for path in self.folder.glob("*.jsonl") if NAME.fullmatch(path.stem)), reverse=True)

    def read(self, name: str) -> Iterator[dict]:
        """Events of a recording; BadInput for a name that is none."""
        if not NAME.fullmatch(name) or name not in self.names():
            raise BadInput(f"recording {name!r}: there is none of that name in {self.folder}")
        return _events(self.folder / f"{name}.jsonl")


def _events(path: Path) -> Iterator[dict]:
    """Events of a recording, read as they are asked for; what is none is left out."""
    with path.open(encoding="utf-8") as stream:
        for line in stream:
            with contextlib.suppress(ValueError):
                event = json.loads(line)
                if isinstance(event, dict) and isinstance(event.get("time_s"), int | float):
                    yield event


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
