"""Total force as columns of a table and keys of JSON lines.

For each channel: CHANNEL_n, the total; CHANNEL_half_width_n, half of the interval that holds nine of ten; and
CHANNEL_by_dots_n, what the motion of the printed dots tells by itself. What is not known is empty. edge_peak tells
where totals are not all of the force: what touches the gel beyond the picture is no part of them.
"""

import numpy as np

from gelforge.records.axes import CHANNELS

KINDS = ("n", "half_width_n", "by_dots_n")
TOTAL_COLUMNS = (*(f"{channel}_{kind}" for kind in KINDS for channel in CHANNELS), "edge_peak")
LEAST_PRESS = 0.2  # N of normal force below which a map has no shape: what is read of a released gel is below
# Of a map's largest force, borne by a cell at the picture's edge: what presses there goes on beyond the picture. Of 51 real
# presses those that end within it bear at most a tenth there, those that it cuts a quarter and more.
BEYOND = 0.2


def total_columns(
    forces: np.ndarray, half_width: np.ndarray | None, by_dots: np.ndarray | None, peak: float
) -> dict[str, float | None]:
    """Values of TOTAL_COLUMNS, N to four decimals, of forces (3, rows, cols) N; half_width, by_dots: (3,) N or None.

    peak: their `edge_peak`.
    """
    found: dict[str, float | None] = {}
    for kind, values in zip(KINDS, (forces.sum((1, 2), dtype=np.float64), half_width, by_dots), strict=True):
        for k, channel in enumerate(CHANNELS):
            found[f"{channel}_{kind}"] = None if values is None else round(float(values[k]), 4)
    return found | {"edge_peak": None if np.isnan(peak) else round(peak, 4)}


def edge_peak(forces: np.ndarray, shown: tuple[slice, slice]) -> float:
    """Largest normal force of a cell at the picture's edge, over the largest of all; 0 where hardly anything presses.

    forces: (3, rows, cols) N. shown: rows and columns of the cells that the picture shows; what is read beyond counts as
    its edge. NaN where fewer than three rows or columns are shown, which are nothing but edge.
    """
    pressed = np.maximum(-forces[2].astype(float), 0.0)
    if min(pressed[shown].shape) < 3:
        return np.nan
    if pressed.sum() < LEAST_PRESS:
        return 0.0
    outer = pressed.copy()
    outer[shown][1:-1, 1:-1] = 0.0
    return float(outer.max() / pressed.max())


def goes_beyond(peak: float) -> bool:
    """Whether what presses goes on beyond the picture, by its `edge_peak`: then totals are a part of its force only."""
    return peak >= BEYOND
