"""Files of arrays (.npz), of ours or of others: one reader, which checks them by a schema and runs nothing of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import DAMAGED
from gelforge.records.regular import file_fault

MOST_SAID = 200  # characters of an error: numpy quotes a header whole
Form = tuple[str, int]  # kinds of numpy ("U" text, "f" floats, "iu" whole numbers) and number of dimensions


def in_short(error: BaseException) -> str:
    """What an error says of corrupt bytes, cut to what a person reads."""
    return str(error)[:MOST_SAID]


@dataclass(frozen=True)
class Schema:
    """What a kind of file holds: arrays by name, and those that it may lack; what: the kind, for messages."""

    what: str
    arrays: Mapping[str, Form]
    optional: Mapping[str, Form] = field(default_factory=dict)


def read_arrays(path: str | Path, schema: Schema, hint: str) -> dict[str, np.ndarray]:
    """All arrays of a file by name; BadInput for one that is not as its schema says. hint: what to do about it."""
    with Archive(path, schema, hint) as file:
        return {name: file[name] for name in (*schema.arrays, *(name for name in schema.optional if name in file))}


class Archive:
    """Arrays of a file by name, each read and checked when asked for; BadInput as `read_arrays`."""

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
            raise self._bad("it is no archive")

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
            raise self._bad(f"array {name} is {seen}, which it cannot be")
        return found

    def get(self, name: str, default: np.ndarray) -> np.ndarray:
        """One array, or `default` where the file lacks it."""
        if name not in self:
            return default
        return self[name]

    def _bad(self, fault: str) -> BadInput:
        return BadInput(f"{self.path}: not {self.schema.what} ({fault}); {self.hint}")
