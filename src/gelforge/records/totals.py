"""Total force as columns of a table and keys of JSON lines.

For each channel: CHANNEL_n, the total; CHANNEL_half_width_n, half of the interval that holds nine of ten; and
CHANNEL_by_dots_n, what the motion of the printed dots tells by itself. What is not known is empty.
"""

import numpy as np

from gelforge.records.axes import CHANNELS

KINDS = ("n", "half_width_n", "by_dots_n")
TOTAL_COLUMNS = tuple(f"{channel}_{kind}" for kind in KINDS for channel in CHANNELS)


def total_columns(
    forces: np.ndarray, half_width: np.ndarray | None, by_dots: np.ndarray | None
) -> dict[str, float | None]:
    """Values of TOTAL_COLUMNS, N to four decimals, of forces (3, rows, cols) N; half_width, by_dots: (3,) N or None."""
    found: dict[str, float | None] = {}
    for kind, values in zip(KINDS, (forces.sum((1, 2), dtype=np.float64), half_width, by_dots), strict=True):
        for k, channel in enumerate(CHANNELS):
            found[f"{channel}_{kind}"] = None if values is None else round(float(values[k]), 4)
    return found
