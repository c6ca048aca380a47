"""What a network read in every image of a dataset, beside its evaluation.

An uncompressed .npz. `n` images, in the order of samples.csv:

| array | shape, type | meaning |
| --- | --- | --- |
| sample_id | (n,) str | |
| total | (n, 3) float32 | N, channels as in the labels |
| forces | (n, 3, rows, cols) float16 | N per cell; rows and cols are 1 where a network knows totals only |
"""

import zipfile
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish


def write_predictions(path, sample_id, forces: np.ndarray) -> None:
    """Write forces (n, 3, rows, cols) in N per cell of the samples named, whole or not at all."""
    total = forces.sum((2, 3), dtype=np.float64).astype(np.float32)
    with publish(path) as part, part.open("wb") as stream:
        np.savez(stream, sample_id=np.asarray(sample_id, dtype=str), total=total, forces=forces.astype(np.float16))


def read_predictions(path) -> dict[str, np.ndarray]:
    """The arrays by name; an unreadable file raises BadInput."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in ("sample_id", "total", "forces")}
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(
            f"{Path(path)}: not a file of predictions ({error}); delete it and run make evaluate"
        ) from error
