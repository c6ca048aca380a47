"""Eight-node hexahedron with mean dilatation (Q1P0) for a nearly incompressible Neo-Hookean solid.

Simo, Taylor, Pister (1985), Comput. Methods Appl. Mech. Eng. 51, 177-208: the isochoric energy is
integrated at 2 x 2 x 2 points, the volumetric one depends on the element's mean volume ratio only, so
hexahedra do not lock as nu goes to 1/2. Residual and tangent are exact derivatives of one energy,

    E = sum_g w_g C10 (J_g^(-2/3) tr(F_g^T F_g) - 3) + V (theta - 1)^2 / D1,  theta = (1/V) sum_g w_g J_g,

hence the tangent is symmetric.

Kernels work on WIDTH hexahedra at once, side by side in the last axis of every array, where a processor's vector
instructions are. Compilers use them only where they see that arrays do not overlap, which they do for arrays of constant
shape made in the kernel itself: what a point needs is copied there first.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from gelforge.mechanics.elements.simd import FAST, batched
from gelforge.mechanics.linear.pattern import add_entries
from gelforge.mechanics.mesh.stepped import Cells

CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float
)
WIDTH = 32


@dataclass(frozen=True)
class Hex8Geometry:
    """Reference geometry of e hexahedra in b batches of WIDTH; the last batch repeats its last hexahedron.

    elements: (e, 8) nodes. nodes: (b, 8, WIDTH) the same by batches. gradients: (b, 8 points, 8 nodes, 3, WIDTH).
    weights: (b, 8, WIDTH) mm^3.
    """

    elements: np.ndarray
    nodes: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray


def geometry(nodes: np.ndarray, cells: Cells) -> Hex8Geometry:
    """Gradients and weights of hex8 hexahedra on nodes (n, 3) mm; an inverted one raises ValueError."""
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
    corners = np.ascontiguousarray(cells.corners, np.int32)
    gradients, weights = _geometry(np.ascontiguousarray(nodes, np.float64), corners, local)
    if weights.min() <= 0.0:
        raise ValueError(f"{int((weights.min(axis=1) <= 0).sum())} hexahedra are inverted")
    lower = gradients[cells.standing, :, :4]
    gradients[cells.standing, :, :4] = np.einsum("sba,sgbi->sgai", cells.shares, lower)
    elements = np.ascontiguousarray(cells.nodes, np.int32)
    return Hex8Geometry(elements, *(batched(values, WIDTH) for values in (elements, gradients, weights)))


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


# Rows of `near`, by node: gradients of its shape function in the reference and in space, and F times the first.
# Rows of `point`: of an integration point, and sums over those of a hexahedron.
_WEIGHT, _RATIO, _SQUARES, _VOLUME, _SUM_VOLUME, _SUM_DEFORMED, _PRESSURE, _ALPHA, _BETA, _DIAGONAL = range(10)


def internal_forces(u: np.ndarray, geometry: Hex8Geometry, shear: float, bulk: float, forces: np.ndarray) -> float:
    """Add the nodal forces dE/du to `forces` (n, 3); returns the smallest J (not above 0: inverted, forces mean nothing).

    u: (n, 3) displacement mm. shear, bulk: moduli MPa (2 C10 and 2 / D1).
    """
    b = geometry
    return _internal_forces(u, b.nodes, b.gradients, b.weights, len(b.elements), shear, bulk, forces)


def smallest_ratios(u: np.ndarray, geometry: Hex8Geometry) -> np.ndarray:
    """The smallest volume ratio J within each hexahedron (e,) at nodal displacements u (n, 3) mm; below 0 it is inverted."""
    smallest = np.empty((len(geometry.nodes), WIDTH))
    _smallest_ratios(u, geometry.nodes, geometry.gradients, geometry.weights, smallest)
    return smallest.ravel()[: len(geometry.elements)]


def tangent(
    u: np.ndarray,
    geometry: Hex8Geometry,
    shear: float,
    bulk: float,
    geometric_stiffness: float,
    base: np.ndarray,
    width: np.ndarray,
    values: np.ndarray,
) -> None:
    """Add d2E/du2 to the upper-triangle `values` at the places (base, width) of `pattern.block_places`.

    geometric_stiffness: the share of the pressure's geometric stiffness that is kept, 1 in the exact tangent. Blocks are computed in
    single precision, as they are factorised.
    """
    b = geometry
    single = np.float32(shear), np.float32(bulk), np.float32(geometric_stiffness)
    _tangent(u, b.nodes, b.gradients, b.weights, len(b.elements), *single, base, width, values)


@njit(inline="always")
def _clear(rows: np.ndarray) -> None:
    """Set rows (k, WIDTH) to zero; said as `rows[:] = 0` the compiler would no longer know their shape."""
    for i in range(rows.shape[0]):
        for lane in range(WIDTH):
            rows[i, lane] = 0.0


@njit(inline="always")
def _displacements(u: np.ndarray, nodes: np.ndarray, batch: int, moved: np.ndarray) -> None:
    """Copy the displacements of a batch's nodes to `moved` (8, 3, WIDTH)."""
    for a in range(8):
        for lane in range(WIDTH):
            node = nodes[batch, a, lane]
            moved[a, 0, lane] = u[node, 0]
            moved[a, 1, lane] = u[node, 1]
            moved[a, 2, lane] = u[node, 2]


