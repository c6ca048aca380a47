"""Ten-node tetrahedron of a Neo-Hookean solid, as CalculiX' C3D10: displacement only, four integration points.

Energy per volume of the undeformed body W = C10 (J^(-2/3) tr(F^T F) - 3) + (J - 1)^2 / D1. Residual and tangent are its exact derivatives.

Kernels work on WIDTH elements at once, side by side in the last axis of every array, as those of the hexahedra do and for
the same reason (`mechanics.elements.hex8`).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from gelforge.mechanics.elements.simd import FAST, batched
from gelforge.mechanics.linear.pattern import add_entries
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import GAUSS
from gelforge.mechanics.mesh.tetmesh import gradients as local_gradients

WIDTH = 16


@dataclass(frozen=True)
class Tet10Geometry:
    """Reference geometry of `count` elements in b batches of WIDTH; the last batch repeats its last element.

    nodes: (b, 10, WIDTH). gradients: (b, 4 points, 10 nodes, 3, WIDTH) of the shape functions. weights: (b, 4, WIDTH) mm^3.
    """

    count: int
    nodes: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray


def tets(mesh: GelMesh) -> Tet10Geometry:
    """Geometry of the elements of a mesh of ten-node tetrahedra."""
    local = local_gradients(GAUSS)
    jacobian = np.einsum("qak,eai->eqik", local, mesh.nodes[mesh.elements])
    weights = np.linalg.det(jacobian) / 24.0
    gradients = np.einsum("qak,eqki->eqai", local, np.linalg.inv(jacobian))
    elements = mesh.elements.astype(np.int32)
    return Tet10Geometry(len(elements), *(batched(values, WIDTH) for values in (elements, gradients, weights)))


def internal_forces(u: np.ndarray, geometry: Tet10Geometry, shear: float, bulk: float, forces: np.ndarray) -> float:
    """Add the nodal forces dE/du to `forces` (n, 3); returns the smallest J (not above 0: inverted, forces mean nothing).

    u: (n, 3) displacement mm. shear, bulk: moduli MPa (2 C10 and 2 / D1).
    """
    g = geometry
    return _internal_forces(u, g.nodes, g.gradients, g.weights, g.count, shear, bulk, forces)


def tangent(
    u: np.ndarray,
    geometry: Tet10Geometry,
    shear: float,
    bulk: float,
    geometric_stiffness: float,
    base: np.ndarray,
    width: np.ndarray,
    values: np.ndarray,
) -> None:
    """Add d2E/du2 to the upper-triangle `values` at the places (base, width) of `pattern.block_places`.

    geometric_stiffness: the share that is kept of what the bulk pressure adds to the stiffness, 1 in the exact tangent. Blocks are
    computed in single precision, as they are factorised.
    """
    g = geometry
    single = np.float32(shear), np.float32(bulk), np.float32(geometric_stiffness)
    _tangent(u, g.nodes, g.gradients, g.weights, g.count, *single, base, width, values)


# Rows of `near`, by node: gradients of its shape function in the reference and in space, and F times the first.
# Rows of `point`: of an integration point.
_WEIGHT, _RATIO, _SQUARES, _ALPHA, _BETA, _DIAGONAL = range(6)


@njit(inline="always")
def _clear(rows: np.ndarray) -> None:
    """Set rows (k, WIDTH) to zero; said as `rows[:] = 0` the compiler would no longer know their shape."""
    for i in range(rows.shape[0]):
        for lane in range(WIDTH):
            rows[i, lane] = 0.0


@njit(inline="always")
def _displacements(u: np.ndarray, nodes: np.ndarray, batch: int, moved: np.ndarray) -> None:
    """Copy the displacements of a batch's nodes to `moved` (10, 3, WIDTH)."""
    for a in range(10):
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
    q: int,
    moved: np.ndarray,
    f: np.ndarray,
    inverse: np.ndarray,
    near: np.ndarray,
    point: np.ndarray,
) -> None:
    """Fill near (10, 9, WIDTH) and of point (6, WIDTH) what belongs to point q. f, inverse: (9, WIDTH) room."""
    for a in range(10):
        for i in range(3):
            for lane in range(WIDTH):
                near[a, i, lane] = gradients[batch, q, a, i, lane]
    for lane in range(WIDTH):
        point[_WEIGHT, lane] = weights[batch, q, lane]
    _deform(moved, near, f)
    _invert(f, inverse, point)
    _push(f, inverse, near)


@njit(inline="always")
def _deform(moved: np.ndarray, near: np.ndarray, f: np.ndarray) -> None:
    """Fill f (9, WIDTH), the deformation gradient at a point, row by row."""
    for i in range(9):
        for lane in range(WIDTH):
            f[i, lane] = 1.0 if i % 4 == 0 else 0.0
    for a in range(10):
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
    """Fill inverse (9, WIDTH), transposed, and of the point J and the sum of F's squares."""
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


