"""Reader of .npy files that hold a pickle, without Python's unpickler: nothing in the file is called.

A pickle is a program for a stack machine. This interprets the few instructions that numpy arrays, numpy
scalars and plain containers need, on its own stack, and refuses all others by name. The names that a
file may mention (numpy's constructors) stand for functions of this module. Source: CPython's
pickletools, protocols 0 to 5; numpy.lib.format for the container.
"""

import io
import pickletools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.npz import DAMAGED, in_short
from gelforge.records.regular import file_fault

LARGEST_FILE = 2**30
# A sample of FEATS takes some hundred instructions; each may leave an object of a hundred bytes on the stack.
MOST_INSTRUCTIONS = 200_000
DEEPEST = 64
PLAIN_TYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248]|c8|c16|[US][0-9]{1,6})")


class Refused(ValueError):
    """Why a pickle is not read."""


@dataclass(eq=False)
class _Name:
    """A name the file mentions; `make` builds what numpy would."""

    text: str
    make: object = None


@dataclass(eq=False)
class _Type:
    """A numpy type under construction."""

    code: str
    order: str = "|"

    def set_state(self, state):
        if not (isinstance(state, tuple) and len(state) >= 5 and state[1] in ("<", ">", "|", "=")):
            raise Refused("a numpy type with an unknown state")
        if any(part is not None for part in state[2:5]):
            raise Refused("a structured numpy type; only arrays of numbers and text are read")
        self.order = state[1]

    def finish(self) -> np.dtype:
        if not PLAIN_TYPE.fullmatch(self.code):
            raise Refused(f"an array of type {self.code[:40]!r}; only numbers and text are read")
        return np.dtype(self.code).newbyteorder("<" if self.order == "<" else ">" if self.order == ">" else "=")


@dataclass(eq=False)
class _Array:
    """A numpy array or scalar under construction."""

    shape: object = None
    type: object = None
    data: object = None
    fortran: bool = False
    scalar: bool = False

    def set_state(self, state):
        if not (isinstance(state, tuple) and len(state) == 5):
            raise Refused("a numpy array with an unknown state")
        _, self.shape, self.type, self.fortran, self.data = state


def _reconstruct(*args):
    if len(args) != 3 or getattr(args[0], "text", "") != "numpy.ndarray":
        raise Refused("numpy's _reconstruct of something that is no plain array")
    return _Array()


def _dtype(*args):
    if not args or not isinstance(args[0], str):
        raise Refused("a numpy type without a type code")
    return _Type(args[0])


def _scalar(*args):
    if len(args) != 2:
        raise Refused("a numpy scalar without its value")
    return _Array((), args[0], args[1], scalar=True)


def _frombuffer(*args):
    if len(args) != 4:
        raise Refused("a numpy array with an unknown state")
    return _Array(args[2], args[1], args[0], args[3] == "F")


def _encode(*args):
    if len(args) != 2 or args[1] != "latin1" or not isinstance(args[0], str):
        raise Refused("_codecs.encode of something that is no Latin-1 text")
    try:
        return args[0].encode("latin1")
    except UnicodeEncodeError as error:
        raise Refused("_codecs.encode of something that is no Latin-1 text") from error


def _bytes(*args):
    if args:
        raise Refused("a call of bytes")
    return b""


NAMES = {
    "numpy.ndarray": None,
    "numpy.dtype": _dtype,
    "_codecs.encode": _encode,
    "__builtin__.bytes": _bytes,
    "builtins.bytes": _bytes,  # protocol 2 writes empty bytes so
}
for _core in ("numpy.core", "numpy._core"):
    NAMES[f"{_core}.multiarray._reconstruct"] = _reconstruct
    NAMES[f"{_core}.multiarray.scalar"] = _scalar
    NAMES[f"{_core}.numeric._frombuffer"] = _frombuffer

MARK = object()
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
LITERALS = {
    "INT",
    "BININT",
    "BININT1",
    "BININT2",
    "LONG",
    "LONG1",
    "LONG4",
    "FLOAT",
    "BINFLOAT",
    "STRING",
    "BINSTRING",
    "SHORT_BINSTRING",
    "UNICODE",
    "BINUNICODE",
    "SHORT_BINUNICODE",
    "BINUNICODE8",
    "BINBYTES",
    "SHORT_BINBYTES",
    "BINBYTES8",
    "BYTEARRAY8",
}
SKIPPED = {"PROTO", "FRAME"}


class _Allowance:
    """Bytes that may still be made of a pickle: as many as it has, because an honest one writes those of each array.

    One that names the same bytes in every array would fill the memory with few instructions.
    """

    def __init__(self, most: int):
        self.left = most

    def take(self, size: int) -> None:
        self.left -= size
        if self.left < 0:
            raise Refused("the same bytes again and again, which would fill the memory")