@njit(inline="always")
def _kinematics(
    gradients: np.ndarray,
    weights: np.ndarray,
    batch: int,
    g: int,
    moved: np.ndarray,
    f: np.ndarray,
    inverse: np.ndarray,
    near: np.ndarray,
    point: np.ndarray,
) -> None:
    """Fill near (8, 9, WIDTH) and of point (10, WIDTH) what belongs to point g. f, inverse: (9, WIDTH) room."""
    for a in range(8):
        for i in range(3):
            for lane in range(WIDTH):
                near[a, i, lane] = gradients[batch, g, a, i, lane]
    for lane in range(WIDTH):
        point[_WEIGHT, lane] = weights[batch, g, lane]
    _deform(moved, near, f)
    _invert(f, inverse, point)
    _push(f, inverse, near)


@njit(inline="always")
def _deform(moved: np.ndarray, near: np.ndarray, f: np.ndarray) -> None:
    """Fill f (9, WIDTH), the deformation gradient at a point, row by row."""
    for i in range(9):
        for lane in range(WIDTH):
            f[i, lane] = 1.0 if i % 4 == 0 else 0.0
    for a in range(8):
        for lane in range(WIDTH):
            x, y, z = near[a, 0, lane], near[a, 1, lane], near[a, 2, lane]
            u0, u1, u2 = moved[a, 0, lane], moved[a, 1, lane], moved[a, 2, lane]
            f[0, lane] += u0 * x
            f[1, lane] += u0 * y
            f[2, lane] += u0 * z
            f[3, lane] += u1 * x
            f[4, lane] += u1 * y
            f[5, lane] += u1 * z
            f[6, lane] += u2 * x
            f[7, lane] += u2 * y
            f[8, lane] += u2 * z


@njit(inline="always")
def _invert(f: np.ndarray, inverse: np.ndarray, point: np.ndarray) -> None:
    """Fill inverse (9, WIDTH), transposed, and what the point has of F: J, the sum of its squares, and its volume."""
    for lane in range(WIDTH):
        f0, f1, f2 = f[0, lane], f[1, lane], f[2, lane]
        f3, f4, f5 = f[3, lane], f[4, lane], f[5, lane]
        f6, f7, f8 = f[6, lane], f[7, lane], f[8, lane]
        c0, c1, c2 = f4 * f8 - f5 * f7, f5 * f6 - f3 * f8, f3 * f7 - f4 * f6
        ratio = f0 * c0 + f1 * c1 + f2 * c2
        inverse[0, lane] = c0 / ratio
        inverse[1, lane] = c1 / ratio
        inverse[2, lane] = c2 / ratio
        inverse[3, lane] = (f2 * f7 - f1 * f8) / ratio
        inverse[4, lane] = (f0 * f8 - f2 * f6) / ratio
        inverse[5, lane] = (f1 * f6 - f0 * f7) / ratio
        inverse[6, lane] = (f1 * f5 - f2 * f4) / ratio
        inverse[7, lane] = (f2 * f3 - f0 * f5) / ratio
        inverse[8, lane] = (f0 * f4 - f1 * f3) / ratio
        point[_RATIO, lane] = ratio
        point[_SQUARES, lane] = (
            f0 * f0 + f1 * f1 + f2 * f2 + f3 * f3 + f4 * f4 + f5 * f5 + f6 * f6 + f7 * f7 + f8 * f8
        )
        point[_VOLUME, lane] = point[_WEIGHT, lane] * ratio


