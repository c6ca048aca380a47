"""The reader of pickled .npy files: what numpy.save writes comes back, what is hostile is refused and never run."""

import io
import os
import pickle
import pickletools

import numpy as np
import pytest

from gelforge.formats.featsfile import read_npy
from tests.support.refused import refused

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


def npy(path, body: bytes):
    """A .npy file that promises an object and holds `body`."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": ()})
    path.write_bytes(stream.getvalue() + body)
    return path


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
    "a memory map": lambda p: Call(np.memmap, str(p), "u1", "w+", 0, (4,)),
    "load": lambda p: Call(np.load, str(p)),
}


def test_hostile_files_are_refused_and_never_run(tmp_path):
    trap = tmp_path / "ran"
    for name, hostile in HOSTILE.items():
        for protocol in range(6):
            body = pickle.dumps(np.array({"f_x": hostile(trap)}, object), protocol)
            refused("hostile.npy: refused, it holds", read_npy, npy(tmp_path / "hostile.npy", body))
            assert not trap.exists(), (name, protocol)


def test_truncated_files_are_named(tmp_path):
    whole = save(tmp_path / "whole.npy", PLAIN).read_bytes()
    for keep in (0, 5, 60, 128, 200, 400, -1):
        (tmp_path / "cut.npy").write_bytes(whole[:keep])
        refused("cut.npy", read_npy, tmp_path / "cut.npy")


def test_a_header_that_lies_about_its_size(tmp_path):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    path = tmp_path / "large.npy"
    path.write_bytes(stream.getvalue() + bytes(64))
    refused("large.npy: truncated", read_npy, path)
