"""A mesh of ten-node tetrahedra as one elastic body: its forces, its tangent, and Newton steps with a kept factorisation."""

import copy

import numpy as np
from numba import njit

from gelforge.mechanics.elements.element import ElementSet, elements
from gelforge.mechanics.linear.factorisation import symmetric_solver
from gelforge.mechanics.linear.gmres import gmres
from gelforge.mechanics.linear.pattern import add_block, block_places, build_pattern, symmetric_product
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.stepped import Cells

# Matrix products that a step by an old factorisation may take: a new one costs as much as about twenty.
STALE = 25


class TetSolid:
    """Geometry, matrix pattern and factorisation of one mesh; face penalties may be added to the matrix.

    The factorisation that `step` may use again is of whatever was solved last, on this mesh or one of `on`: who starts a
    scene asks for one of its own (left = 0), or its result would depend on what was solved before.
    """

    def __init__(self, mesh: GelMesh):
        self.elements = _elements_of(mesh)
        self.pattern = build_pattern(mesh.elements, len(mesh.nodes), mesh.base)
        self.places = block_places(self.pattern, mesh.elements)
        self.face_places = block_places(self.pattern, mesh.faces)
        self.solver = symmetric_solver(self.pattern.indptr, self.pattern.indices)
        self.free = self.pattern.first_row >= 0
        self.values = np.zeros(len(self.pattern.indices), np.float32)

    def on(self, mesh: GelMesh) -> "TetSolid":
        """A body of the same elements whose nodes lie elsewhere; it shares this one's matrix and solver, so one works at a time."""
        other = copy.copy(self)
        other.elements = _elements_of(mesh)
        return other

    def forces(self, u: np.ndarray, shear: float, bulk: float) -> tuple[np.ndarray, float]:
        """Internal nodal forces (n, 3) N of displacement u (n, 3), and the smallest J (<= 0: inverted)."""
        forces = np.zeros_like(u)
        smallest = self.elements.internal_forces(u, shear, bulk, forces)
        return forces, smallest

    def linearise(
        self,
        u: np.ndarray,
        shear: float,
        bulk: float,
        faces: np.ndarray,
        stiffness: np.ndarray,
        geometric_stiffness: float = 1.0,
        regularisation: float = 0.0,
    ) -> None:
        """Take the tangent at u with blocks `stiffness` (f, 21, 3, 3) N/mm on node pairs of `faces` (f,).

        geometric_stiffness: share that is kept of what the bulk pressure adds to the stiffness (0: Gauss and
        Newton's approximation of the volumetric energy). Far from equilibrium pressures are wild and the
        full tangent is indefinite. regularisation: add so much of the stiffness at rest, which makes any tangent
        definite; one near a crease stays indefinite without.
        """
        self.values[:] = 0.0
        self.elements.tangent(u, shear, bulk, geometric_stiffness, *self.places, self.values)
        if regularisation:
            rest, moduli = np.zeros_like(u), (regularisation * shear, regularisation * bulk)
            self.elements.tangent(rest, *moduli, 1.0, *self.places, self.values)
        _add_faces(
            self.face_places[0][faces], self.face_places[1][faces], np.ascontiguousarray(stiffness), self.values
        )

    def step(self, residual: np.ndarray, left: float = 0.0) -> np.ndarray:
        """Displacement (n, 3) mm that the tangent of `linearise` gives for a residual (n, 3) N.

        left: share of the residual that may be left; above 0 the factorisation before serves, as long as it is quick with
        this tangent. Raises SolveFailed where the tangent cannot be factorised.
        """
        right = residual[self.free].ravel()
        found = gmres(self._apply, self.solver.solve, right, left, STALE) if left else None
        if found is None:
            self.solver.factorise(self.values)
            found = self.solver.solve(right)
        answer = np.zeros_like(residual)
        answer[self.free] = found.reshape(-1, 3)
        return answer

    def _apply(self, x: np.ndarray) -> np.ndarray:
        return symmetric_product(self.pattern, self.values, x)


def _elements_of(mesh: GelMesh) -> ElementSet:
    return elements()[mesh.kind].on(mesh.nodes, Cells.plain(mesh.elements))


@njit(cache=True, nogil=True)
def _add_faces(base: np.ndarray, width: np.ndarray, stiffness: np.ndarray, values: np.ndarray) -> None:
    for e in range(base.shape[0]):
        pair = 0
        for a in range(6):
            for b in range(a, 6):
                add_block(values, base[e, pair], width[e, pair], stiffness[e, pair], a == b)
                pair += 1