@njit(inline="always")
def _push(f: np.ndarray, inverse: np.ndarray, near: np.ndarray) -> None:
    """Fill of near (8, 9, WIDTH) the gradients in space, and F times those in the reference."""
    for a in range(8):
        for lane in range(WIDTH):
            x, y, z = near[a, 0, lane], near[a, 1, lane], near[a, 2, lane]
            near[a, 3, lane] = inverse[0, lane] * x + inverse[1, lane] * y + inverse[2, lane] * z
            near[a, 4, lane] = inverse[3, lane] * x + inverse[4, lane] * y + inverse[5, lane] * z
            near[a, 5, lane] = inverse[6, lane] * x + inverse[7, lane] * y + inverse[8, lane] * z
            near[a, 6, lane] = f[0, lane] * x + f[1, lane] * y + f[2, lane] * z
            near[a, 7, lane] = f[3, lane] * x + f[4, lane] * y + f[5, lane] * z
            near[a, 8, lane] = f[6, lane] * x + f[7, lane] * y + f[8, lane] * z


@njit(inline="always")
def _add_to_element(near: np.ndarray, point: np.ndarray, mean: np.ndarray) -> None:
    """Add a point's share to the volumes of its hexahedra and to their derivative `mean` (24, WIDTH)."""
    for lane in range(WIDTH):
        point[_SUM_VOLUME, lane] += point[_WEIGHT, lane]
        point[_SUM_DEFORMED, lane] += point[_VOLUME, lane]
    for a in range(8):
        for lane in range(WIDTH):
            volume = point[_VOLUME, lane]
            mean[3 * a, lane] += volume * near[a, 3, lane]
            mean[3 * a + 1, lane] += volume * near[a, 4, lane]
            mean[3 * a + 2, lane] += volume * near[a, 5, lane]


@njit(**FAST)
def _smallest_ratios(
    u: np.ndarray, nodes: np.ndarray, gradients: np.ndarray, weights: np.ndarray, smallest: np.ndarray
) -> None:
    moved, near = np.empty((8, 3, WIDTH)), np.empty((8, 9, WIDTH))
    f, inverse, point = np.empty((9, WIDTH)), np.empty((9, WIDTH)), np.empty((10, WIDTH))
    for batch in range(len(nodes)):
        _displacements(u, nodes, batch, moved)
        smallest[batch] = 1e30
        for g in range(8):
            _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
            for lane in range(WIDTH):
                smallest[batch, lane] = min(smallest[batch, lane], point[_RATIO, lane])