@njit(inline="always")
def _push(f: np.ndarray, inverse: np.ndarray, near: np.ndarray) -> None:
    """Fill of near (10, 9, WIDTH) the gradients in space, and F times those in the reference."""
    for a in range(10):
        for lane in range(WIDTH):
            x, y, z = near[a, 0, lane], near[a, 1, lane], near[a, 2, lane]
            near[a, 3, lane] = inverse[0, lane] * x + inverse[1, lane] * y + inverse[2, lane] * z
            near[a, 4, lane] = inverse[3, lane] * x + inverse[4, lane] * y + inverse[5, lane] * z
            near[a, 5, lane] = inverse[6, lane] * x + inverse[7, lane] * y + inverse[8, lane] * z
            near[a, 6, lane] = f[0, lane] * x + f[1, lane] * y + f[2, lane] * z
            near[a, 7, lane] = f[3, lane] * x + f[4, lane] * y + f[5, lane] * z
            near[a, 8, lane] = f[6, lane] * x + f[7, lane] * y + f[8, lane] * z


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
    moved, near = np.empty((10, 3, WIDTH)), np.empty((10, 9, WIDTH))
    f, inverse, point = np.empty((9, WIDTH)), np.empty((9, WIDTH)), np.empty((6, WIDTH))
    own = np.empty((30, WIDTH))
    smallest = 1e30
    for batch in range(len(nodes)):
        _displacements(u, nodes, batch, moved)
        _clear(own)
        for q in range(4):
            _kinematics(gradients, weights, batch, q, moved, f, inverse, near, point)
            for lane in range(WIDTH):
                smallest = min(smallest, point[_RATIO, lane])
            if smallest <= 0.0:
                return smallest
            for lane in range(WIDTH):
                weight, ratio = point[_WEIGHT, lane], point[_RATIO, lane]
                alpha = shear * weight * ratio ** (-2.0 / 3.0)
                point[_ALPHA, lane] = alpha
                point[_BETA, lane] = bulk * (ratio - 1.0) * ratio * weight - alpha * point[_SQUARES, lane] / 3.0
            for a in range(10):
                for lane in range(WIDTH):
                    alpha, beta = point[_ALPHA, lane], point[_BETA, lane]
                    own[3 * a, lane] += alpha * near[a, 6, lane] + beta * near[a, 3, lane]
                    own[3 * a + 1, lane] += alpha * near[a, 7, lane] + beta * near[a, 4, lane]
                    own[3 * a + 2, lane] += alpha * near[a, 8, lane] + beta * near[a, 5, lane]
        for lane in range(min(WIDTH, count - batch * WIDTH)):
            for a in range(10):
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
    moved, near = np.empty((10, 3, WIDTH), single), np.empty((10, 9, WIDTH), single)
    f, inverse, point = np.empty((9, WIDTH), single), np.empty((9, WIDTH), single), np.empty((6, WIDTH), single)
    blocks = np.empty((55, 9, WIDTH), single)
    for batch in range(len(nodes)):
        _displacements(u, nodes, batch, moved)
        for pair in range(55):
            _clear(blocks[pair])
        for q in range(4):
            _kinematics(gradients, weights, batch, q, moved, f, inverse, near, point)
            _weigh(shear, bulk, geometric_stiffness, near, point)
            _add_point(near, point, blocks)
        for lane in range(min(WIDTH, count - batch * WIDTH)):
            _assemble(base, width, batch * WIDTH + lane, blocks, lane, values)


@njit(inline="always")
def _weigh(shear: float, bulk: float, geometric_stiffness: float, near: np.ndarray, point: np.ndarray) -> None:
    """Fill in a point's coefficients of `_add_point`, and multiply F G by -2/3 alpha."""
    third, two, one = np.float32(1.0 / 3.0), np.float32(2.0), np.float32(1.0)
    for lane in range(WIDTH):
        point[_ALPHA, lane] = shear * point[_WEIGHT, lane] * point[_RATIO, lane] ** (-two * third)
    for lane in range(WIDTH):
        volume = point[_WEIGHT, lane] * point[_RATIO, lane]
        pressure = geometric_stiffness * bulk * (point[_RATIO, lane] - one)
        isochoric = point[_ALPHA, lane] * point[_SQUARES, lane] * third
        point[_BETA, lane] = isochoric - pressure * volume
        point[_DIAGONAL, lane] = two * third * isochoric + (bulk * point[_RATIO, lane] + pressure) * volume
    for a in range(10):
        for lane in range(WIDTH):
            factor = -two * third * point[_ALPHA, lane]
            near[a, 6, lane] *= factor
            near[a, 7, lane] *= factor
            near[a, 8, lane] *= factor


@njit(inline="always")
def _add_point(near: np.ndarray, point: np.ndarray, blocks: np.ndarray) -> None:
    """Add a point's stiffness to the blocks of all node pairs a <= b.

    With alpha = 2 C10 J^(-2/3) w, G reference and g spatial gradients and t = -2/3 alpha F G, a block is
    alpha Ga.Gb I + ga (x) (t_b + diagonal gb) + t_a (x) gb + beta gb (x) ga.
    """
    pair = 0
    for a in range(10):
        for b in range(a, 10):
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
    """Add the blocks of element e, in lane `lane`, at their places in the matrix."""
    pair = 0
    for a in range(10):
        for b in range(a, 10):
            add_entries(
                values, base[e, pair], width[e, pair], a == b,
                blocks[pair, 0, lane], blocks[pair, 1, lane], blocks[pair, 2, lane],
                blocks[pair, 3, lane], blocks[pair, 4, lane], blocks[pair, 5, lane],
                blocks[pair, 6, lane], blocks[pair, 7, lane], blocks[pair, 8, lane],
            )  # fmt: skip
            pair += 1
