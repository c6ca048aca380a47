"""Eight-node hexahedron with mean dilatation (Q1P0), for a nearly incompressible solid: 2 x 2 x 2 points."""

import numpy as np
from numba import njit

from gelforge.mechanics.elements.element import FiniteElement
from gelforge.mechanics.elements.kernels import mean_dilatation
from gelforge.mechanics.mesh.stepped import Cells

CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float
)


def local_gradients() -> np.ndarray:
    """Derivatives (8 points, 8 nodes, 3) of the shape functions by the coordinates on [-1, 1]^3."""
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
    return local


def reference(nodes: np.ndarray, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (e, 8, 8, 3) and weights (e, 8) of hexahedra on nodes (n, 3) mm; an inverted one raises ValueError."""
    corners = np.ascontiguousarray(cells.corners, np.int32)
    gradients, weights = _reference(np.ascontiguousarray(nodes, np.float64), corners, local_gradients())
    if weights.min() <= 0.0:
        raise ValueError(f"{int((weights.min(axis=1) <= 0).sum())} hexahedra are inverted")
    lower = gradients[cells.standing, :, :4]
    gradients[cells.standing, :, :4] = np.einsum("sba,sgbi->sgai", cells.shares, lower)
    return gradients, weights


@njit(cache=True, nogil=True)
def _reference(nodes: np.ndarray, elements: np.ndarray, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


ELEMENT = FiniteElement("hex8", 8, mean_dilatation(8, points=8, width=32), reference)
