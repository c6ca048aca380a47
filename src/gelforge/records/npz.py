"""Archives of arrays (.npz) that others may have written: read by numpy, which runs nothing of them, and checked."""

from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import DAMAGED
from gelforge.records.regular import file_fault

MOST_SAID = 200  # characters of an error: numpy quotes a header whole


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

    def array(self, name: str, kinds: str, dims: int) -> np.ndarray:
        """One array of `dims` dimensions whose numpy kind is one of `kinds` ("U" text, "f" floats, "iu" integers)."""
        if name not in self:
            raise self._bad(f"array {name} is missing; it has {', '.join(self._file)[:200]}")
        try:
            found = self._file[name]
        except DAMAGED as error:
            raise self._bad(f"array {name}: {in_short(error)}") from error
        if not isinstance(found, np.ndarray) or found.dtype.kind not in kinds or found.ndim != dims:
            seen = f"{found.dtype} {found.shape}" if isinstance(found, np.ndarray) else "no array"
            raise self._bad(f"array {name} is {seen}, which it cannot be")
        return found

    def _bad(self, fault: str) -> BadInput:
        return BadInput(f"{self.path}: not {self.what} ({fault}); {self.hint}")
