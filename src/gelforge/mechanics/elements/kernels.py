"""Kernels of elements of a Neo-Hookean solid, in two formulations: nodal forces, tangents and volume ratios.

Energy per undeformed volume: W = C10 (J^(-2/3) tr(F^T F) - 3) + (J - 1)^2 / D1. `displacement` integrates all of it
at the integration points. `mean_dilatation` evaluates the volumetric part at the element's mean volume ratio (Q1P0:
Simo, Taylor, Pister 1985, Comput. Methods Appl. Mech. Eng. 51, 177-208), so that elements do not lock near nu = 1/2:

    E = sum_g w_g C10 (J_g^(-2/3) tr(F_g^T F_g) - 3) + V (theta - 1)^2 / D1,  theta = (1/V) sum_g w_g J_g.

Forces and tangents are exact derivatives of one energy, so tangents are symmetric.

Kernels work on `width` elements at once, along the last axis of every array (SIMD). The compiler vectorises only if
it can see that arrays do not overlap, as for arrays of constant shape made in the kernel: so each integration point's
data are copied there first.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from gelforge.mechanics.linear.pattern import add_entries

# Options for numba: sums may be reordered, but nan and infinity are preserved, because solvers test for them.
FAST: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


def batched(values: np.ndarray, width: int) -> np.ndarray:
    """Values (n, ...) of n > 0 elements as batches (b, ..., width); the last batch is filled with its last element.

    Kernels compute whole batches, but assemble the first n elements only.
    """
    which = np.minimum(np.arange(-(-len(values) // width) * width), len(values) - 1)
    return np.ascontiguousarray(np.moveaxis(values[which].reshape(-1, width, *values.shape[1:]), 1, -1))


# Rows of `near`, by node: reference gradient and spatial gradient of its shape function, and F times the reference
# one. Rows of `point`: quantities of an integration point, and sums over all points of an element.
_WEIGHT, _RATIO, _SQUARES, _VOLUME, _SUM_VOLUME, _SUM_DEFORMED, _PRESSURE, _ALPHA, _BETA, _DIAGONAL = range(10)
_ROWS = 10


@dataclass(frozen=True)
class Kernels:
    """Kernels of elements of n nodes and g points, in b batches of `width`; the first `count` elements count.

    All take u (nodes, 3) mm, nodes (b, n, width), gradients (b, g, n, 3, width), weights (b, g, width); then
    forces: count, shear, bulk MPa, forces (nodes, 3) to add to; returns the smallest J.
    tangent: count, shear, bulk, geometric_stiffness in single precision, base and width of `pattern.block_places`,
    and the matrix values to add to.
    ratios: array (b, width) to fill with the smallest J of each element.
    """

    width: int
    forces: Callable[..., float]
    tangent: Callable[..., None]
    ratios: Callable[..., None]


@njit(inline="always")
def _clear(rows: np.ndarray) -> None:
    """Set rows (k, width) to zero; written as `rows[:] = 0`, the compiler would lose track of their shape."""
    for i in range(rows.shape[0]):
        for lane in range(rows.shape[1]):
            rows[i, lane] = 0.0


@njit(inline="always")
def _displacements(u: np.ndarray, nodes: np.ndarray, batch: int, moved: np.ndarray) -> None:
    """Copy the displacements of a batch's nodes to `moved` (n, 3, width)."""
    for a in range(moved.shape[0]):
        for lane in range(moved.shape[2]):
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
    """Fill near (n, 9, width) and point (rows, width) with kinematics of point g; f, inverse (9, width): scratch."""
    for a in range(near.shape[0]):
        for i in range(3):
            for lane in range(near.shape[2]):
                near[a, i, lane] = gradients[batch, g, a, i, lane]
    for lane in range(near.shape[2]):
        point[_WEIGHT, lane] = weights[batch, g, lane]
    _deform(moved, near, f)
    _invert(f, inverse, point)
    _push(f, inverse, near)


