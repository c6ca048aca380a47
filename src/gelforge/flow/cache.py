"""Memory of what was solved or measured: files that are found again by what they were made from.

A file is named by a digest of that, or says it itself as its `key`. It is whole or absent (`files.publish`), and one that is broken
is made anew.
"""

import csv
import fcntl
import hashlib
import json
import os
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from gelforge.flow.files import publish, read_json, take, write_json

Value = TypeVar("Value")
# What reading a file that is not there, corrupt or hostile can raise in json, zipfile, zlib and numpy.
DAMAGED = (
    OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, MemoryError, NotImplementedError, OverflowError,
    SyntaxError, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def canonical(value: Any) -> str:
    """One text per value: sorted keys, no comments, exact floats."""
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def digest_of_value(value: Any) -> str:
    """SHA-256 of a value's canonical text, as hexadecimal digits."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the lock of a file: of several processes that miss it one makes it, and the others wait."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_name(f".{path.name}.lock").open("a") as lock:
        take(lock, fcntl.LOCK_EX)
        yield


def kept(
    path: Path, read: Callable[[Path], Value], make: Callable[[], Value], write: Callable[[Path, Value], None]
) -> Value:
    """What a file holds; where there is none that can be read, what `make` makes, which is then kept in it."""
    with alone(path):
        try:
            return read(path)
        except DAMAGED:
            made = make()
            with publish(path) as part:
                write(part, made)
            return made


def record_of(path: Path, key: str | None = None) -> dict[str, Any] | None:
    """The table of a JSON file, one made under `key` where that is given; None where there is no such."""
    try:
        record = read_json(path)
    except DAMAGED:
        return None
    return record if isinstance(record, dict) and key in (None, record.get("key")) else None


class FileValues:
    """Values read from files; path: where they are kept."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.known: dict[str, Any] = record_of(path) or {}
        self.seen: dict[str, Any] = {}

    def of(self, file: Path | str, read: Callable[[Path], Any]) -> Any:
        """What `read` finds in a file, a value of JSON; None where there is no file, or it cannot be read."""
        try:
            state = os.stat(file)
            now = [state.st_mtime_ns, state.st_size]
            match self.known.get(str(file)):
                case [*before, found] if before == now:
                    pass
                case _:
                    found = read(Path(file))
        except (OSError, ValueError, csv.Error):
            return None
        self.seen[str(file)] = [*now, found]
        return found

    def keep(self) -> None:
        """Write what changed; where nothing can be written, files are read again."""
        if self.seen != self.known:
            with suppress(OSError):
                write_json(self.path, self.seen)