class _Machine:
    """The stack machine; one method per kind of instruction."""

    def __init__(self):
        self.stack, self.memo = [], {}

    def run(self, data: bytes):
        self.bytes = _Allowance(len(data))
        stream = io.BytesIO(data)
        for count, (opcode, argument, _) in enumerate(pickletools.genops(stream)):
            if count == MOST_INSTRUCTIONS:
                raise Refused(f"more than {MOST_INSTRUCTIONS} instructions")
            if opcode.name == "STOP":
                break
            self.step(opcode.name, argument)
        if stream.read(1):
            raise Refused("bytes after the pickle's end")
        if len(self.stack) != 1:
            raise Refused("an unbalanced stack")
        return self.stack[0]

    def step(self, name, argument):
        if name in LITERALS:
            self.stack.append(argument)
        elif name in CONSTANTS:
            self.stack.append(CONSTANTS[name])
        elif name in SKIPPED:
            pass
        elif hasattr(self, f"do_{name.lower()}"):
            getattr(self, f"do_{name.lower()}")(argument)
        else:
            raise Refused(f"the instruction {name}")

    def pop(self):
        if not self.stack or self.stack[-1] is MARK:
            raise Refused("an empty stack")
        return self.stack.pop()

    def pop_mark(self) -> list:
        for at in range(len(self.stack) - 1, -1, -1):
            if self.stack[at] is MARK:
                items = self.stack[at + 1 :]
                del self.stack[at:]
                return items
        raise Refused("a missing mark")

    def do_mark(self, _):
        self.stack.append(MARK)

    def do_pop(self, _):
        self.pop()

    def do_memoize(self, _):
        self.do_put(len(self.memo))

    def do_put(self, key):
        item = self.pop()
        self.memo[key] = item
        self.stack.append(item)

    do_binput = do_long_binput = do_put

    def do_get(self, key):
        if key not in self.memo:
            raise Refused(f"memo entry {key}, which was never stored")
        self.stack.append(self.memo[key])

    do_binget = do_long_binget = do_get

    def do_empty_list(self, _):
        self.stack.append([])

    def do_list(self, _):
        self.stack.append(self.pop_mark())

    def do_append(self, _):
        item = self.pop()
        self._target(list).append(item)

    def do_appends(self, _):
        items = self.pop_mark()
        self._target(list).extend(items)

    def do_empty_tuple(self, _):
        self.stack.append(())

    def do_tuple(self, _):
        self.stack.append(tuple(self.pop_mark()))

    def do_tuple1(self, _):
        self.stack.append((self.pop(),))

    def do_tuple2(self, _):
        last = self.pop()
        self.stack.append((self.pop(), last))

    def do_tuple3(self, _):
        last, middle = self.pop(), self.pop()
        self.stack.append((self.pop(), middle, last))

    def do_empty_dict(self, _):
        self.stack.append({})

    def do_dict(self, _):
        items = self.pop_mark()
        self.stack.append({})
        self._fill(items)

    def do_setitem(self, _):
        value, key = self.pop(), self.pop()
        self._fill([key, value])

    def do_setitems(self, _):
        self._fill(self.pop_mark())

    def _fill(self, items):
        target = self._target(dict)
        if len(items) % 2:
            raise Refused("a dict with a key and no value")
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, (str, int, float, bytes)):
                raise Refused("a dict key that is neither text nor number")
            target[key] = value

    def _target(self, kind):
        if not self.stack or type(self.stack[-1]) is not kind:
            raise Refused(f"items for something that is no {kind.__name__}")
        return self.stack[-1]

    def do_global(self, argument):
        self._mention(*argument.split(" ", 1))

    def do_stack_global(self, _):
        name, module = self.pop(), self.pop()
        if not (isinstance(name, str) and isinstance(module, str)):
            raise Refused("a name that is no text")
        self._mention(module, name)

    def _mention(self, module, name):
        full = f"{module}.{name}"
        if full not in NAMES:
            raise Refused(f"the name {full[:80]}")
        self.stack.append(_Name(full, NAMES[full]))

    def do_reduce(self, _):
        arguments, function = self.pop(), self.pop()
        if not isinstance(function, _Name) or function.make is None or not isinstance(arguments, tuple):
            raise Refused(f"a call of {getattr(function, 'text', type(function).__name__)}")
        made = function.make(*arguments)
        if isinstance(made, bytes):
            self.bytes.take(len(made))
        self.stack.append(made)

    def do_build(self, _):
        state = self.pop()
        if not self.stack or not isinstance(self.stack[-1], (_Array, _Type)):
            raise Refused("a state for something that is no numpy array or type")
        self.stack[-1].set_state(state)


