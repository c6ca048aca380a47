"""Exact clipping of many convex polygons against the cells of a regular grid, compiled."""

from collections.abc import Callable, Iterator

import numpy as np
from numba import njit

PAIRS_AT_ONCE = 200_000  # candidate polygon-cell pairs held in memory at a time, about 100 MiB
# Space for the corners of a piece, as a multiple of its polygon's: each of the four cuts adds at most half as many
# (to a star-shaped polygon); to a convex polygon it adds one.
ROOM = 6


def polygon_area(polygons: np.ndarray) -> np.ndarray:
    """Area (m,) of polygons (m, k, 2), either orientation; repeated corners do no harm (shoelace formula)."""
    local = polygons - polygons[:, :1]  # far from the origin the shoelace terms would cancel
    x, y = local[..., 0], local[..., 1]
    return 0.5 * np.abs((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1))


def clip_to_grid(
    polygons: np.ndarray,
    shape: tuple[int, int],
    image: tuple[int, int],
    measure: Callable[[np.ndarray], np.ndarray] = polygon_area,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Overlap of convex polygons with the cells of a grid laid over an image.

    polygons (m, k, 2) in pixels (u, v); shape (rows, cols) of the grid; image (width, height) in
    pixels. Returns polygon index, cell index (row-major, row along v) and measure of the overlap,
    each (p,). `measure` maps polygons (p, k, 2) in pixels to areas in whatever plane is chosen.
    """
    rows, cols = shape
    edges = np.arange(cols + 1) * (image[0] / cols), np.arange(rows + 1) * (image[1] / rows)
    ranges = np.stack([_cell_range(polygons, 0, cols, image[0]), _cell_range(polygons, 1, rows, image[1])], axis=1)
    pairs = np.maximum(ranges[..., 1] - ranges[..., 0], 0).prod(axis=1)
    found = [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))]
    for block in _blocks(pairs):
        owner, cell, pieces = _cut_to_cells(np.asarray(polygons[block], float), ranges[block], *edges)
        area = measure(pieces)
        alive = area > 0.0
        found.append((block[owner[alive]], cell[alive], area[alive]))
    owner, cell, area = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return owner, cell, area


def _cell_range(polygons: np.ndarray, axis: int, cells: int, length: int) -> np.ndarray:
    """First cell and one past the last cell, (m, 2), that the polygons' boxes touch."""
    scale = cells / length
    low = np.floor(polygons[..., axis].min(axis=1) * scale)
    high = np.ceil(polygons[..., axis].max(axis=1) * scale)
    return np.clip(np.column_stack([low, high]), 0, cells).astype(np.int64)


def _blocks(pairs: np.ndarray) -> Iterator[np.ndarray]:
    """Blocks of polygon indices, each with about PAIRS_AT_ONCE candidate pairs."""
    if not len(pairs):
        return
    number = np.cumsum(pairs) // PAIRS_AT_ONCE
    cuts = np.flatnonzero(np.diff(number)) + 1
    yield from (np.arange(a, b) for a, b in zip([0, *cuts], [*cuts, len(pairs)], strict=True))


@njit(cache=True, nogil=True, error_model="numpy")
def _cut_to_cells(
    polygons: np.ndarray, ranges: np.ndarray, u_edges: np.ndarray, v_edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut polygons (m, k, 2) to the cells of their ranges (m, 2, 2): first cell and one past the last along u and v.

    Returns polygon index (p,), cell index (p,) and the piece in the cell (p, k', 2), padded with its last corner.
    """
    most, room = 0, ROOM * polygons.shape[1]
    for at in range(len(polygons)):
        most += max(0, ranges[at, 0, 1] - ranges[at, 0, 0]) * max(0, ranges[at, 1, 1] - ranges[at, 1, 0])
    owner, cell, corners = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.int64)
    pieces = np.empty((most, room, 2))
    half, strip, low = np.empty((room, 2)), np.empty((room, 2)), np.empty((room, 2))
    found, widest = 0, 1
    for at in range(len(polygons)):
        for col in range(ranges[at, 0, 0], ranges[at, 0, 1]):
            count = _cut(polygons[at], polygons.shape[1], 0, u_edges[col], 1.0, half)
            in_strip = _cut(half, count, 0, u_edges[col + 1], -1.0, strip)
            for row in range(ranges[at, 1, 0], ranges[at, 1, 1]):
                count = _cut(strip, in_strip, 1, v_edges[row], 1.0, low)
                count = _cut(low, count, 1, v_edges[row + 1], -1.0, pieces[found])
                if count:
                    owner[found], cell[found], corners[found] = at, row * (len(u_edges) - 1) + col, count
                    found, widest = found + 1, max(widest, count)
    for piece in range(found):
        for corner in range(corners[piece], widest):
            _copy(pieces[piece], corners[piece] - 1, pieces[piece], corner)
    return owner[:found], cell[:found], pieces[:found, :widest]


@njit(cache=True, nogil=True, error_model="numpy")
def _cut(corners: np.ndarray, count: int, axis: int, bound: float, sign: float, kept: np.ndarray) -> int:
    """Cut a convex polygon to sign * coordinate[axis] >= sign * bound; write corners to `kept`, return their number.

    corners: (k, 2), of which the first `count` are the polygon's. One step of Sutherland and Hodgman (1974).
    """
    number = 0
    for at in range(count):
        after = at + 1 if at + 1 < count else 0
        height, next_height = sign * (corners[at, axis] - bound), sign * (corners[after, axis] - bound)
        if height >= 0.0:
            _copy(corners, at, kept, number)
            number += 1
        if (height >= 0.0) != (next_height >= 0.0):
            part = height / (height - next_height)
            for i in range(2):
                kept[number, i] = corners[at, i] + part * (corners[after, i] - corners[at, i])
            kept[number, axis] = bound
            number += 1
    return number


@njit(inline="always")
def _copy(source: np.ndarray, row: int, target: np.ndarray, at: int) -> None:
    """Copy a corner; with `target[at] = source[row]` the compiler adds shape checks, which takes it seconds."""
    target[at, 0], target[at, 1] = source[row, 0], source[row, 1]
