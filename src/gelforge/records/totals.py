"""Total force as columns of a table and keys of JSON lines.

For each channel: CHANNEL_n, the total; CHANNEL_half_width_n, half of the interval that holds nine of ten; and
CHANNEL_by_dots_n, what the motion of the printed dots tells by itself. What is not known is empty. edge_share tells
where totals are not all of the force: what touches the gel beyond the picture is no part of them.
"""

import numpy as np

from gelforge.records.axes import CHANNELS

KINDS = ("n", "half_width_n", "by_dots_n")
TOTAL_COLUMNS = (*(f"{channel}_{kind}" for kind in KINDS for channel in CHANNELS), "edge_share")
LEAST_PRESS = 0.2  # N of normal force below which a map has no shape: what is read of a released gel is below
EDGE = 1 / 12  # of the picture's height and width, on each side, that counts as its edge
BEYOND = 0.2  # of a map's largest force, borne by an outermost cell: what presses there goes on beyond the picture


def total_columns(
    forces: np.ndarray, half_width: np.ndarray | None, by_dots: np.ndarray | None, at_edge: float
) -> dict[str, float | None]:
    """Values of TOTAL_COLUMNS, N to four decimals, of forces (3, rows, cols) N; half_width, by_dots: (3,) N or None.

    at_edge: their `edge_share`.
    """
    found: dict[str, float | None] = {}
    for kind, values in zip(KINDS, (forces.sum((1, 2), dtype=np.float64), half_width, by_dots), strict=True):
        for k, channel in enumerate(CHANNELS):
            found[f"{channel}_{kind}"] = None if values is None else round(float(values[k]), 4)
    return found | {"edge_share": None if np.isnan(at_edge) else round(at_edge, 4)}


def edge_share(forces: np.ndarray, shown: tuple[slice, slice]) -> float:
    """Share of the normal force of forces (3, rows, cols) N that lies at the picture's edge; 0 where hardly anything presses.

    shown: rows and columns of the cells that the picture shows; what is read beyond counts as its edge. A large share
    tells that what touches goes on beyond the picture. NaN where fewer than three rows or columns are shown, which are
    nothing but edge.
    """
    pressed = np.maximum(-forces[2].astype(float), 0.0)
    inner = pressed[shown]
    if min(inner.shape) < 3:
        return np.nan
    rows, cols = (max(1, round(EDGE * count)) for count in inner.shape)
    within, total = inner[rows:-rows, cols:-cols].sum(), pressed.sum()
    return float(1.0 - within / total) if total >= LEAST_PRESS else 0.0


def goes_beyond(forces: np.ndarray, shown: tuple[slice, slice]) -> bool:
    """Whether what presses goes on beyond the picture, so that the sum of forces (3, rows, cols) N is a part of it only.

    shown: as of `edge_share`. Of 51 real presses, the outermost cells of those that end within the picture bear at most a
    tenth of the largest force, of those that the picture cuts a quarter and more. False where hardly anything presses, and
    where fewer than three rows or columns are shown.
    """
    pressed = np.maximum(-forces[2].astype(float), 0.0)
    if min(pressed[shown].shape) < 3 or pressed.sum() < LEAST_PRESS:
        return False
    outer = pressed.copy()
    outer[shown][1:-1, 1:-1] = 0.0
    return bool(outer.max() >= BEYOND * pressed.max())
