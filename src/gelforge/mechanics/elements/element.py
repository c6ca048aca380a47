"""What an element is: nodes, integration points, and the kernels of its formulation; and the elements by kind of mesh."""

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module

import numpy as np

from gelforge.mechanics import elements as package
from gelforge.mechanics.elements.kernels import Kernels, batched
from gelforge.mechanics.mesh.stepped import Cells

# From nodes (n, 3) mm and cells to gradients (e, points, k, 3) of the shape functions and weights (e, points) mm^3.
Reference = Callable[[np.ndarray, Cells], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ElementSet:
    """e elements of one kind, of k nodes, undeformed, in b batches of `width`; the last batch repeats its last element.

    elements: (e, k) nodes. nodes: (b, k, width) the same by batches. gradients: (b, points, k, 3, width).
    weights: (b, points, width) mm^3.
    """

    kernels: Kernels
    elements: np.ndarray
    nodes: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray

    def internal_forces(self, u: np.ndarray, shear: float, bulk: float, forces: np.ndarray) -> float:
        """Add the nodal forces dE/du to `forces` (n, 3); returns the smallest J (not above 0: inverted, forces mean nothing).

        u: (n, 3) displacement mm. shear, bulk: moduli MPa (2 C10 and 2 / D1).
        """
        count = len(self.elements)
        return self.kernels.forces(u, self.nodes, self.gradients, self.weights, count, shear, bulk, forces)

    def tangent(
        self, u: np.ndarray, shear: float, bulk: float, geometric_stiffness: float,
        base: np.ndarray, width: np.ndarray, values: np.ndarray,
    ) -> None:  # fmt: skip
        """Add d2E/du2 to the upper-triangle `values` at the places (base, width) of `pattern.block_places`.

        geometric_stiffness: share that is kept of what the pressure adds to the stiffness, 1 in the exact tangent. Blocks
        are computed in single precision, as they are factorised.
        """
        count, single = len(self.elements), (np.float32(shear), np.float32(bulk), np.float32(geometric_stiffness))
        self.kernels.tangent(u, self.nodes, self.gradients, self.weights, count, *single, base, width, values)

    def smallest_ratios(self, u: np.ndarray) -> np.ndarray:
        """The smallest volume ratio J within each element (e,) at displacements u (n, 3) mm; below 0 it is inverted."""
        smallest = np.empty((len(self.nodes), self.kernels.width))
        self.kernels.ratios(u, self.nodes, self.gradients, self.weights, smallest)
        return smallest.ravel()[: len(self.elements)]


@dataclass(frozen=True)
class FiniteElement:
    """An element of a Neo-Hookean solid. kind: that of the meshes it serves. nodes: of one element."""

    kind: str
    nodes: int
    kernels: Kernels
    reference: Reference

    def on(self, nodes: np.ndarray, cells: Cells) -> ElementSet:
        """The elements of cells on nodes (n, 3) mm."""
        of, values = np.ascontiguousarray(cells.nodes, np.int32), self.reference(nodes, cells)
        return ElementSet(self.kernels, of, *(batched(each, self.kernels.width) for each in (of, *values)))


def isoparametric(local: np.ndarray, parts: float) -> Reference:
    """Reference of an element whose points weigh the same: each the Jacobian's determinant there over `parts`.

    local: (points, k, 3) derivatives of the shape functions by the element's own coordinates.
    """

    def reference(nodes: np.ndarray, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
        jacobian = np.einsum("qak,eai->eqik", local, nodes[cells.corners])
        return np.einsum("qak,eqki->eqai", local, np.linalg.inv(jacobian)), np.linalg.det(jacobian) / parts

    return reference


@cache
def elements() -> dict[str, FiniteElement]:
    """The kinds of elements by the kind of mesh they serve: the ELEMENT of each module of this folder that has one."""
    names = [name for _, name, _ in pkgutil.iter_modules(package.__path__, f"{package.__name__}.")]
    found = [getattr(import_module(name), "ELEMENT", None) for name in names]
    return {element.kind: element for element in found if element}
