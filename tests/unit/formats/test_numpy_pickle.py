"""The reader of pickled .npy files: what numpy.save writes comes back, what is hostile is refused and never run."""

import io
import os
import pickle
import pickletools
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.formats.numpy_pickle import Array, Name, Refused, Type, read_npy
from tests.support.npy_files import npy

PLAIN = {
    "image": np.arange(2400, dtype=np.uint8).reshape(20, 40, 3),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "big": np.arange(3, dtype=">i4"),
    "text": np.array(["ab", "cde"]),
    "empty": np.zeros((0, 3)),
    "flag": np.bool_(True),
    "number": np.float32(2.5),
    "words": "größe",
    "list": [[1, -(2**70)], [], b"raw", 1.5, None, True],
    "pair": (1, ("x",)),
}


class Call:
    """Pickles into a call of `function`."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


class Stateful:
    def __init__(self):
        self.x = 1


def save(path, value):
    np.save(path, np.array(value, dtype=object) if not isinstance(value, np.ndarray) else value, allow_pickle=True)
    return path


@pytest.mark.parametrize("protocol", (3, 4))
@pytest.mark.parametrize("package", ("numpy._core", "numpy.core"))
def test_what_numpy_saves_comes_back(tmp_path, protocol, package):
    """In the protocols that it uses, of numpy 2 and 1."""
    body = pickle.dumps(np.array(PLAIN, object), protocol)
    if package == "numpy.core":
        body = pickletools.optimize(pickle.dumps(np.array(PLAIN, object), 3)).replace(b"numpy._core", b"numpy.core")
    found = read_npy(npy(tmp_path / "a.npy", body))
    assert list(found) == list(PLAIN)
    for name, value in PLAIN.items():
        assert type(found[name]) is type(value)
        if isinstance(value, np.ndarray):
            assert np.array_equal(found[name], value) and found[name].dtype.kind == value.dtype.kind
        else:
            assert found[name] == value


def test_numbers_without_a_pickle_come_back(tmp_path):
    numbers = np.linspace(0, 1, 7).reshape(1, 7)
    assert np.array_equal(read_npy(save(tmp_path / "b.npy", numbers)), numbers)


def test_reads_the_reference_files(reference):
    sample = read_npy(reference / "feats/images/nocontact_train_sensor.npy")
    assert sample["gs_img"].shape == (240, 320, 3) and sample["gs_img"].dtype == np.uint8
    assert sample["grid_z"].shape == (24, 32) and sample["f_z"] == 0.0
    ranges = read_npy(reference / "feats/images/normalization_08042025_122519.npy")
    assert ranges["f_z"]["min"] == pytest.approx(-73.294363, abs=1e-6) and ranges["gs_img"]["max"] == 255


HOSTILE = {
    "os.system": lambda p: Call(os.system, f"touch {p}"),
    "eval": lambda p: Call(eval, f"open({str(p)!r}, 'w')"),
    "getattr": lambda p: Call(getattr, "", "format"),
    "in an array": lambda p: {"gs_img": np.array([Call(os.mkdir, str(p))], object)},
    "an instance": lambda p: Stateful(),
    "a structured array": lambda p: np.zeros(2, [("a", "f4")]),
    "a memory map": lambda p: Call(np.memmap, str(p), "u1", "w+", 0, (4,)),
    "load": lambda p: Call(np.load, str(p)),
    "an array by its class": lambda p: Call(np.ndarray, (2**40,)),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_and_never_run(tmp_path, name):
    trap = tmp_path / "ran"
    for protocol in range(6):
        body = pickle.dumps(np.array({"f_x": HOSTILE[name](trap)}, object), protocol)
        with pytest.raises(BadInput, match="hostile.npy: refused, it holds"):
            read_npy(npy(tmp_path / "hostile.npy", body))
        assert not trap.exists()


CORE = "numpy._core.multiarray"


def word(text: str) -> bytes:
    return b"X" + struct.pack("<I", len(text)) + text.encode()


def number(value: int) -> bytes:
    return b"\x8a\x08" + struct.pack("<q", value)


def named(module: str, name: str) -> bytes:
    return f"c{module}\n{name}\n".encode()


def typed(code: str, state: bytes = b"") -> bytes:
    return named("numpy", "dtype") + word(code) + b"\x85R" + (state or b"(K\x03X\x01\0\0\0<NNNK\0K\0K\0tb")


def array(shape, data: bytes, code: str = "f8", kind: bytes = b"", start: bytes = b"(K\0tC\x01b") -> bytes:
    """A float array with a shape, bytes and a type of our choice."""
    sizes = b"(" + b"".join(map(number, shape)) + b"t"
    begun = named(CORE, "_reconstruct") + b"(" + named("numpy", "ndarray") + start + b"tR"
    return begun + b"(K\x01" + sizes + (kind or typed(code)) + b"\x89" + data + b"tb"


EIGHT = b"C\x08" + struct.pack("<d", 2.5)
FORGED = typed("V8", b"(K\x03X\x01\0\0\0|NNNK\x08K\x01K\x3ftb")  # flags that say: these bytes are pointers to objects
BOMBS = {
    "a shape beyond its bytes": array((10**9, 1000), EIGHT),
    "a shape beyond all numbers": array((2**30,) * 8, EIGHT),
    "a negative shape": array((-1,), EIGHT),
    "nine dimensions": array((1,) * 9, EIGHT),
    "an array that begins with a terabyte": array((1,), b"C\0", start=b"(" + number(2**40) + b"tC\x01d"),
    "objects of bytes": array((1,), EIGHT, "O8"),
    "more objects than there are": array((3,), b"]K\x01a", "O8"),
    "a void type": array((1,), EIGHT, "V8"),
    "a type with the flags of pointers": array((1,), EIGHT, kind=FORGED),
    "a scalar without its bytes": named(CORE, "scalar") + typed("f8") + b"C\x02ab\x86R",
    "a text of a gigabyte": named(CORE, "scalar") + typed("S999999999") + EIGHT + b"\x86R",
    "a list in itself": b"]\x94h\0a",
    "a dict in itself": b"}\x94K\x01h\0s",
    "an unknown memo entry": b"h\x07",
    "a length of an exabyte": b"\x8e" + struct.pack("<Q", 2**60) + b"x",
    "an extension code": b"\x82\x01",
    "a persistent id": b"Pfile\n",
    "a persistent id of the stack": word("file") + b"Q",
    "an object": b"(cnumpy\nndarray\no",
    "a new object": named("numpy", "ndarray") + b")\x81",
    "an out-of-band buffer": b"\x97",
    "a call of text": word("abc") + b")R",
    "a call of an array": array((1,), EIGHT) + b")R",
    "a state for text": word("abc") + b"}b",
    "a state for a constructor": named(CORE, "_reconstruct") + b"N}" + word("make") + b"Ns\x86b",
    "an empty stack": b"0",
    "no mark": b"t",
    "a list as key": b"}]K\x01s",
    "a trailing second pickle": b"N.cos\nsystem\n" + word("true") + b"\x85R",
}


def test_malformed_pickles_are_refused(tmp_path):
    for name, body in BOMBS.items():
        with pytest.raises(BadInput, match=r"bomb\.npy: (refused|truncated)"):
            read_npy(npy(tmp_path / "bomb.npy", b"\x80\x03" + body + b"."))
            pytest.fail(name)


def test_crafted_files_are_read_when_honest(tmp_path):
    """So what refuses the others is what they are changed in."""
    around = array((), b"]%sa" % (b"}" + word("a") + array((1,), EIGHT) + b"s"), "O8")
    assert read_npy(npy(tmp_path / "a.npy", b"\x80\x03" + around + b"."))["a"].tolist() == [2.5]
    scalar = b"]" + named(CORE, "scalar") + typed("f8") + EIGHT + b"\x86Ra"
    assert read_npy(npy(tmp_path / "a.npy", b"\x80\x03" + array((), scalar, "O8") + b".")) == 2.5


def test_constructors_keep_no_state_of_a_file():
    for made in (Name(None), Type("f8"), Array(0, np.uint8)):
        with pytest.raises((Refused, ValueError, TypeError)):
            made.__setstate__({"make": None})


@pytest.mark.parametrize("keep", (0, 5, 60, 128, 200, 400, -1))
def test_truncated_files_are_named(tmp_path, keep):
    whole = save(tmp_path / "whole.npy", PLAIN).read_bytes()
    cut = tmp_path / "cut.npy"
    cut.write_bytes(whole[:keep])
    with pytest.raises(BadInput, match="cut.npy"):
        read_npy(cut)


def test_a_header_that_lies_about_its_size(tmp_path):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    path = tmp_path / "large.npy"
    path.write_bytes(stream.getvalue() + bytes(64))
    with pytest.raises(BadInput, match="64 bytes where"):
        read_npy(path)


SMALL = {
    "a": np.arange(4.0),
    "f": np.float32(2),
    "t": (1, "x", b"y", None),
    "u": np.array(["ab"]),
    "l": [True, 2**70],
}


@settings(max_examples=400)
@given(st.integers(3, 4), st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=6))
def test_corrupt_pickles_are_read_or_refused_but_never_crash(tmp_path_factory, protocol, corrupt):
    path = tmp_path_factory.getbasetemp() / "corrupt.npy"
    whole = bytearray(npy(path, pickle.dumps(np.array(SMALL, object), protocol)).read_bytes())
    for at, byte in corrupt:
        whole[at % len(whole)] = byte
    path.write_bytes(whole)
    try:
        read_npy(path)
    except BadInput as error:
        assert "corrupt.npy" in str(error)
