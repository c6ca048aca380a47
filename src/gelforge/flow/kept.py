"""What was read from many files, kept in one by their times and sizes: each is read once, not at every look.

Only the standard library, because every step of a run asks for it.
"""

import csv
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from gelforge.flow.files import read_json, write_json


class Kept:
    """Values read from files; path: where they are kept."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.known: dict[str, Any] = {}
        self.seen: dict[str, Any] = {}
        with suppress(OSError, ValueError, AttributeError):  # none yet, or damaged: files are read once more
            self.known = dict(read_json(path).items())

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
