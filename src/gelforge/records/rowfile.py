"""Rows of large .npy files, read when they are asked for."""

import mmap
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import DAMAGED
from gelforge.records.arrays import in_short

LET_GO = 512  # rows between two flushes
HINT = "remove it and make the dataset again"


def map_array(path: Path) -> np.memmap:
    """Map a .npy file for reading; pickled content is refused."""
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except DAMAGED as error:
        raise BadInput(f"{path}: not a readable .npy array ({in_short(error)}); {HINT}") from None


def array_on_disk(path: Path, dtype: type, shape: tuple[int, ...]) -> np.memmap:
    """A new .npy file mapped for writing; OSError if the disk has no room for all of it.

    The space is allocated at once, because writing to a mapped page on a full disk kills the process.
    """
    mapped = np.lib.format.open_memmap(path, "w+", dtype, shape)
    with path.open("r+b") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, mapped.offset + mapped.nbytes)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error
    return mapped


def write_rows(path: Path, dtype: type, shape: tuple[int, ...], rows: Iterable[np.ndarray]) -> None:
    """Write a .npy file row by row; OSError if the disk has no room for all of it.

    Written pages are flushed and dropped every LET_GO rows; otherwise they count as memory of the process.
    """
    mapped = array_on_disk(path, dtype, shape)
    for at, row in enumerate(rows):
        mapped[at] = row
        if at % LET_GO == LET_GO - 1:
            mapped.flush()
            mapped._mmap.madvise(mmap.MADV_DONTNEED)  # type: ignore[attr-defined]  # numpy's underlying mmap
    mapped.flush()


class Rows(ABC):
    """An array whose rows are read on each access, by a number, a slice or a list of numbers."""

    shape: tuple[int, ...]
    dtype: np.dtype
    ndim: int

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: int | np.integer | slice | Sequence[int] | np.ndarray) -> np.ndarray:
        required = np.arange(len(self))[rows]
        found = np.empty((*required.shape, *self.shape[1:]), self.dtype)
        self._read(required.ravel(), found.reshape(-1, *self.shape[1:]))
        return found

    @abstractmethod
    def _read(self, rows: np.ndarray, into: np.ndarray) -> None:
        """Read rows (k,) by their numbers into an array (k, …)."""


class RowFile(Rows):
    """An array of a .npy file whose rows are read from the file.

    It is not mapped, because every page of a mapped array that was accessed counts as memory of the process. Raises
    BadInput for a file of another kind, and for one that was truncated after it was opened.
    """

    def __init__(self, path: Path):
        mapped = map_array(path)
        if mapped.ndim < 2 or not mapped.flags.c_contiguous:
            raise BadInput(f"{path}: its rows do not lie one after another; {HINT}")
        self.path, self.shape, self.dtype, self.ndim = path, mapped.shape, mapped.dtype, mapped.ndim
        self._first, self._size = mapped.offset, mapped.nbytes // max(len(mapped), 1)
        self._file = path.open("rb", buffering=0)

    def _read(self, rows: np.ndarray, into: np.ndarray) -> None:
        for row, one in zip(rows.tolist(), into, strict=True):
            place = self._first + row * self._size
            if os.preadv(self._file.fileno(), [memoryview(one).cast("B")], place) != self._size:
                raise BadInput(f"{self.path}: ends before its row {row}; {HINT}")


class ChainedRows(Rows):
    """Rows of several arrays, concatenated; arrays: of shapes (n_i, …) that differ only in n_i."""

    def __init__(self, arrays: Sequence[np.ndarray | Rows]):
        self._arrays = tuple(arrays)
        self._ends = np.cumsum([len(array) for array in arrays])
        first = self._arrays[0]
        self.shape, self.dtype, self.ndim = (int(self._ends[-1]), *first.shape[1:]), first.dtype, first.ndim

    def _read(self, rows: np.ndarray, into: np.ndarray) -> None:
        of = np.searchsorted(self._ends, rows, side="right")
        for number in np.unique(of):
            mine = np.flatnonzero(of == number)
            array = self._arrays[number]
            into[mine] = array[rows[mine] - (self._ends[number] - len(array))]
