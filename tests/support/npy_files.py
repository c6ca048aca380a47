"""Files of numpy with an object inside, written byte by byte."""

import io

import numpy as np


def npy(path, body: bytes):
    """A .npy file that promises an object and holds `body`."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": ()})
    path.write_bytes(stream.getvalue() + body)
    return path
