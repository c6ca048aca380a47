"""Hexahedron of twelve nodes, bilinear across and of second order through the height, in two halves of mean dilatation each.

A thin gel between two faces that it sticks to flows sideways in a parabola over its height: this element holds that flow
exactly, where eight-node hexahedra are too stiff by one over the square of their layers. Each half, from the middle nodes
down or up, has a volume ratio of its own and is integrated at 2 x 2 x 2 points.
"""

import numpy as np

from gelforge.mechanics.elements.element import FiniteElement
from gelforge.mechanics.elements.kernels import mean_dilatation
from gelforge.mechanics.mesh.stepped import Cells

SIDES = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)


def local_gradients(upper: bool) -> np.ndarray:
    """Derivatives (8 points, 12 nodes, 3) of the shape functions by the coordinates on [-1, 1]^3, within one half.

    Nodes: the four of the lower face, counter-clockwise, then those of the middle and of the upper face.
    """
    heights = GAUSS / 2 + (0.5 if upper else -0.5)
    z, y, x = (each.ravel() for each in np.meshgrid(heights, GAUSS, GAUSS, indexing="ij"))
    along_x, along_y = 1 + x[:, None] * SIDES[:, 0], 1 + y[:, None] * SIDES[:, 1]
    flat = np.stack([SIDES[:, 0] * along_y, SIDES[:, 1] * along_x, along_x * along_y], axis=-1) / 4
    shape = np.stack([z * (z - 1) / 2, 1 - z * z, z * (z + 1) / 2], axis=1)
    slope = np.stack([z - 0.5, -2 * z, z + 0.5], axis=1)
    through = np.stack([shape, shape, slope], axis=-1)
    return (through[:, :, None] * flat[:, None]).reshape(8, 12, 3)


def reference(nodes: np.ndarray, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (e, 8, 12, 3) and weights (e, 8) of halves on nodes (n, 3) mm; an inverted one raises ValueError."""
    local = np.stack([local_gradients(False), local_gradients(True)])[cells.upper.astype(int)]
    jacobian = np.swapaxes(local, 2, 3) @ nodes[cells.corners][:, None]
    weights = np.linalg.det(jacobian) / 2.0
    if weights.min() <= 0.0:
        raise ValueError(f"{int((weights.min(axis=1) <= 0).sum())} hexahedra are inverted")
    gradients = local @ np.swapaxes(np.linalg.inv(jacobian), 2, 3)
    lower = gradients[cells.standing, :, :4]
    gradients[cells.standing, :, :4] = np.einsum("sba,sgbi->sgai", cells.shares, lower)
    return gradients, weights


ELEMENT = FiniteElement("hex12", 12, mean_dilatation(12, points=8, width=32), reference)
