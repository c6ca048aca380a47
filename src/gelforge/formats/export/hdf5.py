"""HDF5: one file for those who ask for one.

/picture (n,) bytes of the picture's file as the sensor gave it, /forces (n, 3, rows, cols) float32 N per cell, /total
(n, 3) N along gel x, y, z, and every column of samples.csv below /samples: numbers as float64, NaN where one is not known, else
text. Attributes of the file say what they mean.
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
    """Write one file, in a process of its own: where it cannot write on, HDF5 ends its process (h5py issue 914)."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_write_apart, args=(path, samples, there))
    child.start()
    there.close()
    try:
        failed = here.recv()
    except EOFError:
        failed = OSError("HDF5 broke off, as it does where a disk is full")
    child.join()
    if failed is not None:
        raise failed


def _write_apart(path: Path, samples: Samples, pipe: Connection) -> None:
    """Write, send what went wrong or None, and end at once: HDF5 would try to write again what it could not."""
    failed: Exception | None = None
    # h5py reports on the error stream what it cannot close; what matters goes by the pipe
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        write_here(path, samples)
    except RuntimeError as error:  # h5py's word for a file that cannot be closed
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
    # nobody else knows this file yet, and some file systems have no locks
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
            for at, sample in enumerate(block, start):  # h5py takes pictures of one length together for two axes
                pictures[at] = np.frombuffer(sample.picture, np.uint8)
            types[rows] = [sample.media_type for sample in block]
            forces[rows] = np.stack([sample.label for sample in block])
        file["total"] = np.array([each.total for each in samples.records])
        file["total"].attrs["unit"] = "N"
        numbers = [record.numbers() for record in samples.records]
        for name in samples.rows[0]:
            if name in numbers[0]:
                file[f"samples/{name}"] = np.array([row[name] for row in numbers])
            else:
                texts = [row[name] for row in samples.rows]
                file.create_dataset(f"samples/{name}", data=texts, dtype=h5py.string_dtype())
