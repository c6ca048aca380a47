"""Eight-node brick with mean dilatation (Q1P0) for a nearly incompressible Neo-Hookean solid.

Simo, Taylor, Pister (1985), Comput. Methods Appl. Mech. Eng. 51, 177-208: the isochoric energy is
integrated at 2 x 2 x 2 points, the volumetric one depends on the element's mean volume ratio only, so
bricks do not lock as nu goes to 1/2. Residual and tangent are exact derivatives of one energy,

    E = sum_g w_g C10 (J_g^(-2/3) tr(F_g^T F_g) - 3) + V (theta - 1)^2 / D1,  theta = (1/V) sum_g w_g J_g,

hence the tangent is symmetric.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float
)
NOT_FREE = -1
_FAST: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


@dataclass(frozen=True)
class BrickGeometry:
    """Reference geometry of e bricks: gradients (e, 8 points, 8 nodes, 3), weights (e, 8) mm^3."""

    elements: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray


def bricks(nodes: np.ndarray, elements: np.ndarray) -> BrickGeometry:
    """Gradients and weights of hex8 elements (e, 8) on nodes (n, 3); an inverted one raises ValueError."""
    points = CORNERS / np.sqrt(3.0)
    local = np.empty((8, 8, 3))
    for axis in range(3):
        first, second = [i for i in range(3) if i != axis]
        local[:, :, axis] = (
            CORNERS[None, :, axis]
            * (1 + points[:, None, first] * CORNERS[None, :, first])
            * (1 + points[:, None, second] * CORNERS[None, :, second])
            / 8.0
        )
    elements = np.ascontiguousarray(elements, np.int32)
    gradients, weights = _geometry(np.ascontiguousarray(nodes, np.float64), elements, local)
    if weights.min() <= 0.0:
        raise ValueError(f"{int((weights.min(axis=1) <= 0).sum())} bricks are inverted")
    return BrickGeometry(elements, gradients, weights)


@njit(cache=True, nogil=True)
def _geometry(nodes: np.ndarray, elements: np.ndarray, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (e, 8, 8, 3) of the shape functions and weights (e, 8): the Jacobian's determinant."""
    count = len(elements)
    gradients, weights = np.empty((count, 8, 8, 3)), np.empty((count, 8))
    jacobian, inverse = np.empty((3, 3)), np.empty((3, 3))
    for e in range(count):
        for g in range(8):
            jacobian[:] = 0.0
            for a in range(8):
                for i in range(3):
                    for k in range(3):
                        jacobian[i, k] += nodes[elements[e, a], i] * local[g, a, k]
            for i in range(3):
                for k in range(3):
                    p, q, r, s = (k + 1) % 3, (k + 2) % 3, (i + 1) % 3, (i + 2) % 3
                    inverse[i, k] = jacobian[p, r] * jacobian[q, s] - jacobian[p, s] * jacobian[q, r]
            volume = jacobian[0, 0] * inverse[0, 0] + jacobian[0, 1] * inverse[1, 0] + jacobian[0, 2] * inverse[2, 0]
            weights[e, g] = volume
            for a in range(8):
                for i in range(3):
                    total = 0.0
                    for k in range(3):
                        total += local[g, a, k] * inverse[k, i]
                    gradients[e, g, a, i] = total / volume if volume != 0.0 else 0.0
    return gradients, weights


@dataclass(frozen=True)
class Pattern:
    """Upper triangle, CSR, of the matrix that couples the 3 unknowns of every free node.

    indptr, indices: its pattern. first_row: (n,) first unknown of a node, or NOT_FREE.
    start, width: (n,) place of a node's first row in the values, and length of that row.
    rows, columns: node adjacency behind it (CSR of the upper triangle, nodes).
    """

    indptr: np.ndarray
    indices: np.ndarray
    first_row: np.ndarray
    start: np.ndarray
    width: np.ndarray
    rows: np.ndarray
    columns: np.ndarray


