"""Archives of arrays (.npz) that others may have written: what a member claims is checked before it is read."""

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cache import DAMAGED
from gelforge.records.regular import file_fault

MOST_SAID = 200  # characters of an error: numpy quotes a header whole
# An archive may unpack to so many bytes whatever it has itself, and beyond that to so many times its own.
FREE_BYTES = 2**30
MOST_TIMES = 20


def in_short(error: BaseException) -> str:
    """What an error says of corrupt bytes, cut to what a person reads."""
    return str(error)[:MOST_SAID]


class Archive:
    """Arrays of an .npz by name, each read when asked for; what cannot be read raises BadInput.

    what: the kind of file, hint: what to do about a broken one, for the message.
    """

    def __init__(self, path: str | Path, what: str, hint: str):
        self.path, self.what, self.hint = Path(path), what, hint
        fault = file_fault(self.path)
        if fault:
            raise self._bad(fault)
        try:
            self._zip = zipfile.ZipFile(self.path)
        except DAMAGED as error:
            raise self._bad(in_short(error)) from error
        members = self._zip.infolist()
        claimed = sum(member.file_size for member in members)
        if claimed > max(FREE_BYTES, MOST_TIMES * self.path.stat().st_size):
            self._zip.close()
            raise self._bad(f"it would unpack to {claimed} bytes")
        self.names = {member.filename.removesuffix(".npy"): member for member in members}

    def __enter__(self) -> "Archive":
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def array(self, name: str, kinds: str, dims: int) -> np.ndarray[Any, Any]:
        """One array of `dims` dimensions whose numpy kind is one of `kinds` ("U" text, "f" floats, "iu" integers)."""
        if name not in self.names:
            raise self._bad(f"array {name} is missing; it has {', '.join(self.names)[:200]}")
        try:
            with self._zip.open(self.names[name]) as stream:
                version = np.lib.format.read_magic(stream)
                read = (
                    np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                )
                shape, by_columns, kind = read(stream)
                self._check(name, shape, kind, self.names[name].file_size, kinds, dims)
                data = bytearray(stream.read())  # to its end, where the checksum is looked at
                return np.ndarray(shape, kind, data, order="F" if by_columns else "C")
        except DAMAGED as error:
            raise self._bad(f"array {name}: {in_short(error)}") from error

    def _check(self, name: str, shape: tuple[int, ...], kind: Any, size: int, kinds: str, dims: int) -> None:
        if kind.kind not in kinds or len(shape) != dims:
            raise self._bad(f"array {name} is {kind} {shape}, which it cannot be")
        if math.prod(shape) * kind.itemsize > size:
            raise self._bad(f"array {name} claims {kind} {shape} and has {size} bytes")

    def _bad(self, fault: str) -> BadInput:
        return BadInput(f"{self.path}: not {self.what} ({fault}); {self.hint}")