@njit(**FAST)
def _internal_forces(
    u: np.ndarray,
    nodes: np.ndarray,
    gradients: np.ndarray,
    weights: np.ndarray,
    count: int,
    shear: float,
    bulk: float,
    forces: np.ndarray,
) -> float:
    moved, near = np.empty((8, 3, WIDTH)), np.empty((8, 9, WIDTH))
    f, inverse, point = np.empty((9, WIDTH)), np.empty((9, WIDTH)), np.empty((10, WIDTH))
    own, mean = np.empty((24, WIDTH)), np.empty((24, WIDTH))
    smallest = 1e30
    for batch in range(len(nodes)):
        _displacements(u, nodes, batch, moved)
        _clear(own)
        _clear(mean)
        _clear(point)
        for g in range(8):
            _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
            for lane in range(WIDTH):
                smallest = min(smallest, point[_RATIO, lane])
            if smallest <= 0.0:
                return smallest
            _add_to_element(near, point, mean)
            for lane in range(WIDTH):
                point[_ALPHA, lane] = shear * point[_WEIGHT, lane] * point[_RATIO, lane] ** (-2.0 / 3.0)
            for a in range(8):
                for lane in range(WIDTH):
                    alpha, third = point[_ALPHA, lane], point[_SQUARES, lane] / 3.0
                    own[3 * a, lane] += alpha * (near[a, 6, lane] - third * near[a, 3, lane])
                    own[3 * a + 1, lane] += alpha * (near[a, 7, lane] - third * near[a, 4, lane])
                    own[3 * a + 2, lane] += alpha * (near[a, 8, lane] - third * near[a, 5, lane])
        for lane in range(WIDTH):
            point[_PRESSURE, lane] = bulk * (point[_SUM_DEFORMED, lane] / point[_SUM_VOLUME, lane] - 1.0)
        for a in range(8):
            for i in range(3):
                for lane in range(WIDTH):
                    own[3 * a + i, lane] += point[_PRESSURE, lane] * mean[3 * a + i, lane]
        for lane in range(min(WIDTH, count - batch * WIDTH)):
            for a in range(8):
                for i in range(3):
                    forces[nodes[batch, a, lane], i] += own[3 * a + i, lane]
    return smallest


@njit(**FAST)
def _tangent(
    u: np.ndarray,
    nodes: np.ndarray,
    gradients: np.ndarray,
    weights: np.ndarray,
    count: int,
    shear: float,
    bulk: float,
    geometric_stiffness: float,
    base: np.ndarray,
    width: np.ndarray,
    values: np.ndarray,
) -> None:
    single = np.float32
    moved, near = np.empty((8, 3, WIDTH), single), np.empty((8, 9, WIDTH), single)
    f, inverse, point = np.empty((9, WIDTH), single), np.empty((9, WIDTH), single), np.empty((10, WIDTH), single)
    mean, blocks = np.empty((24, WIDTH), single), np.empty((36, 9, WIDTH), single)
    for batch in range(len(nodes)):
        _displacements(u, nodes, batch, moved)
        _clear(mean)
        _clear(point)
        for g in range(8):
            _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
            _add_to_element(near, point, mean)
        for lane in range(WIDTH):
            strain = (point[_SUM_DEFORMED, lane] - point[_SUM_VOLUME, lane]) / point[_SUM_VOLUME, lane]
            point[_PRESSURE, lane] = geometric_stiffness * bulk * strain
            point[_ALPHA, lane] = bulk / point[_SUM_VOLUME, lane]
        _begin_blocks(point, mean, blocks)
        for g in range(8):
            _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
            _weigh(shear, near, point)
            _add_point(near, point, blocks)
        for lane in range(min(WIDTH, count - batch * WIDTH)):
            _assemble(base, width, batch * WIDTH + lane, blocks, lane, values)


@njit(inline="always")
def _begin_blocks(point: np.ndarray, mean: np.ndarray, blocks: np.ndarray) -> None:
    """Set blocks (36, 9, WIDTH) to the mean volume's rank-one term, K / V dV (x) dV."""
    pair = 0
    for a in range(8):
        for b in range(a, 8):
            for lane in range(WIDTH):
                k = point[_ALPHA, lane]
                m0, m1, m2 = k * mean[3 * a, lane], k * mean[3 * a + 1, lane], k * mean[3 * a + 2, lane]
                n0, n1, n2 = mean[3 * b, lane], mean[3 * b + 1, lane], mean[3 * b + 2, lane]
                blocks[pair, 0, lane] = m0 * n0
                blocks[pair, 1, lane] = m0 * n1
                blocks[pair, 2, lane] = m0 * n2
                blocks[pair, 3, lane] = m1 * n0
                blocks[pair, 4, lane] = m1 * n1
                blocks[pair, 5, lane] = m1 * n2
                blocks[pair, 6, lane] = m2 * n0
                blocks[pair, 7, lane] = m2 * n1
                blocks[pair, 8, lane] = m2 * n2
            pair += 1


