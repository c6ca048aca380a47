"""Predictions of a network for every image of a dataset, stored with its evaluation.

An uncompressed .npz. `n` images, in the order of samples.csv:

| array | shape, type | meaning |
| --- | --- | --- |
| sample_id | (n,) str | |
| total, moment | (n, 3) float32 | N along gel x, y, z, and N mm about them through the gel's apex |
| forces | (n, 3, rows, cols) float16 | N per cell; rows and cols are 1 for a network of totals only |
"""

from pathlib import Path

import numpy as np

from gelforge.flow.files import publish
from gelforge.flow.layout import command_for
from gelforge.records.arrays import Schema, read_arrays

SCHEMA = Schema(
    "a file of predictions", {"sample_id": ("U", 1), "total": ("f", 2), "moment": ("f", 2), "forces": ("f", 4)}
)


def write_predictions(path: str | Path, sample_id: np.ndarray, forces: np.ndarray, moment: np.ndarray) -> None:
    """Write forces (n, 3, rows, cols) N per cell and moments (n, 3) N mm of the samples `sample_id` (n,), whole or not at all."""
    total, names = forces.sum((2, 3), dtype=np.float64), np.asarray(sample_id, dtype=str)
    with publish(path) as part, part.open("wb") as stream:
        np.savez(stream, sample_id=names, total=total.astype(np.float32), moment=moment.astype(np.float32),
                 forces=forces.astype(np.float16))  # fmt: skip


def read_predictions(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays by name; an unreadable file raises BadInput."""
    return read_arrays(path, SCHEMA, f"delete it and run {command_for('evaluate', path)}")
