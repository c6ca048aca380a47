"""The reader of .npz files, our own or foreign: it checks them against a schema and never unpickles."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import DAMAGED
from gelforge.records.regular import file_fault

MOST_SAID = 200  # most characters of an error in a message: numpy quotes whole headers
Form = tuple[str, int]  # numpy's dtype kind (of KINDS), number of dimensions
KINDS = {"U": "text", "f": "floats", "i": "whole numbers"}


def in_short(error: BaseException) -> str:
    """Text of an error about corrupt bytes, cut to MOST_SAID characters."""
    return str(error)[:MOST_SAID]


@dataclass(frozen=True)
class Schema:
    """Required and optional arrays of a kind of file, by name; what: the kind, for messages."""

    what: str
    arrays: Mapping[str, Form]
    optional: Mapping[str, Form] = field(default_factory=dict)


def read_arrays(path: str | Path, schema: Schema, hint: str) -> dict[str, np.ndarray]:
    """All arrays of a file by name; BadInput if it does not match its schema. hint: what to do about it."""
    with Archive(path, schema, hint) as file:
        return {name: file[name] for name in (*schema.arrays, *(name for name in schema.optional if name in file))}


class Archive:
    """Arrays of a file by name, each read and checked on access; BadInput as `read_arrays`."""

    def __init__(self, path: str | Path, schema: Schema, hint: str):
        self.path, self.schema, self.hint = Path(path), schema, hint
        fault = file_fault(self.path)
        if fault:
            raise self._bad(fault)
        try:
            self._file = np.load(self.path, allow_pickle=False)
        except DAMAGED as error:
            raise self._bad(in_short(error)) from error
        if not isinstance(self._file, np.lib.npyio.NpzFile):
            raise self._bad("it is not an archive")

    def __enter__(self) -> "Archive":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __contains__(self, name: str) -> bool:
        return name in self._file

    def __getitem__(self, name: str) -> np.ndarray:
        kinds, dims = {**self.schema.arrays, **self.schema.optional}[name]
        if name not in self:
            raise self._bad(f"array {name} is missing; it has {', '.join(self._file)[:MOST_SAID]}")
        try:
            found = self._file[name]
        except DAMAGED as error:
            raise self._bad(f"array {name}: {in_short(error)}") from error
        if not isinstance(found, np.ndarray) or found.dtype.kind not in kinds or found.ndim != dims:
            seen = f"{found.dtype} {found.shape}" if isinstance(found, np.ndarray) else "no array"
            raise self._bad(f"array {name} is {seen}, expected {dims}-dimensional {KINDS[kinds]}")
        return found

    def get(self, name: str, default: np.ndarray) -> np.ndarray:
        """One array, or `default` if the file lacks it."""
        if name not in self:
            return default
        return self[name]

    def _bad(self, fault: str) -> BadInput:
        return BadInput(f"{self.path}: not {self.schema.what} ({fault}); {self.hint}")
