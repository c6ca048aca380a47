"""What kernels share that work on several elements at once, side by side in the last axis of every array."""

from typing import Any

import numpy as np

# How numba compiles them: sums in any order, but no assumption about numbers that are none.
FAST: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


def batched(values: np.ndarray, lanes: int) -> np.ndarray:
    """Values (n, ...) of elements as batches (b, ..., lanes); the last batch repeats the last element."""
    which = np.minimum(np.arange(-(-len(values) // lanes) * lanes), len(values) - 1)
    return np.ascontiguousarray(np.moveaxis(values[which].reshape(-1, lanes, *values.shape[1:]), 1, -1))