@njit(inline="always")
def _deform(moved: np.ndarray, near: np.ndarray, f: np.ndarray) -> None:
    """Fill f (9, width) with the deformation gradient at a point, row-major."""
    for i in range(9):
        for lane in range(near.shape[2]):
            f[i, lane] = 1.0 if i % 4 == 0 else 0.0
    for a in range(near.shape[0]):
        for lane in range(near.shape[2]):
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
    """Fill inverse (9, width) with F^-T, and in point: J, the sum of squares of F, and the deformed volume."""
    for lane in range(f.shape[1]):
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
    """Fill near (n, 9, width) with the spatial gradients and with F times the reference gradients."""
    for a in range(near.shape[0]):
        for lane in range(near.shape[2]):
            x, y, z = near[a, 0, lane], near[a, 1, lane], near[a, 2, lane]
            near[a, 3, lane] = inverse[0, lane] * x + inverse[1, lane] * y + inverse[2, lane] * z
            near[a, 4, lane] = inverse[3, lane] * x + inverse[4, lane] * y + inverse[5, lane] * z
            near[a, 5, lane] = inverse[6, lane] * x + inverse[7, lane] * y + inverse[8, lane] * z
            near[a, 6, lane] = f[0, lane] * x + f[1, lane] * y + f[2, lane] * z
            near[a, 7, lane] = f[3, lane] * x + f[4, lane] * y + f[5, lane] * z
            near[a, 8, lane] = f[6, lane] * x + f[7, lane] * y + f[8, lane] * z


@njit(inline="always")
def _add_to_element(near: np.ndarray, point: np.ndarray, mean: np.ndarray) -> None:
    """Add a point's part of its elements' volumes, and of the deformed volume's derivative `mean` (3 n, width)."""
    for lane in range(near.shape[2]):
        point[_SUM_VOLUME, lane] += point[_WEIGHT, lane]
        point[_SUM_DEFORMED, lane] += point[_VOLUME, lane]
    for a in range(near.shape[0]):
        for lane in range(near.shape[2]):
            volume = point[_VOLUME, lane]
            mean[3 * a, lane] += volume * near[a, 3, lane]
            mean[3 * a + 1, lane] += volume * near[a, 4, lane]
            mean[3 * a + 2, lane] += volume * near[a, 5, lane]


@njit(inline="always")
def _begin_blocks(n: int, point: np.ndarray, mean: np.ndarray, blocks: np.ndarray) -> None:
    """Set blocks (pairs, 9, width) to the rank-one term of the mean dilatation, K / V dV (x) dV."""
    pair = 0
    for a in range(n):
        for b in range(a, n):
            for lane in range(blocks.shape[2]):
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
def _scale(near: np.ndarray, point: np.ndarray) -> None:
    """Multiply F times a node's gradient by -2/3 alpha."""
    third, two = np.float32(1.0 / 3.0), np.float32(2.0)
    for a in range(near.shape[0]):
        for lane in range(near.shape[2]):
            factor = -two * third * point[_ALPHA, lane]
            near[a, 6, lane] *= factor
            near[a, 7, lane] *= factor
            near[a, 8, lane] *= factor


@njit(inline="always")
def _weigh_mean(shear: float, near: np.ndarray, point: np.ndarray) -> None:
    """Fill in the coefficients of `_add_point` at a point; the pressure is that of the element's mean dilatation."""
    third, two = np.float32(1.0 / 3.0), np.float32(2.0)
    for lane in range(near.shape[2]):
        point[_ALPHA, lane] = shear * point[_WEIGHT, lane] * point[_RATIO, lane] ** (-two * third)
    for lane in range(near.shape[2]):
        volumetric = point[_PRESSURE, lane] * point[_VOLUME, lane]
        isochoric = point[_ALPHA, lane] * point[_SQUARES, lane] * third
        point[_BETA, lane] = isochoric - volumetric
        point[_DIAGONAL, lane] = two * third * isochoric + volumetric
    _scale(near, point)


@njit(inline="always")
def _weigh_point(shear: float, bulk: float, geometric_stiffness: float, near: np.ndarray, point: np.ndarray) -> None:
    """Fill in the coefficients of `_add_point` at a point; the pressure is that of the point's own dilatation."""
    third, two, one = np.float32(1.0 / 3.0), np.float32(2.0), np.float32(1.0)
    for lane in range(near.shape[2]):
        point[_ALPHA, lane] = shear * point[_WEIGHT, lane] * point[_RATIO, lane] ** (-two * third)
    for lane in range(near.shape[2]):
        volume = point[_VOLUME, lane]
        pressure = geometric_stiffness * bulk * (point[_RATIO, lane] - one)
        isochoric = point[_ALPHA, lane] * point[_SQUARES, lane] * third
        point[_BETA, lane] = isochoric - pressure * volume
        point[_DIAGONAL, lane] = two * third * isochoric + (bulk * point[_RATIO, lane] + pressure) * volume
    _scale(near, point)