def build_pattern(elements: np.ndarray, n_nodes: int, fixed: np.ndarray) -> Pattern:
    """Pattern of elements (e, k) on n_nodes nodes of which `fixed` have no unknowns."""
    import scipy.sparse as sp

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
    """Where the 3 x 3 blocks of all node pairs a <= b of cells (e, k) stand in the values.

    Returns base (e, pairs) and width (e, pairs): entry (i, j) of a block stands at
    base + i width - i (i + 1) / 2 + j. NOT_FREE where a node is fixed; a negative width says that
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


@njit(**_FAST)
def internal_forces(
    u: np.ndarray,
    elements: np.ndarray,
    gradients: np.ndarray,
    weights: np.ndarray,
    shear: float,
    bulk: float,
    forces: np.ndarray,
) -> float:
    """Add the nodal forces dE/du to `forces` (n, 3); returns the smallest J (negative: inverted).

    u: (n, 3) displacement mm. shear, bulk: moduli MPa (2 C10 and 2 / D1).
    """
    f = np.empty((3, 3))
    spatial = np.empty((8, 8, 3))
    point_j = np.empty(8)
    smallest = 1e30
    for e in range(elements.shape[0]):
        volume = 0.0
        deformed = 0.0
        for g in range(8):
            _deformation(u, elements, gradients, e, g, f)
            j, trace = _spatial(f, gradients, e, g, spatial)
            smallest = min(smallest, j)
            volume += weights[e, g]
            deformed += weights[e, g] * j
            if j <= 0.0:
                return j
            alpha = shear * j ** (-2.0 / 3.0) * weights[e, g]
            point_j[g] = j * weights[e, g]
            for a in range(8):
                node = elements[e, a]
                for i in range(3):
                    forces[node, i] += alpha * (
                        f[i, 0] * gradients[e, g, a, 0]
                        + f[i, 1] * gradients[e, g, a, 1]
                        + f[i, 2] * gradients[e, g, a, 2]
                        - trace / 3.0 * spatial[g, a, i]
                    )
        pressure = bulk * (deformed / volume - 1.0)
        for g in range(8):
            factor = pressure * point_j[g]
            for a in range(8):
                node = elements[e, a]
                for i in range(3):
                    forces[node, i] += factor * spatial[g, a, i]
    return smallest


def smallest_ratios(u: np.ndarray, geometry: BrickGeometry) -> np.ndarray:
    """The smallest volume ratio J within each brick (e,) at nodal displacements u (n, 3) mm; below 0 it is inside out."""
    smallest = np.empty(len(geometry.elements))
    _smallest_ratios(u, geometry.elements, geometry.gradients, smallest)
    return smallest


@njit(**_FAST)
def _smallest_ratios(u: np.ndarray, elements: np.ndarray, gradients: np.ndarray, smallest: np.ndarray) -> None:
    f = np.empty((3, 3))
    spatial = np.empty((8, 8, 3))
    for e in range(elements.shape[0]):
        smallest[e] = 1e30
        for g in range(8):
            _deformation(u, elements, gradients, e, g, f)
            j, _ = _spatial(f, gradients, e, g, spatial)
            smallest[e] = min(smallest[e], j)


@njit(inline="always")
def _deformation(u: np.ndarray, elements: np.ndarray, gradients: np.ndarray, e: int, g: int, f: np.ndarray) -> None:
    for i in range(3):
        for k in range(3):
            f[i, k] = 0.0
    for a in range(8):
        node = elements[e, a]
        for i in range(3):
            for k in range(3):
                f[i, k] += u[node, i] * gradients[e, g, a, k]
    for i in range(3):
        f[i, i] += 1.0


@njit(inline="always")
def _spatial(f: np.ndarray, gradients: np.ndarray, e: int, g: int, spatial: np.ndarray) -> tuple[float, float]:
    c00 = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    c01 = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    c02 = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    j = f[0, 0] * c00 + f[0, 1] * c01 + f[0, 2] * c02
    c10 = f[0, 2] * f[2, 1] - f[0, 1] * f[2, 2]
    c11 = f[0, 0] * f[2, 2] - f[0, 2] * f[2, 0]
    c12 = f[0, 1] * f[2, 0] - f[0, 0] * f[2, 1]
    c20 = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    c21 = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    c22 = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    inverse = 1.0 / j
    trace = 0.0
    for i in range(3):
        for k in range(3):
            trace += f[i, k] * f[i, k]
    for a in range(8):
        x, y, z = gradients[e, g, a, 0], gradients[e, g, a, 1], gradients[e, g, a, 2]
        spatial[g, a, 0] = (c00 * x + c01 * y + c02 * z) * inverse
        spatial[g, a, 1] = (c10 * x + c11 * y + c12 * z) * inverse
        spatial[g, a, 2] = (c20 * x + c21 * y + c22 * z) * inverse
    return j, trace


@njit(**_FAST)
def tangent(
    u: np.ndarray,
    elements: np.ndarray,
    gradients: np.ndarray,
    weights: np.ndarray,
    shear: float,
    bulk: float,
    pressed: float,
    base: np.ndarray,
    width: np.ndarray,
    values: np.ndarray,
) -> None:
    """Add d2E/du2 to the upper-triangle `values` at the places of `block_places`.

    Block (a, b) of a point, with alpha = 2 C10 J^(-2/3) w, G reference and g spatial gradients:
    alpha Ga.Gb I + ga (x) s_b + t_a (x) gb + beta gb (x) ga, plus the mean volume's rank-one term.
    """
    f = np.empty((3, 3))
    spatial = np.empty((8, 8, 3))
    ratio = np.empty(8)
    traces = np.empty(8)
    stress = np.empty((8, 8, 3))
    mean = np.empty((8, 3))
    blocks = np.empty((36, 3, 3))
    s = np.empty((8, 3))
    for e in range(elements.shape[0]):
        volume = 0.0
        deformed = 0.0
        mean[:] = 0.0
        for g in range(8):
            _deformation(u, elements, gradients, e, g, f)
            j, trace = _spatial(f, gradients, e, g, spatial)
            ratio[g] = j
            traces[g] = trace
            volume += weights[e, g]
            deformed += weights[e, g] * j
            for a in range(8):
                for i in range(3):
                    mean[a, i] += weights[e, g] * j * spatial[g, a, i]
                    stress[g, a, i] = (
                        f[i, 0] * gradients[e, g, a, 0]
                        + f[i, 1] * gradients[e, g, a, 1]
                        + f[i, 2] * gradients[e, g, a, 2]
                    )
        pressure = bulk * (deformed / volume - 1.0)
        stiffness = bulk / volume
        pair = 0
        for a in range(8):
            for b in range(a, 8):
                for i in range(3):
                    for k in range(3):
                        blocks[pair, i, k] = stiffness * mean[a, i] * mean[b, k]
                pair += 1
        for g in range(8):
            alpha = shear * ratio[g] ** (-2.0 / 3.0) * weights[e, g]
            volumetric = pressed * pressure * ratio[g] * weights[e, g]
            diagonal = 2.0 / 9.0 * alpha * traces[g] + volumetric
            beta = alpha * traces[g] / 3.0 - volumetric
            third = -2.0 / 3.0 * alpha
            for a in range(8):
                for i in range(3):
                    stress[g, a, i] *= third
                    s[a, i] = stress[g, a, i] + diagonal * spatial[g, a, i]
            pair = 0
            for a in range(8):
                ga0, ga1, ga2 = spatial[g, a, 0], spatial[g, a, 1], spatial[g, a, 2]
                ta0, ta1, ta2 = stress[g, a, 0], stress[g, a, 1], stress[g, a, 2]
                x = alpha * gradients[e, g, a, 0]
                y = alpha * gradients[e, g, a, 1]
                z = alpha * gradients[e, g, a, 2]
                ba0, ba1, ba2 = beta * ga0, beta * ga1, beta * ga2
                for b in range(a, 8):
                    gb0, gb1, gb2 = spatial[g, b, 0], spatial[g, b, 1], spatial[g, b, 2]
                    s0, s1, s2 = s[b, 0], s[b, 1], s[b, 2]
                    dot = x * gradients[e, g, b, 0] + y * gradients[e, g, b, 1] + z * gradients[e, g, b, 2]
                    block = blocks[pair]
                    block[0, 0] += dot + ga0 * s0 + ta0 * gb0 + ba0 * gb0
                    block[0, 1] += ga0 * s1 + ta0 * gb1 + ba1 * gb0
                    block[0, 2] += ga0 * s2 + ta0 * gb2 + ba2 * gb0
                    block[1, 0] += ga1 * s0 + ta1 * gb0 + ba0 * gb1
                    block[1, 1] += dot + ga1 * s1 + ta1 * gb1 + ba1 * gb1
                    block[1, 2] += ga1 * s2 + ta1 * gb2 + ba2 * gb1
                    block[2, 0] += ga2 * s0 + ta2 * gb0 + ba0 * gb2
                    block[2, 1] += ga2 * s1 + ta2 * gb1 + ba1 * gb2
                    block[2, 2] += dot + ga2 * s2 + ta2 * gb2 + ba2 * gb2
                    pair += 1
        pair = 0
        for a in range(8):
            for b in range(a, 8):
                add_block(values, base[e, pair], width[e, pair], blocks[pair], a == b)
                pair += 1


@njit(cache=True, inline="always")
def add_block(values: np.ndarray, base: int, width: int, block: np.ndarray, diagonal: bool) -> None:
    """Add a 3 x 3 block at a place given by `block_places`."""
    if base < 0:
        return
    stride = width if width > 0 else -width
    for i in range(3):
        at = base + i * stride - i * (i + 1) // 2
        for k in range(i if diagonal else 0, 3):
            values[at + k] += block[i, k] if width > 0 else block[k, i]
