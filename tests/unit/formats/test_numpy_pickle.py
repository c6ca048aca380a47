"""The reader of pickled .npy files: what numpy writes comes back, what is hostile is refused by name."""

import codecs
import io
import os
import pickle
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy._core.multiarray import scalar
from numpy._core.numeric import _frombuffer

from gelforge.errors import BadInput
from gelforge.formats.numpy_pickle import Refused, parse_pickle, read_npy
from tests.support.npy_files import npy

PLAIN = {
    "image": np.arange(24, dtype=np.uint8).reshape(2, 4, 3),
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


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_scalars_and_containers_come_back(protocol):
    found = parse_pickle(pickle.dumps(PLAIN, protocol))
    assert list(found) == list(PLAIN)
    for name, value in PLAIN.items():
        assert type(found[name]) is type(value)
        if isinstance(value, np.ndarray):
            assert np.array_equal(found[name], value) and found[name].dtype.kind == value.dtype.kind
        else:
            assert found[name] == value


def test_reads_what_numpy_saves(tmp_path):
    found = read_npy(save(tmp_path / "a.npy", PLAIN))
    assert np.array_equal(found["image"], PLAIN["image"])
    numbers = np.linspace(0, 1, 7).reshape(1, 7)
    np.save(tmp_path / "b.npy", numbers)
    assert np.array_equal(read_npy(tmp_path / "b.npy"), numbers)


def test_reads_the_reference_files(reference):
    sample = read_npy(reference / "feats/images/nocontact_train_sensor.npy")
    assert sample["gs_img"].shape == (240, 320, 3) and sample["gs_img"].dtype == np.uint8
    assert sample["grid_z"].shape == (24, 32) and sample["f_z"] == 0.0
    ranges = read_npy(reference / "feats/images/normalization_08042025_122519.npy")
    assert ranges["f_z"]["min"] == pytest.approx(-73.294363, abs=1e-6) and ranges["gs_img"]["max"] == 255


HOSTILE = {
    "os.system": (lambda p: Call(os.system, f"touch {p}"), "posix.system"),
    "eval": (lambda p: Call(eval, f"open({str(p)!r}, 'w')"), "builtins.eval"),
    "getattr": (lambda p: Call(getattr, "", "format"), "builtins.getattr"),
    "import": (lambda p: Call(__import__, "os"), "builtins.__import__"),
    "in an array": (lambda p: {"gs_img": np.array([Call(os.mkdir, str(p))], object)}, "posix.mkdir"),
    "an instance": (lambda p: Stateful(), "Stateful"),
    "a set": (lambda p: {1, 2}, "EMPTY_SET"),
    "a structured array": (lambda p: np.zeros(2, [("a", "f4")]), "structured"),
    "a memory map": (lambda p: Call(np.memmap, str(p), "u1", "w+", 0, (4,)), "memmap"),
    "load": (lambda p: Call(np.load, str(p)), "load"),
    "a bare name": (lambda p: np.ndarray, "numpy.ndarray"),
    "a dtype": (lambda p: np.dtype("f4"), "Type"),
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("protocol", (0, 2, 4, 5))
def test_hostile_files_are_refused_by_name_and_never_run(tmp_path, name, protocol):
    make, word = HOSTILE[name]
    trap = tmp_path / "ran"
    path = npy(tmp_path / "hostile.npy", pickle.dumps(make(trap), protocol))
    with pytest.raises(BadInput, match="refused") as refused:
        read_npy(path)
    message = str(refused.value)
    assert "hostile.npy" in message and not trap.exists()
    if protocol == 4:
        assert word in message


def reconstruct(shape: bytes, data: bytes, code=b"f8") -> bytes:
    """Pickle of a float array with a shape and bytes of our choice."""
    return (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntC\x01btR(I1\n"
        + shape
        + b"cnumpy\ndtype\n(V"
        + code
        + b"\nI0\nI1\ntR(I3\nV<\nNNNI-1\nI-1\nI0\ntbI00\n"
        + data
        + b"tb."
    )


def test_crafted_array_is_read_when_honest():
    assert parse_pickle(reconstruct(b"(I1\nt", b"C\x08" + struct.pack("<d", 2.5))).tolist() == [2.5]


BOMBS = {
    "a shape beyond its bytes": (reconstruct(b"(I1000000000\nI1000\nt", b"C\x08" + bytes(8)), "do not fit"),
    "a negative shape": (reconstruct(b"(I-1\nt", b"C\x08" + bytes(8)), "shape"),
    "a list as shape": (reconstruct(b"(lI1\na", b"C\x08" + bytes(8)), "shape"),
    "a type of objects": (reconstruct(b"(I1\nt", b"C\x08" + bytes(8), b"O8"), "items do not fit"),
    "a void type": (reconstruct(b"(I1\nt", b"C\x08" + bytes(8), b"V8"), "type 'V8'"),
    "a list in itself": (b"]\x94h\x00a.", "contains itself"),
    "a dict in itself": (b"}\x94K\x01h\x00s.", "contains itself"),
    "a deep list": (b"]" * 5000 + b"a" * 4999 + b".", "nested"),
    "an unknown memo entry": (b"h\x07.", "memo entry 7"),
    "an extension code": (b"\x82\x01.", "EXT1"),
    "a persistent id": (b"Pfile\n.", "PERSID"),
    "an object": (b"(cnumpy\nndarray\no.", "OBJ"),
    "an instance": (b"(inumpy\nndarray\n.", "INST"),
    "a new object": (b"cnumpy\nndarray\n)\x81.", "NEWOBJ"),
    "a call of text": (b"Vabc\n)R.", "call of str"),
    "a state for text": (b"Vabc\n}b.", "state"),
    "a state for a name": (b"cnumpy\ndtype\n}b.", "state"),
    "an empty stack": (b"0.", "empty stack"),
    "no mark": (b"t.", "mark"),
    "two values": (b"K\x01K\x02.", "unbalanced"),
    "a list as key": (b"}]K\x01s.", "key"),
    "a trailing second pickle": (b"N.cos\nsystem\n(Vtrue\ntR.", "after the pickle"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_malformed_pickles_are_refused(tmp_path, name):
    body, word = BOMBS[name]
    with pytest.raises(Refused, match=word):
        parse_pickle(body)
    with pytest.raises(BadInput, match="bomb.npy"):
        read_npy(npy(tmp_path / "bomb.npy", body))


HELD = b"a" * 1000
AGAIN = {
    "a text that is encoded": lambda: Call(codecs.encode, "a" * 1000, "latin1"),
    "arrays": lambda: Call(_frombuffer, HELD, np.dtype("f8"), (125,), "C"),
    "texts": lambda: Call(scalar, np.dtype("S1000"), HELD),
}


@pytest.mark.parametrize("name", AGAIN)
def test_what_makes_more_of_the_same_bytes_than_there_are_is_refused(name):
    """A file of 20 MB took all memory so: a few instructions name them again."""
    bomb = pickle.dumps([AGAIN[name]() for _ in range(10)], 4)
    assert len(bomb) < 3000
    with pytest.raises(Refused, match="again and again"):
        parse_pickle(bomb)
    assert len(parse_pickle(pickle.dumps([AGAIN[name]()], 4))[0]) > 0


def test_changeable_bytes_are_copied_once():
    found = parse_pickle(pickle.dumps([bytearray(b"raw")] * 3, 5))
    assert found == [b"raw"] * 3 and found[0] is found[2]


def test_a_memo_index_of_two_milliards_costs_no_memory(tmp_path):
    body = b"Nr\xff\xff\xff\x7f."  # LONG_BINPUT: CPython's own unpickler would make a table of that size
    assert parse_pickle(body) is None


def test_shared_parts_are_built_once():
    shared = b"]\x94" + b"".join(b"]\x94(" + b"h%c" % at * 10 + b"e" for at in range(60)) + b"."
    with pytest.raises(Refused):  # sixty levels of ten references each leave an unbalanced stack, at once
        parse_pickle(shared)
    laughs = pickle.dumps(_laughs(40), 4)
    assert len(parse_pickle(laughs)) == 10


def _laughs(levels):
    value = [0]
    for _ in range(levels):
        value = [value] * 10
    return value


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
@given(st.integers(0, 5), st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=6))
def test_corrupt_pickles_are_read_or_refused_but_never_crash(tmp_path_factory, protocol, corrupt):
    path = npy(tmp_path_factory.getbasetemp() / "corrupt.npy", pickle.dumps(SMALL, protocol))
    whole = bytearray(path.read_bytes())
    for at, byte in corrupt:
        whole[at % len(whole)] = byte
    path.write_bytes(whole)
    try:
        read_npy(path)
    except BadInput as error:
        assert "corrupt.npy" in str(error)