@njit(inline="always")
def _add_point(near: np.ndarray, point: np.ndarray, blocks: np.ndarray) -> None:
    """Add a point's isochoric and geometric stiffness to the blocks of all node pairs a <= b.

    With alpha = 2 C10 J^(-2/3) w, reference gradients G, spatial gradients g and t = -2/3 alpha F G, a block is
    alpha Ga.Gb I + ga (x) (t_b + diagonal gb) + t_a (x) gb + beta gb (x) ga.
    """
    pair = 0
    for a in range(near.shape[0]):
        for b in range(a, near.shape[0]):
            for lane in range(near.shape[2]):
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
def _assemble(
    n: int, base: np.ndarray, width: np.ndarray, e: int, blocks: np.ndarray, lane: int, values: np.ndarray
) -> None:
    """Add the blocks of element e, held in SIMD lane `lane`, to the matrix values."""
    pair = 0
    for a in range(n):
        for b in range(a, n):
            add_entries(
                values, base[e, pair], width[e, pair], a == b,
                blocks[pair, 0, lane], blocks[pair, 1, lane], blocks[pair, 2, lane],
                blocks[pair, 3, lane], blocks[pair, 4, lane], blocks[pair, 5, lane],
                blocks[pair, 6, lane], blocks[pair, 7, lane], blocks[pair, 8, lane],
            )  # fmt: skip
            pair += 1


def _ratios(n: int, points: int, width: int) -> Callable[..., None]:
    @njit(**FAST)
    def ratios(
        u: np.ndarray, nodes: np.ndarray, gradients: np.ndarray, weights: np.ndarray, smallest: np.ndarray
    ) -> None:
        moved, near = np.empty((n, 3, width)), np.empty((n, 9, width))
        f, inverse, point = np.empty((9, width)), np.empty((9, width)), np.empty((_ROWS, width))
        for batch in range(len(nodes)):
            _displacements(u, nodes, batch, moved)
            smallest[batch] = 1e30
            for g in range(points):
                _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
                for lane in range(width):
                    smallest[batch, lane] = min(smallest[batch, lane], point[_RATIO, lane])

    return ratios


def mean_dilatation(n: int, points: int, width: int) -> Kernels:
    """Kernels of elements of n nodes with mean dilatation (constant pressure in each)."""
    pairs = n * (n + 1) // 2

    @njit(**FAST)
    def forces_of(
        u: np.ndarray, nodes: np.ndarray, gradients: np.ndarray, weights: np.ndarray,
        count: int, shear: float, bulk: float, forces: np.ndarray,
    ) -> float:  # fmt: skip
        moved, near = np.empty((n, 3, width)), np.empty((n, 9, width))
        f, inverse, point = np.empty((9, width)), np.empty((9, width)), np.empty((_ROWS, width))
        own, mean = np.empty((3 * n, width)), np.empty((3 * n, width))
        smallest = 1e30
        for batch in range(len(nodes)):
            _displacements(u, nodes, batch, moved)
            _clear(own)
            _clear(mean)
            _clear(point)
            for g in range(points):
                _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
                for lane in range(width):
                    smallest = min(smallest, point[_RATIO, lane])
                if smallest <= 0.0:
                    return smallest
                _add_to_element(near, point, mean)
                for lane in range(width):
                    point[_ALPHA, lane] = shear * point[_WEIGHT, lane] * point[_RATIO, lane] ** (-2.0 / 3.0)
                for a in range(n):
                    for lane in range(width):
                        alpha, third = point[_ALPHA, lane], point[_SQUARES, lane] / 3.0
                        own[3 * a, lane] += alpha * (near[a, 6, lane] - third * near[a, 3, lane])
                        own[3 * a + 1, lane] += alpha * (near[a, 7, lane] - third * near[a, 4, lane])
                        own[3 * a + 2, lane] += alpha * (near[a, 8, lane] - third * near[a, 5, lane])
            for lane in range(width):
                point[_PRESSURE, lane] = bulk * (point[_SUM_DEFORMED, lane] / point[_SUM_VOLUME, lane] - 1.0)
            for a in range(n):
                for i in range(3):
                    for lane in range(width):
                        own[3 * a + i, lane] += point[_PRESSURE, lane] * mean[3 * a + i, lane]
            for lane in range(min(width, count - batch * width)):
                for a in range(n):
                    for i in range(3):
                        forces[nodes[batch, a, lane], i] += own[3 * a + i, lane]
        return smallest

    @njit(**FAST)
    def tangent(
        u: np.ndarray, nodes: np.ndarray, gradients: np.ndarray, weights: np.ndarray,
        count: int, shear: float, bulk: float, geometric_stiffness: float,
        base: np.ndarray, row: np.ndarray, values: np.ndarray,
    ) -> None:  # fmt: skip
        single = np.float32
        moved, near = np.empty((n, 3, width), single), np.empty((n, 9, width), single)
        f, inverse, point = (
            np.empty((9, width), single),
            np.empty((9, width), single),
            np.empty((_ROWS, width), single),
        )
        mean, blocks = np.empty((3 * n, width), single), np.empty((pairs, 9, width), single)
        for batch in range(len(nodes)):
            _displacements(u, nodes, batch, moved)
            _clear(mean)
            _clear(point)
            for g in range(points):
                _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
                _add_to_element(near, point, mean)
            for lane in range(width):
                strain = (point[_SUM_DEFORMED, lane] - point[_SUM_VOLUME, lane]) / point[_SUM_VOLUME, lane]
                point[_PRESSURE, lane] = geometric_stiffness * bulk * strain
                point[_ALPHA, lane] = bulk / point[_SUM_VOLUME, lane]
            _begin_blocks(n, point, mean, blocks)
            for g in range(points):
                _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
                _weigh_mean(shear, near, point)
                _add_point(near, point, blocks)
            for lane in range(min(width, count - batch * width)):
                _assemble(n, base, row, batch * width + lane, blocks, lane, values)

    return Kernels(width, forces_of, tangent, _ratios(n, points, width))


