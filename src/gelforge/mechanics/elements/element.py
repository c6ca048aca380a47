"""Finite elements by kind of mesh: nodes, integration points, and the kernels of their formulation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from gelforge.mechanics.elements.kernels import Kernels, batched, displacement, mean_dilatation
from gelforge.mechanics.mesh.stepped import Cells
from gelforge.mechanics.mesh.tetmesh import GAUSS, gradients

# Takes nodes (n, 3) mm and cells; gives shape function gradients (e, points, k, 3) and weights (e, points) mm^3.
Reference = Callable[[np.ndarray, Cells], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ElementSet:
    """e undeformed elements of k nodes, in b batches of `width`; the last batch is filled with its last element.

    elements: (e, k) nodes. nodes: (b, k, width) the same in batches. gradients: (b, points, k, 3, width).
    weights: (b, points, width) mm^3.
    """

    kernels: Kernels
    elements: np.ndarray
    nodes: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray

    def internal_forces(self, u: np.ndarray, shear: float, bulk: float, forces: np.ndarray) -> float:
        """Add the nodal forces dE/du to `forces` (n, 3); returns the smallest J (not above 0: inverted, invalid).

        u: (n, 3) displacement mm. shear, bulk: moduli MPa (2 C10 and 2 / D1).
        """
        count = len(self.elements)
        return self.kernels.forces(u, self.nodes, self.gradients, self.weights, count, shear, bulk, forces)

    def tangent(
        self, u: np.ndarray, shear: float, bulk: float, geometric_stiffness: float,
        base: np.ndarray, width: np.ndarray, values: np.ndarray,
    ) -> None:  # fmt: skip
        """Add d2E/du2 to the upper-triangle `values` at the positions (base, width) of `pattern.block_places`.

        geometric_stiffness: fraction of the pressure's geometric stiffness that is kept, 1 in the exact tangent.
        Blocks are computed in single precision, in which they are factorised, too.
        """
        count, single = len(self.elements), (np.float32(shear), np.float32(bulk), np.float32(geometric_stiffness))
        self.kernels.tangent(u, self.nodes, self.gradients, self.weights, count, *single, base, width, values)

    def smallest_ratios(self, u: np.ndarray) -> np.ndarray:
        """Smallest volume ratio J within each element (e,) at displacements u (n, 3) mm; 0 or below: inverted."""
        smallest = np.empty((len(self.nodes), self.kernels.width))
        self.kernels.ratios(u, self.nodes, self.gradients, self.weights, smallest)
        return smallest.ravel()[: len(self.elements)]


@dataclass(frozen=True)
class FiniteElement:
    """Element of a Neo-Hookean solid. kind: of its meshes. nodes: per element."""

    kind: str
    nodes: int
    kernels: Kernels
    reference: Reference

    def on(self, nodes: np.ndarray, cells: Cells) -> ElementSet:
        """The elements of `cells` on nodes (n, 3) mm."""
        of, values = np.ascontiguousarray(cells.nodes, np.int32), self.reference(nodes, cells)
        return ElementSet(self.kernels, of, *(batched(each, self.kernels.width) for each in (of, *values)))


def isoparametric(local: np.ndarray, parts: float) -> Reference:
    """Reference of an element with equal quadrature weights: each is the Jacobian's determinant divided by `parts`.

    local: (points, k, 3) derivatives of the shape functions with respect to the element's local coordinates.
    """

    def reference(nodes: np.ndarray, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
        jacobian = np.einsum("qak,eai->eqik", local, nodes[cells.corners])
        return np.einsum("qak,eqki->eqai", local, np.linalg.inv(jacobian)), np.linalg.det(jacobian) / parts

    return reference


CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float
)


def local_gradients() -> np.ndarray:
    """Derivatives (8 points, 8 nodes, 3) of a hexahedron's shape functions with respect to [-1, 1]^3."""
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


def hexahedral(nodes: np.ndarray, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (e, 8, 8, 3) and weights (e, 8) of hexahedra on nodes (n, 3) mm; ValueError if one is inverted."""
    corners = np.ascontiguousarray(cells.corners, np.int32)
    slopes, weights = _reference(np.ascontiguousarray(nodes, np.float64), corners, local_gradients())
    if weights.min() <= 0.0:
        raise ValueError(f"{int((weights.min(axis=1) <= 0).sum())} hexahedra are inverted")
    lower = slopes[cells.standing, :, :4]
    slopes[cells.standing, :, :4] = np.einsum("sba,sgbi->sgai", cells.shares, lower)
    return slopes, weights


@njit(cache=True, nogil=True)
def _reference(nodes: np.ndarray, elements: np.ndarray, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (e, 8, 8, 3) of the shape functions and weights (e, 8): the Jacobian's determinant."""
    count = len(elements)
    slopes, weights = np.empty((count, 8, 8, 3)), np.empty((count, 8))
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
                    slopes[e, g, a, i] = total / volume if volume != 0.0 else 0.0
    return slopes, weights


ELEMENTS = {element.kind: element for element in (
    # eight-node hexahedron with mean dilatation (Q1P0) for nearly incompressible solids, 2 x 2 x 2 points
    FiniteElement("hex8", 8, mean_dilatation(8, points=8, width=32), hexahedral),
    # ten-node tetrahedron like CalculiX' C3D10: pure displacement formulation, four integration points
    FiniteElement("tet10", 10, displacement(10, points=4, width=16), isoparametric(gradients(GAUSS), parts=24.0)),
)}  # fmt: skip
