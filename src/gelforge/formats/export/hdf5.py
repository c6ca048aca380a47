"""Export as one HDF5 file.

/picture (n,) bytes of the image file, /media_type (n,) its type, /forces (n, 3, rows, cols) float32 N per cell,
/total (n, 3) N and /moment (n, 3) N m about the gel's apex along gel x, y, z, and every column of samples.csv below /samples: numbers as float64, NaN where
unknown, else text. Attributes of the file state units, frame and calibration.
"""

import json
import multiprocessing
import os
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from gelforge.formats.export.samples import Samples

BLOCK = 256


def write(path: Path, samples: Samples) -> None:
    """Write one file in a separate process, because HDF5 aborts its process when a write fails (h5py issue 914)."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_write_apart, args=(path, samples, there))
    child.start()
    there.close()
    try:
        failed = here.recv()
    except EOFError:
        failed = OSError("HDF5 aborted, probably because the disk is full")
    child.join()
    if failed is not None:
        raise failed


def _write_apart(path: Path, samples: Samples, pipe: Connection) -> None:
    """Write, send the exception or None, and exit at once, because at exit HDF5 would repeat a failed write."""
    failed: Exception | None = None
    # h5py prints what it cannot close on standard error; the pipe carries what matters
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        write_here(path, samples)
    except RuntimeError as error:  # h5py raises this where a file cannot be closed
        failed = OSError(str(error))
    except Exception as error:
        failed = error
    pipe.send(failed)
    pipe.close()
    os._exit(0)


def write_here(path: Path, samples: Samples) -> None:
    """Write one file."""
    import h5py

    count = len(samples)
    # no other process uses this file, and some file systems have no locks
    with h5py.File(path, "w", locking=False) as file:
        for name, value in samples.facts().items():
            file.attrs[name] = value if isinstance(value, str) else json.dumps(value)
        pictures = file.create_dataset("picture", (count,), h5py.vlen_dtype(np.uint8))
        types = file.create_dataset("media_type", (count,), h5py.string_dtype())
        forces = file.create_dataset(
            "forces", (count, 3, *samples.grid), np.float32, chunks=(min(16, count), 3, *samples.grid), compression="lzf"
        )  # fmt: skip
        forces.attrs["unit"] = "N per cell"
        for start in range(0, count, BLOCK):
            block = [samples.sample(at) for at in range(start, min(start + BLOCK, count))]
            rows = slice(start, start + len(block))
            # one by one: h5py would take images of equal length as a 2-d array
            for at, sample in enumerate(block, start):
                pictures[at] = np.frombuffer(sample.picture, np.uint8)
            types[rows] = [sample.media_type for sample in block]
            forces[rows] = np.stack([sample.label for sample in block])
        wrench = np.array([each.wrench for each in samples.records])
        for name, unit, columns in (("total", "N", slice(0, 3)), ("moment", "N m", slice(3, 6))):
            file[name] = wrench[:, columns]
            file[name].attrs["unit"] = unit
        numbers = [record.numbers() for record in samples.records]
        for name in samples.rows[0]:
            if name in numbers[0]:
                file[f"samples/{name}"] = np.array([row[name] for row in numbers])
            else:
                texts = [row[name] for row in samples.rows]
                file.create_dataset(f"samples/{name}", data=texts, dtype=h5py.string_dtype())