def displacement(n: int, points: int, width: int) -> Kernels:
    """Kernels of elements of n nodes that integrate the whole energy at their points, as CalculiX' C3D10 does."""
    pairs = n * (n + 1) // 2

    @njit(**FAST)
    def forces_of(
        u: np.ndarray, nodes: np.ndarray, gradients: np.ndarray, weights: np.ndarray,
        count: int, shear: float, bulk: float, forces: np.ndarray,
    ) -> float:  # fmt: skip
        moved, near = np.empty((n, 3, width)), np.empty((n, 9, width))
        f, inverse, point = np.empty((9, width)), np.empty((9, width)), np.empty((_ROWS, width))
        own = np.empty((3 * n, width))
        smallest = 1e30
        for batch in range(len(nodes)):
            _displacements(u, nodes, batch, moved)
            _clear(own)
            for g in range(points):
                _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
                for lane in range(width):
                    smallest = min(smallest, point[_RATIO, lane])
                if smallest <= 0.0:
                    return smallest
                for lane in range(width):
                    weight, ratio = point[_WEIGHT, lane], point[_RATIO, lane]
                    alpha = shear * weight * ratio ** (-2.0 / 3.0)
                    point[_ALPHA, lane] = alpha
                    point[_BETA, lane] = bulk * (ratio - 1.0) * ratio * weight - alpha * point[_SQUARES, lane] / 3.0
                for a in range(n):
                    for lane in range(width):
                        alpha, beta = point[_ALPHA, lane], point[_BETA, lane]
                        own[3 * a, lane] += alpha * near[a, 6, lane] + beta * near[a, 3, lane]
                        own[3 * a + 1, lane] += alpha * near[a, 7, lane] + beta * near[a, 4, lane]
                        own[3 * a + 2, lane] += alpha * near[a, 8, lane] + beta * near[a, 5, lane]
            for lane in range(min(width, count - batch * width)):
                for a in range(n):
                    for i in range(3):
                        forces[nodes[batch, a, lane], i] += own[3 * a + i, lane]
        return smallest

    @njit(**FAST)
    def tangent(
        u: np.ndarray, nodes: np.ndarray, gradients: np.ndarray, weights: np.ndarray,
        count: int, shear: float, bulk: float, geometric_stiffness: float,
        base: np.ndarray, row: np.ndarray, values: np.ndarray,
    ) -> None:  # fmt: skip
        single = np.float32
        moved, near = np.empty((n, 3, width), single), np.empty((n, 9, width), single)
        f, inverse, point = (
            np.empty((9, width), single),
            np.empty((9, width), single),
            np.empty((_ROWS, width), single),
        )
        blocks = np.empty((pairs, 9, width), single)
        for batch in range(len(nodes)):
            _displacements(u, nodes, batch, moved)
            for pair in range(pairs):
                _clear(blocks[pair])
            for g in range(points):
                _kinematics(gradients, weights, batch, g, moved, f, inverse, near, point)
                _weigh_point(shear, bulk, geometric_stiffness, near, point)
                _add_point(near, point, blocks)
            for lane in range(min(width, count - batch * width)):
                _assemble(n, base, row, batch * width + lane, blocks, lane, values)

    return Kernels(width, forces_of, tangent, _ratios(n, points, width))
