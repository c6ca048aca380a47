"""Integration points of contact on the faces of hexahedra (four nodes) and second-order tetrahedra (six nodes)."""

import numpy as np


def dunavant12() -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points (12, 3) and weights (12,) exact to degree 6 (Dunavant, IJNME 21, 1985, table II)."""
    orbits = [(0.116786275726379, 0.249286745170910, 3), (0.050844906370207, 0.063089014491502, 3)]
    points, weights = [], []
    for weight, a, _ in orbits:
        b = 1 - 2 * a
        points += [(b, a, a), (a, b, a), (a, a, b)]
        weights += [weight] * 3
    a, b, weight = 0.053145049844817, 0.310352451033784, 0.082851075618374
    c = 1 - a - b
    points += [(a, b, c), (a, c, b), (b, a, c), (b, c, a), (c, a, b), (c, b, a)]
    weights += [weight] * 6
    return np.array(points), np.array(weights) / np.sum(weights)


def shapes(bary: np.ndarray) -> np.ndarray:
    """Six shape functions (corners, then midsides 01, 12, 20) at barycentric points (q, 3): (q, 6)."""
    a, b, c = bary.T
    return np.column_stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a])


def slopes(bary: np.ndarray) -> np.ndarray:
    """Derivatives of `shapes` with respect to the second and third barycentric coordinate: (q, 6, 2)."""
    a, b, c = bary.T
    zero = np.zeros_like(a)
    db = np.column_stack([1 - 4 * a, 4 * b - 1, zero, 4 * (a - b), 4 * c, -4 * c])
    dc = np.column_stack([1 - 4 * a, zero, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c)])
    return np.stack([db, dc], axis=-1)


def bilinear(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Four shape functions (q, 4) at local coordinates (q, 2) on [-1, 1]^2, and their derivatives (q, 4, 2)."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    along = 1 + place[:, None, :] * signs
    return along.prod(axis=2) / 4, signs * along[..., ::-1] / 4


def gauss_points(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Local coordinates (order^2, 2) and weights (order^2,) of the Gauss rule on [-1, 1]^2."""
    x, w = np.polynomial.legendre.leggauss(order)
    a, b = np.meshgrid(x, x, indexing="ij")
    return np.stack([a.ravel(), b.ravel()], axis=1), np.outer(w, w).ravel()


def face_rule(nodes: int, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shape functions (q, k), derivatives (q, k, 2) and weights (q,) at the integration points of a face of k nodes.

    A face of four nodes has order x order Gauss points; a face of six has the twelve points of `dunavant12`.
    """
    if nodes == 6:
        bary, weight = dunavant12()
        return shapes(bary), slopes(bary), weight / 2.0
    local, weight = gauss_points(order)
    return *bilinear(local), weight
