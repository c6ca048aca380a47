"""Readings in files: MCAP with messages of ROS 2, and a CSV table."""

import contextlib
import csv
import itertools
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from gelforge.errors import BadInput
from gelforge.formats.export import ros
from gelforge.live.reading import COLUMNS, Reading
from gelforge.live.topics import RosMessages
from gelforge.records.table import GrowingTable

CHUNK_BYTES = 2**18  # small, so that a full disk is noticed within a second


class McapRecording:
    """A recording in a folder, named by its start time: complete once it is ended, absent if it fails.

    BadInput where nothing can be written there.
    """

    def __init__(self, folder: Path, messages: RosMessages):
        self.messages, self.count = messages, 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.path, self.stream = self._begun(folder)
        except OSError as error:
            raise BadInput(
                f"{folder}: nothing can be recorded there ({error.strerror}); name another --record"
            ) from error
        self.writer = ros.RosWriter(self.stream, CHUNK_BYTES)

    @property
    def part(self) -> Path:
        """Path of the file until it is complete."""
        return self.path.with_name(f".{self.path.name}.part")

    def _begun(self, folder: Path) -> tuple[Path, IO[bytes]]:
        """A path that no other recording has, and its open file: two sensors may begin in the same second."""
        stem = time.strftime("%Y%m%d-%H%M%S")
        for k in itertools.count():
            self.path = folder / f"{stem}{f'-{k}' if k else ''}.mcap"
            with contextlib.suppress(FileExistsError):
                stream = self.part.open("xb")
                if not self.path.exists():
                    return self.path, stream
                stream.close()
                self.part.unlink()
        raise AssertionError

    def send(self, reading: Reading) -> None:
        """Record a reading; a full disk ends and removes the recording with BadInput."""
        stamp, messages = self.messages(reading)
        try:
            for topic, said in messages:
                self.writer.write(stamp, topic, said)
        except OSError as error:
            raise self._lost(error) from error
        self.count += 1

    def _lost(self, error: OSError) -> BadInput:
        self.drop()
        return BadInput(
            f"{self.path}: the recording is lost ({error.strerror}); free space or permissions, then record again"
        )

    def drop(self) -> None:
        """Give up what was recorded so far."""
        with contextlib.suppress(OSError):  # what could not be written is dropped
            self.stream.close()
        with contextlib.suppress(OSError):  # a file that cannot be removed is hidden, and no recording
            self.part.unlink(missing_ok=True)

    def end(self) -> str:
        """Publish the recording unless it is empty; return a message. BadInput where it cannot be completed."""
        if not self.count:
            self.drop()
            return f"{self.path}: no frame was read, nothing is recorded"
        try:
            self.writer.finish()
            self.stream.close()
            os.replace(self.part, self.path)
        except OSError as error:
            raise self._lost(error) from error
        return f"{self.path}: {self.count} frames"


class CsvTable:
    """A table with one row per reading, in a file or, for the path -, on standard output.

    BadInput where it cannot be written. A file always ends with a complete row.
    """

    def __init__(self, path: Path):
        self.path, self.count, self.flagged = path, 0, 0
        self.table: GrowingTable | None = None
        self.add: Callable[[dict], object]
        if str(path) == "-":
            self.add = csv.DictWriter(sys.stdout, COLUMNS, lineterminator="\n").writerow
            self.add(dict(zip(COLUMNS, COLUMNS, strict=True)))
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self.table = GrowingTable(path, COLUMNS)
        except OSError as error:
            raise BadInput(f"{path}: cannot be written ({error.strerror}); name another file") from error
        self.add = self.table.add

    def send(self, reading: Reading) -> None:
        """Write the row of a reading."""
        try:
            self.add(reading.row())
            if not self.table:
                sys.stdout.flush()
        except BrokenPipeError:
            raise  # the reader of standard output has closed it
        except OSError as error:
            raise BadInput(
                f"{self.path}: cannot be written ({error.strerror}); free space or name another file"
            ) from error
        self.count += 1
        self.flagged += reading.found.flag

    def drop(self) -> None:
        """Close the file after its last complete row."""
        if self.table:
            self.table.close()

    def end(self) -> str:
        """Close the file; return a message."""
        self.drop()
        return f"{self.path}: {self.count} frames read; {self.flagged} flagged"