@njit(inline="always")
def _weigh(shear: float, near: np.ndarray, point: np.ndarray) -> None:
    """Fill in a point's coefficients of `_add_point`, and multiply F G by -2/3 alpha."""
    third, two = np.float32(1.0 / 3.0), np.float32(2.0)
    for lane in range(WIDTH):
        point[_ALPHA, lane] = shear * point[_WEIGHT, lane] * point[_RATIO, lane] ** (-two * third)
    for lane in range(WIDTH):
        volumetric = point[_PRESSURE, lane] * point[_VOLUME, lane]
        isochoric = point[_ALPHA, lane] * point[_SQUARES, lane] * third
        point[_BETA, lane] = isochoric - volumetric
        point[_DIAGONAL, lane] = two * third * isochoric + volumetric
    for a in range(8):
        for lane in range(WIDTH):
            factor = -two * third * point[_ALPHA, lane]
            near[a, 6, lane] *= factor
            near[a, 7, lane] *= factor
            near[a, 8, lane] *= factor


@njit(inline="always")
def _add_point(near: np.ndarray, point: np.ndarray, blocks: np.ndarray) -> None:
    """Add a point's isochoric and geometric stiffness to the blocks of all node pairs a <= b.

    With alpha = 2 C10 J^(-2/3) w, G reference and g spatial gradients and t = -2/3 alpha F G, a block is
    alpha Ga.Gb I + ga (x) (t_b + diagonal gb) + t_a (x) gb + beta gb (x) ga.
    """
    pair = 0
    for a in range(8):
        for b in range(a, 8):
            for lane in range(WIDTH):
                g0, g1, g2 = near[a, 3, lane], near[a, 4, lane], near[a, 5, lane]
                h0, h1, h2 = near[b, 3, lane], near[b, 4, lane], near[b, 5, lane]
                t0, t1, t2 = near[a, 6, lane], near[a, 7, lane], near[a, 8, lane]
                diagonal, beta = point[_DIAGONAL, lane], point[_BETA, lane]
                s0, s1, s2 = (
                    near[b, 6, lane] + diagonal * h0,
                    near[b, 7, lane] + diagonal * h1,
                    near[b, 8, lane] + diagonal * h2,
                )
                b0, b1, b2 = beta * g0, beta * g1, beta * g2
                product = (
                    near[a, 0, lane] * near[b, 0, lane]
                    + near[a, 1, lane] * near[b, 1, lane]
                    + near[a, 2, lane] * near[b, 2, lane]
                )
                product *= point[_ALPHA, lane]
                blocks[pair, 0, lane] += product + g0 * s0 + (t0 + b0) * h0
                blocks[pair, 1, lane] += g0 * s1 + t0 * h1 + b1 * h0
                blocks[pair, 2, lane] += g0 * s2 + t0 * h2 + b2 * h0
                blocks[pair, 3, lane] += g1 * s0 + t1 * h0 + b0 * h1
                blocks[pair, 4, lane] += product + g1 * s1 + (t1 + b1) * h1
                blocks[pair, 5, lane] += g1 * s2 + t1 * h2 + b2 * h1
                blocks[pair, 6, lane] += g2 * s0 + t2 * h0 + b0 * h2
                blocks[pair, 7, lane] += g2 * s1 + t2 * h1 + b1 * h2
                blocks[pair, 8, lane] += product + g2 * s2 + (t2 + b2) * h2
            pair += 1


@njit(inline="always")
def _assemble(base: np.ndarray, width: np.ndarray, e: int, blocks: np.ndarray, lane: int, values: np.ndarray) -> None:
    """Add the blocks of hexahedron e, in lane lane, at their places in the matrix."""
    pair = 0
    for a in range(8):
        for b in range(a, 8):
            add_entries(
                values, base[e, pair], width[e, pair], a == b,
                blocks[pair, 0, lane], blocks[pair, 1, lane], blocks[pair, 2, lane],
                blocks[pair, 3, lane], blocks[pair, 4, lane], blocks[pair, 5, lane],
                blocks[pair, 6, lane], blocks[pair, 7, lane], blocks[pair, 8, lane],
            )  # fmt: skip
            pair += 1
