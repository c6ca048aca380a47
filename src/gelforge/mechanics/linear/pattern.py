"""Sparse matrices with three unknowns per free node: pattern, positions of 3 x 3 blocks, products."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numba import njit

NOT_FREE = -1


@dataclass(frozen=True)
class Pattern:
    """Upper triangle, CSR, of the matrix that couples the 3 unknowns of every free node.

    indptr, indices: its pattern. first_row: (n,) first unknown of a node, or NOT_FREE.
    start, width: (n,) position of a node's first row in the values, and length of that row.
    rows, columns: the underlying node adjacency (CSR of its upper triangle).
    """

    indptr: np.ndarray
    indices: np.ndarray
    first_row: np.ndarray
    start: np.ndarray
    width: np.ndarray
    rows: np.ndarray
    columns: np.ndarray


def build_pattern(elements: np.ndarray, n_nodes: int, fixed: np.ndarray) -> Pattern:
    """Pattern of elements (e, k) on n_nodes nodes; the nodes `fixed` have no unknowns."""
    free = np.ones(n_nodes, bool)
    free[fixed] = False
    number = np.full(n_nodes, NOT_FREE, np.int64)
    number[free] = np.arange(free.sum())
    e, k = elements.shape
    incidence = sp.csr_matrix((np.ones(e * k, np.int8), elements.ravel(), np.arange(0, e * k + 1, k)), (e, n_nodes))
    incidence = incidence[:, free].astype(np.int32)
    upper = sp.triu(incidence.T @ incidence, format="csr")
    upper.sort_indices()
    indptr, indices, start, width = _expand(upper.indptr.astype(np.int64), upper.indices.astype(np.int64))
    first_row = np.where(free, 3 * number, NOT_FREE)
    place = np.zeros((2, n_nodes), np.int64)
    place[:, free] = start, width
    return Pattern(indptr, indices, first_row, place[0], place[1], upper.indptr, upper.indices)


@njit(cache=True)
def _expand(rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    n = len(rows) - 1
    indptr = np.empty(3 * n + 1, np.int32)
    indices = np.empty(9 * len(columns) - 3 * n, np.int32)
    start = np.empty(n, np.int64)
    width = np.empty(n, np.int64)
    at = 0
    for p in range(n):
        start[p] = at
        width[p] = 3 * (rows[p + 1] - rows[p])
        for i in range(3):
            indptr[3 * p + i] = at
            for r in range(rows[p], rows[p + 1]):
                for k in range(3):
                    if columns[r] != p or k >= i:
                        indices[at] = 3 * columns[r] + k
                        at += 1
    indptr[3 * n] = at
    return indptr, indices, start, width


def block_places(pattern: Pattern, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the values of the 3 x 3 blocks of all node pairs a <= b of cells (e, k).

    Returns base (e, pairs) and width (e, pairs): entry (i, j) of a block is at
    base + i width - i (i + 1) / 2 + j. base is NOT_FREE if a node is fixed; a negative width means that
    the block is stored transposed.
    """
    cells = np.ascontiguousarray(cells, np.int64)
    rows, columns = pattern.rows.astype(np.int64), pattern.columns.astype(np.int64)
    return _block_places(cells, pattern.first_row, pattern.start, pattern.width, rows, columns)


@njit(cache=True)
def _block_places(
    cells: np.ndarray,
    first_row: np.ndarray,
    start: np.ndarray,
    width: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    count, k = cells.shape
    base = np.empty((count, k * (k + 1) // 2), np.int32)
    widths = np.empty((count, k * (k + 1) // 2), np.int32)
    for e in range(count):
        pair = 0
        for a in range(k):
            for b in range(a, k):
                p, q = cells[e, a], cells[e, b]
                if first_row[p] < 0 or first_row[q] < 0:
                    base[e, pair] = NOT_FREE
                    widths[e, pair] = 0
                else:
                    swapped = first_row[p] > first_row[q]
                    if swapped:
                        p, q = q, p
                    row, column = first_row[p] // 3, first_row[q] // 3
                    rank = np.searchsorted(columns[rows[row] : rows[row + 1]], column)
                    base[e, pair] = start[p] + 3 * rank
                    widths[e, pair] = -width[p] if swapped else width[p]
                pair += 1
    return base, widths


def symmetric_product(pattern: Pattern, values: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Product (unknowns,) of the symmetric matrix with upper-triangle `values` (nnz,) and x (unknowns,)."""
    return _symmetric_product(pattern.rows, pattern.columns, pattern.indptr, values, x)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _symmetric_product(
    rows: np.ndarray, columns: np.ndarray, indptr: np.ndarray, values: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """Block by block, so that one index is read for nine values."""
    y = np.zeros(len(x))
    for p in range(len(rows) - 1):
        u = 3 * p
        x0, x1, x2 = x[u], x[u + 1], x[u + 2]
        first, second, third = indptr[u], indptr[u + 1], indptr[u + 2]
        a01, a02, a12 = values[first + 1], values[first + 2], values[second + 1]
        y0 = values[first] * x0 + a01 * x1 + a02 * x2
        y1 = a01 * x0 + values[second] * x1 + a12 * x2
        y2 = a02 * x0 + a12 * x1 + values[third] * x2
        first, second, third = first + 3, second + 2, third + 1
        for r in range(rows[p] + 1, rows[p + 1]):
            v = 3 * columns[r]
            z0, z1, z2 = x[v], x[v + 1], x[v + 2]
            b00, b01, b02 = values[first], values[first + 1], values[first + 2]
            b10, b11, b12 = values[second], values[second + 1], values[second + 2]
            b20, b21, b22 = values[third], values[third + 1], values[third + 2]
            y0 += b00 * z0 + b01 * z1 + b02 * z2
            y1 += b10 * z0 + b11 * z1 + b12 * z2
            y2 += b20 * z0 + b21 * z1 + b22 * z2
            y[v] += b00 * x0 + b10 * x1 + b20 * x2
            y[v + 1] += b01 * x0 + b11 * x1 + b21 * x2
            y[v + 2] += b02 * x0 + b12 * x1 + b22 * x2
            first, second, third = first + 3, second + 3, third + 3
        y[u] += y0
        y[u + 1] += y1
        y[u + 2] += y2
    return y


@njit(cache=True, inline="always")
def add_block(values: np.ndarray, base: int, width: int, block: np.ndarray, diagonal: bool) -> None:
    """Add a 3 x 3 block at a position given by `block_places`."""
    add_entries(
        values, base, width, diagonal,
        block[0, 0], block[0, 1], block[0, 2],
        block[1, 0], block[1, 1], block[1, 2],
        block[2, 0], block[2, 1], block[2, 2],
    )  # fmt: skip


@njit(cache=True, inline="always")
def add_entries(
    values: np.ndarray, base: int, width: int, diagonal: bool,
    b00: float, b01: float, b02: float, b10: float, b11: float, b12: float, b20: float, b21: float, b22: float,
) -> None:  # fmt: skip
    """Add the entries of a 3 x 3 block, given row by row, at a position given by `block_places`."""
    if base < 0:
        return
    if width < 0:
        width, b01, b10, b02, b20, b12, b21 = -width, b10, b01, b20, b02, b21, b12
    second, third = base + width, base + 2 * width - 1
    values[base] += b00
    values[base + 1] += b01
    values[base + 2] += b02
    values[second] += b11
    values[second + 1] += b12
    values[third] += b22
    if not diagonal:
        values[second - 1] += b10
        values[third - 2] += b20
        values[third - 1] += b21
