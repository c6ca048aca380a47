"""What kernels share that work on several elements at once, side by side in the last axis of every array.

A processor then does the same sum for all of them in one instruction (SIMD); a lane is the place of one element.
"""

from typing import Any

import numpy as np

# How numba compiles them: sums in any order, but nan and infinity stay what they are, because solvers look for them.
FAST: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


def batched(values: np.ndarray, width: int) -> np.ndarray:
    """Values (n, ...) of n > 0 elements as batches (b, ..., width); the last batch repeats the last element.

    So kernels work on whole batches; they add up what is of the first n alone.
    """
    which = np.minimum(np.arange(-(-len(values) // width) * width), len(values) - 1)
    return np.ascontiguousarray(np.moveaxis(values[which].reshape(-1, width, *values.shape[1:]), 1, -1))
