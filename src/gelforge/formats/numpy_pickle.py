"""Reader of .npy files that hold a pickled dict, as FEATS' do: Python's unpickler, held to what numpy.save writes.

Its `find_class` knows numpy's constructors alone, so no file can call anything else. numpy's own `__setstate__` trusts what it
is given: the constructors are those of this module, which check types and sizes before numpy makes an array.
Source: CPython's pickletools; numpy.lib.format for the container.
"""

import io
import math
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import DAMAGED
from gelforge.records.npz import in_short
from gelforge.records.regular import file_fault

LARGEST_FILE = 2**30
PLAIN_TYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248]|c8|c16|[US][0-9]{1,4})")


class Refused(ValueError):
    """Why a pickle is not read."""


class Name:
    """A name that a file mentions: called with what the file says, and without a state that a file could set."""

    __slots__ = ("make",)

    def __init__(self, make: Callable | None):
        self.make = make

    def __call__(self, *arguments: Any) -> Any:
        if self.make is None:
            raise Refused("a call of numpy.ndarray")
        return self.make(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise Refused("a state for a name")


class Type:
    """A numpy type as a file describes it."""

    __slots__ = ("code", "order")
    order: Any

    def __init__(self, code: Any, *_: Any):
        self.code, self.order = str(code), "="

    def __setstate__(self, state: Any) -> None:
        _, order, *fields = state
        if any(part is not None for part in fields[:3]):
            raise Refused("a structured numpy type; only arrays of numbers and text are read")
        self.order = "=" if order == "|" else order

    def plain(self) -> np.dtype:
        """The type of numbers or text; any other is refused."""
        if not PLAIN_TYPE.fullmatch(self.code):
            raise Refused(f"an array of type {self.code[:40]!r}; only numbers and text are read")
        return np.dtype(self.code).newbyteorder(self.order)


class Array(np.ndarray):
    """An array whose state is checked before numpy takes it."""

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, fortran, data = state
        if not (
            isinstance(shape, tuple) and len(shape) <= 8 and all(type(n) is int and 0 <= n < 2**31 for n in shape)
        ):
            raise Refused("an array whose shape is not a few whole numbers")
        size = math.prod(shape)
        objects = kind.code in ("O", "O8")
        found = np.dtype("O") if objects else kind.plain()
        expected = size if objects else size * found.itemsize
        if type(data) is not (list if objects else bytes) or len(data) != expected:
            raise Refused(f"an array of shape {shape} and type {found} whose content does not fit it")
        checked: Any = 1, shape, found, bool(fortran), data
        super().__setstate__(checked)


def reconstruct(kind: Any, *_: Any) -> Array:
    """An empty array, as numpy's `_reconstruct` makes one; its state follows."""
    if kind is not NDARRAY:
        raise Refused("numpy's _reconstruct of something that is no plain array")
    return Array(0, np.uint8)


def scalar(kind: Type, data: bytes) -> Any:
    """A numpy number or text of its bytes."""
    found = kind.plain()
    if type(data) is not bytes or len(data) != found.itemsize:
        raise Refused(f"a numpy scalar of type {found} whose bytes do not fit it")
    return np.frombuffer(data, found)[0]


NDARRAY = Name(None)
NAMES = {
    "numpy.ndarray": NDARRAY,
    "numpy.dtype": Name(Type),
    **{f"numpy.{core}.multiarray._reconstruct": Name(reconstruct) for core in ("core", "_core")},
    **{f"numpy.{core}.multiarray.scalar": Name(scalar) for core in ("core", "_core")},
}


class Unpickler(pickle.Unpickler):
    """Python's unpickler, for which there are no names but numpy's constructors."""

    def find_class(self, module: str, name: str) -> Name:
        """The constructor of this module that stands for a name; any other name is refused."""
        full = f"{module}.{name}"
        if full not in NAMES:
            raise Refused(f"the name {full[:80]}")
        return NAMES[full]


def read_npy(path: str | Path) -> Any:
    """Read a .npy file, pickled or not; no code of the file runs.

    A 0-d object array gives the object in it, as numpy's .item() would. A file that is truncated, hostile or holds anything
    but arrays, scalars and plain containers raises BadInput that names it.
    """
    path = Path(path)
    if fault := file_fault(path):
        raise BadInput(f"{path}: cannot be read ({fault}); give a .npy file")
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise Refused(f"more than {LARGEST_FILE >> 20} MiB")
        with path.open("rb") as stream:
            return _read(stream)
    except Refused as error:
        raise BadInput(
            f"{path}: refused, it holds {error}; only numpy arrays, scalars and plain containers are read; save the"
            " sample again with numpy.save"
        ) from error
    except (*DAMAGED, pickle.UnpicklingError, AttributeError, IndexError) as error:
        raise BadInput(f"{path}: truncated or not a .npy file ({in_short(error)}); copy it again") from error


def _read(stream: Any) -> Any:
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise Refused(f"version {version} of the .npy format")
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = read_header(stream)
    body = stream.read()
    if kind.hasobject:
        value = Unpickler(io.BytesIO(body)).load()
        if not isinstance(value, Array) or value.dtype != object or value.shape != shape:
            raise Refused("a pickle that is not the object array its header promises")
        return _as_numpy(value[()] if shape == () else value)
    if kind.names or not PLAIN_TYPE.fullmatch(kind.str):
        raise Refused(f"an array of type {kind}")
    size = math.prod(shape)
    if len(body) != size * kind.itemsize:
        raise ValueError(f"{len(body)} bytes where shape {shape} of {kind} needs {size * kind.itemsize}")
    return np.frombuffer(body, kind, size).reshape(shape, order="F" if fortran else "C")


def _as_numpy(value: Any) -> Any:
    """An array, or a dict of arrays, without this module's class of arrays."""
    if isinstance(value, dict):
        return {name: each.view(np.ndarray) if isinstance(each, Array) else each for name, each in value.items()}
    return value.view(np.ndarray) if isinstance(value, Array) else value
