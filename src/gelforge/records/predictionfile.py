"""Predictions of a network for every image of a dataset, stored with its evaluation.

An uncompressed .npz. `n` images, in the order of samples.csv:

| array | shape, type | meaning |
| --- | --- | --- |
| sample_id | (n,) str | |
| total | (n, 3) float32 | N, along gel x, y, z |
| forces | (n, 3, rows, cols) float16 | N per cell; rows and cols are 1 for a network of totals only |
"""

from pathlib import Path

import numpy as np

from gelforge.flow.files import publish
from gelforge.flow.layout import command_for
from gelforge.records.arrays import Schema, read_arrays

SCHEMA = Schema("a file of predictions", {"sample_id": ("U", 1), "total": ("f", 2), "forces": ("f", 4)})


def write_predictions(path: str | Path, sample_id: np.ndarray, forces: np.ndarray) -> None:
    """Write forces (n, 3, rows, cols) in N per cell of the samples `sample_id` (n,), whole or not at all."""
    total = forces.sum((2, 3), dtype=np.float64).astype(np.float32)
    with publish(path) as part, part.open("wb") as stream:
        np.savez(stream, sample_id=np.asarray(sample_id, dtype=str), total=total, forces=forces.astype(np.float16))


def read_predictions(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays by name; an unreadable file raises BadInput."""
    return read_arrays(path, SCHEMA, f"delete it and run {command_for('evaluate', path)}")
