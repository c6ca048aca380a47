"""Exact clipping of many convex polygons against the cells of a regular grid, vectorised."""

import numpy as np

PAIRS_AT_ONCE = 200_000  # candidate polygon-cell pairs held in memory at a time, about 100 MiB


def polygon_area(polygons: np.ndarray) -> np.ndarray:
    """Area (m,) of polygons (m, k, 2), either orientation; repeated corners do no harm (shoelace formula)."""
    local = polygons - polygons[:, :1]  # far from the origin the shoelace terms would cancel
    x, y = local[..., 0], local[..., 1]
    return 0.5 * np.abs((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1))


def clip_half_plane(polygons, axis: int, bound, keep_above: bool) -> np.ndarray:
    """Parts of convex `polygons` (m, k, 2) on one side of the lines coordinate[axis] = bound (m,).

    One step of Sutherland and Hodgman (1974). Returns (m, k', 2), k' <= k + 1; short polygons repeat
    their last corner, vanished ones are all zero.
    """
    bound = bound[:, None]
    height = polygons[..., axis] - bound if keep_above else bound - polygons[..., axis]
    following, next_height = np.roll(polygons, -1, axis=1), np.roll(height, -1, axis=1)
    inside, next_inside = height >= 0.0, next_height >= 0.0
    crosses = inside != next_inside
    step = np.where(crosses, height - next_height, 1.0)
    crossing = polygons + (height / step)[..., None] * (following - polygons)
    crossing[..., axis] = bound
    count, corners = polygons.shape[:2]
    slots = np.empty((count, 2 * corners, 2))
    slots[:, 0::2], slots[:, 1::2] = polygons, crossing
    kept = np.empty((count, 2 * corners), bool)
    kept[:, 0::2], kept[:, 1::2] = inside, crosses
    return _compact(slots, kept)


def _compact(slots, kept) -> np.ndarray:
    """Kept slots first in each row, in order, then the last kept one repeated."""
    number = kept.sum(axis=1)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : max(int(number.max(initial=1)), 1)]
    rank = np.minimum(np.arange(order.shape[1]), np.maximum(number - 1, 0)[:, None])
    order = np.take_along_axis(order, rank, axis=1)
    packed = np.take_along_axis(slots, order[..., None], axis=1)
    packed[number == 0] = 0.0
    return packed


def clip_to_grid(polygons: np.ndarray, shape: tuple[int, int], image: tuple[int, int], measure=polygon_area):
    """Overlap of convex polygons with the cells of a grid laid over an image.

    polygons (m, k, 2) in pixels (u, v); shape (rows, cols) of the grid; image (width, height) in
    pixels. Returns polygon index, cell index (row-major, row along v) and measure of the overlap,
    each (p,). `measure` maps polygons (p, k, 2) in pixels to areas in whatever plane is wanted.
    """
    rows, cols = shape
    edges = np.arange(cols + 1) * (image[0] / cols), np.arange(rows + 1) * (image[1] / rows)
    first, last = _cell_range(polygons, 0, cols, image[0]), _cell_range(polygons, 1, rows, image[1])
    pairs = np.maximum(first[1] - first[0], 0) * np.maximum(last[1] - last[0], 0)
    found = []
    for block in _blocks(pairs):
        found.append(_clip_block(polygons, block, first, last, edges, cols, measure))
    if not found:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


def _cell_range(polygons, axis, cells, length):
    """First cell and one past the last cell, (m,) each, that the polygons' boxes touch."""
    scale = cells / length
    low = np.floor(polygons[..., axis].min(axis=1) * scale)
    high = np.ceil(polygons[..., axis].max(axis=1) * scale)
    return np.clip(low, 0, cells).astype(np.int64), np.clip(high, 0, cells).astype(np.int64)


def _blocks(pairs):
    """Slices of polygons, each with about PAIRS_AT_ONCE candidate pairs."""
    if not len(pairs):
        return
    number = np.cumsum(pairs) // PAIRS_AT_ONCE
    cuts = np.flatnonzero(np.diff(number)) + 1
    yield from (np.arange(a, b) for a, b in zip([0, *cuts], [*cuts, len(pairs)], strict=True))


def _clip_block(polygons, block, u_range, v_range, edges, cols, measure):
    owner, col = _spread(block, u_range)
    strip = _clip_band(polygons[owner], 0, edges[0][col], edges[0][col + 1])
    alive = strip.any(axis=(1, 2))
    owner, col, strip = owner[alive], col[alive], strip[alive]
    which, row = _spread(np.arange(len(owner)), (v_range[0][owner], v_range[1][owner]))
    owner, col = owner[which], col[which]
    area = measure(_clip_band(strip[which], 1, edges[1][row], edges[1][row + 1]))
    alive = area > 0.0
    return owner[alive], (row * cols + col)[alive], area[alive]


def _clip_band(polygons, axis, low, high):
    return clip_half_plane(clip_half_plane(polygons, axis, low, True), axis, high, False)


def _spread(index, bounds):
    """Repeat each of `index` once per cell of its range [start, stop); return the index and the cell."""
    start, stop = bounds[0][index], bounds[1][index]
    number = np.maximum(stop - start, 0)
    offset = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
    return np.repeat(index, number), np.repeat(start, number) + offset