class _Finisher:
    """Turns what the machine left into arrays and plain containers; shared parts once, cycles never."""

    def __init__(self, most: int):
        self.done: dict[int, tuple] = {}
        self.open: set[int] = set()
        self.bytes = _Allowance(most)

    def __call__(self, item, depth=0):
        if item is None or isinstance(item, (bool, int, float, str, bytes)):
            return item
        if id(item) in self.done:
            return self.done[id(item)][1]
        if id(item) in self.open:
            raise Refused("an object that contains itself")
        if depth > DEEPEST:
            raise Refused(f"containers nested more than {DEEPEST} deep")
        self.open.add(id(item))
        result = self._build(item, depth + 1)
        self.open.discard(id(item))
        self.done[id(item)] = item, result
        return result

    def _build(self, item, depth):
        if isinstance(item, bytearray):
            return bytes(item)
        if isinstance(item, (list, tuple)):
            return type(item)(self(part, depth) for part in item)
        if isinstance(item, dict):
            return {key: self(value, depth) for key, value in item.items()}
        if isinstance(item, _Array):
            return self._array(item, depth)
        raise Refused(f"a bare {getattr(item, 'text', type(item).__name__.strip('_'))}")

    def _array(self, item: _Array, depth):
        if not isinstance(item.type, _Type):
            raise Refused("an array without a type")
        shape = item.shape
        if not (
            isinstance(shape, tuple) and len(shape) <= 8 and all(type(n) is int and 0 <= n < 2**31 for n in shape)
        ):
            raise Refused("an array whose shape is not a few whole numbers")
        size = 1
        for n in shape:
            size *= n
        if re.fullmatch("O8?", item.type.code):
            return self._objects(item, shape, size, depth)
        kind = item.type.finish()
        if not isinstance(item.data, (bytes, bytearray)) or len(item.data) != size * kind.itemsize:
            raise Refused(f"an array of shape {shape} and type {kind} whose bytes do not fit it")
        self.bytes.take(len(item.data))
        array = np.frombuffer(bytes(item.data), kind, size).reshape(shape, order="F" if item.fortran else "C")
        return array[()] if item.scalar else array

    def _objects(self, item, shape, size, depth):
        if not isinstance(item.data, list) or len(item.data) != size:
            raise Refused(f"an object array of shape {shape} whose items do not fit it")
        self.bytes.take(size)
        array = np.empty(size, object)
        for at, part in enumerate(item.data):
            array[at] = self(part, depth)
        return array.reshape(shape, order="F" if item.fortran else "C")


def parse_pickle(data: bytes):
    """Value of a pickle that holds numpy arrays, numpy scalars and plain containers; else Refused."""
    return _Finisher(len(data))(_Machine().run(data))


def read_npy(path):
    """Read a .npy file, pickled or not, executing nothing.

    A 0-d object array gives the object in it, as numpy's .item() would. A file that is truncated, hostile
    or holds anything but arrays, scalars and plain containers raises BadInput that names it.
    """
    path = Path(path)
    fault = file_fault(path)
    if fault:
        raise BadInput(f"{path}: cannot be read ({fault}); give a .npy file")
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise Refused(f"more than {LARGEST_FILE >> 20} MiB")
        with path.open("rb") as stream:
            return _read(stream)
    except Refused as error:
        raise BadInput(
            f"{path}: refused, it holds {error}; only numpy arrays, scalars and plain containers are read,"
            " nothing is executed; save the sample again with numpy.save"
        ) from error
    except (*DAMAGED, IndexError) as error:  # what pickletools and the stack machine raise beyond numpy
        raise BadInput(f"{path}: truncated or not a .npy file ({in_short(error)}); copy it again") from error


def _read(stream):
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise Refused(f"version {version} of the .npy format")
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = read_header(stream)
    body = stream.read()
    if kind.hasobject:
        value = parse_pickle(body)
        if not isinstance(value, np.ndarray) or value.dtype != object or value.shape != shape:
            raise Refused("a pickle that is not the object array its header promises")
        return value[()] if shape == () else value
    if kind.names or not PLAIN_TYPE.fullmatch(kind.str):
        raise Refused(f"an array of type {kind}")
    size = 1
    for n in shape:
        size *= n
    if len(body) != size * kind.itemsize:
        raise ValueError(f"{len(body)} bytes where shape {shape} of {kind} needs {size * kind.itemsize}")
    return np.frombuffer(body, kind, size).reshape(shape, order="F" if fortran else "C")
