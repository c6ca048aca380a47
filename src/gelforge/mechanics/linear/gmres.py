"""Flexible GMRES: linear solves with an outdated or approximate factorisation as preconditioner."""

import math
from collections.abc import Callable

import numpy as np


def inner(a: np.ndarray, b: np.ndarray) -> float:
    """Inner product of two vectors (n,), on one thread.

    BLAS uses all cores for vectors of more than 10 000 numbers. On a busy machine without OMP_NUM_THREADS, waiting
    for each other took four fifths of a solve.
    """
    return float(np.einsum("n,n->", a, b))


def length_of(a: np.ndarray) -> float:
    """Euclidean length of a vector (n,), on one thread."""
    return math.sqrt(inner(a, a))


def gmres(
    apply: Callable[[np.ndarray], np.ndarray],
    precondition: Callable[[np.ndarray], np.ndarray],
    b: np.ndarray,
    tolerance: float,
    limit: int,
) -> np.ndarray | None:
    """Flexible GMRES (Saad 1993, SIAM J. Sci. Comput. 14, 461-469) without restart, from zero.

    apply: product of the matrix A with a vector, (n,) -> (n,). precondition: approximate product with its inverse,
    which may differ between calls. Returns x (n,) with |b - A x| <= tolerance |b|, or None as soon as the rate of
    convergence shows that `limit` products will not suffice.
    """
    size = length_of(b)
    if size == 0.0:
        return np.zeros_like(b)
    basis, ways = [b / size], []
    h = np.zeros((limit + 1, limit))
    rotation = np.zeros((limit, 2))
    rest = np.zeros(limit + 1)
    rest[0] = size
    for k in range(limit):
        ways.append(precondition(basis[k]))
        w = apply(ways[k])
        for i in range(k + 1):
            h[i, k] = inner(w, basis[i])
            w -= h[i, k] * basis[i]
        h[k + 1, k] = length_of(w)
        basis.append(w / max(h[k + 1, k], 1e-300))
        for i in range(k):
            c, s = rotation[i]
            h[i, k], h[i + 1, k] = c * h[i, k] + s * h[i + 1, k], c * h[i + 1, k] - s * h[i, k]
        length = np.hypot(h[k, k], h[k + 1, k])
        if length == 0.0:
            return None  # breakdown: the matrix maps this direction to zero
        rotation[k] = h[k, k] / length, h[k + 1, k] / length
        h[k, k], h[k + 1, k] = length, 0.0
        rest[k], rest[k + 1] = rotation[k, 0] * rest[k], -rotation[k, 1] * rest[k]
        if abs(rest[k + 1]) <= tolerance * size:
            y = np.linalg.solve(np.triu(h[: k + 1, : k + 1]), rest[: k + 1])
            return np.einsum("kn,k->n", np.array(ways), y)
        if k >= 2 and (abs(rest[k + 1]) / size) ** (limit / (k + 1)) > tolerance:
            return None
    return None
