"""The nearest of many edges to each of many points; compiled, because most of a distance's time is spent here."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def of_edges(points: np.ndarray, starts: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vector (n, 3) from the nearest point on any edge to points (n, 3), and its length (n,).

    Edge k runs from starts[k] to starts[k] + edges[k], (e, 3) each. The first of equally near edges counts.
    """
    to, length = np.empty_like(points), np.empty(len(points))
    for p in range(len(points)):
        x, y, z = points[p]
        best = np.inf
        for k in range(len(starts)):
            ux, uy, uz = edges[k]
            rx, ry, rz = x - starts[k, 0], y - starts[k, 1], z - starts[k, 2]
            t = (rx * ux + ry * uy + rz * uz) / (ux * ux + uy * uy + uz * uz)
            t = min(max(t, 0.0), 1.0)
            dx, dy, dz = rx - t * ux, ry - t * uy, rz - t * uz
            square = dx * dx + dy * dy + dz * dz
            if square < best:
                best = square
                to[p, 0], to[p, 1], to[p, 2] = dx, dy, dz
        length[p] = np.sqrt(best)
    return to, length


@njit(cache=True, nogil=True, error_model="numpy")
def of_outline(
    points: np.ndarray, corners: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vector (n, 2) from the nearest point of a closed outline to points (n, 2), and its length (n,).

    Also returns the edge (n,) and whether points are inside (n,). corners: (k, 2). edges: (k, 2) from each corner to
    the next. The first of equally near edges counts.
    """
    to, length = np.empty((len(points), 2)), np.empty(len(points))
    which, inside = np.zeros(len(points), np.int64), np.zeros(len(points), np.bool_)
    for p in range(len(points)):
        px, py = points[p, 0], points[p, 1]
        best = np.inf
        for k in range(len(corners)):
            cy, ey = corners[k, 1], corners[(k + 1) % len(corners), 1]
            ux, uy = edges[k]
            rx, ry = px - corners[k, 0], py - cy
            t = (rx * ux + ry * uy) / (ux * ux + uy * uy)
            t = min(max(t, 0.0), 1.0)
            dx, dy = rx - t * ux, ry - t * uy
            square = dx * dx + dy * dy
            if square < best:
                best = square
                to[p, 0], to[p, 1], which[p] = dx, dy, k
            # both y values as the neighbouring edges see them, or rounding could count a crossing once too often
            if (py >= cy) != (py >= ey) and rx < ux / uy * ry:
                inside[p] = not inside[p]
        length[p] = np.sqrt(best)
    return to, length, which, inside
