"""Ten-node tetrahedra of a Neo-Hookean solid, as CalculiX' C3D10: displacement only, four points.

Energy per volume W = C10 (J^(-2/3) tr(F^T F) - 3) + (J - 1)^2 / D1. Residual and tangent are its
exact derivatives.
"""

import numpy as np
from numba import njit

from gelforge.mechanics.linear import symmetric_solver
from gelforge.mechanics.mesh import GelMesh
from gelforge.mechanics.pattern import add_block, block_places, build_pattern
from gelforge.mechanics.tet.tetmesh import GAUSS
from gelforge.mechanics.tet.tetmesh import gradients as local_gradients


class TetSolid:
    """Geometry, matrix pattern and factorisation of one mesh; face springs may be added to the matrix."""

    def __init__(self, mesh: GelMesh):
        local = local_gradients(GAUSS)
        jacobian = np.einsum("qak,eai->eqik", local, mesh.nodes[mesh.elements])
        self.weights = np.linalg.det(jacobian) / 24.0
        self.gradients = np.ascontiguousarray(np.einsum("qak,eqki->eqai", local, np.linalg.inv(jacobian)))
        self.elements = np.ascontiguousarray(mesh.elements, np.int32)
        self.faces = np.ascontiguousarray(mesh.faces, np.int32)
        self.pattern = build_pattern(self.elements, len(mesh.nodes), mesh.base)
        self.places = block_places(self.pattern, self.elements)
        self.face_places = block_places(self.pattern, self.faces)
        self.solver = symmetric_solver(self.pattern.indptr, self.pattern.indices)
        self.free = self.pattern.first_row >= 0

    def forces(self, u: np.ndarray, shear: float, bulk: float) -> tuple[np.ndarray, float]:
        """Internal nodal forces (n, 3) N of displacement u (n, 3), and the smallest J (<= 0: inverted)."""
        forces = np.zeros_like(u)
        smallest = _forces(u, self.elements, self.gradients, self.weights, shear, bulk, forces)
        return forces, smallest

    def factorise(
        self,
        u: np.ndarray,
        shear: float,
        bulk: float,
        faces: np.ndarray,
        stiffness: np.ndarray,
        gentle: float = 0.0,
        firm: float = 0.0,
    ) -> None:
        """Factorise the tangent at u with blocks `stiffness` (f, 21, 3, 3) N/mm on node pairs of `faces` (f,).

        gentle: leave out this share of what the bulk pressure adds to the stiffness (all of it: Gauss and
        Newton's approximation of the volumetric energy). Far from equilibrium pressures are wild and the
        full tangent is indefinite. firm: add so much of the stiffness at rest, which makes any tangent definite;
        one near a crease stays indefinite without.
        """
        values = np.zeros(len(self.pattern.indices))
        pressed = 1.0 - gentle
        _tangent(u, self.elements, self.gradients, self.weights, shear, bulk, pressed, *self.places, values)
        if firm:
            rest = np.zeros_like(u)
            _tangent(rest, self.elements, self.gradients, firm * self.weights, shear, bulk, 1.0, *self.places, values)
        _add_faces(self.face_places[0][faces], self.face_places[1][faces], np.ascontiguousarray(stiffness), values)
        self.solver.factorise(values)

    def step(self, residual: np.ndarray) -> np.ndarray:
        """Displacement (n, 3) that the factorised tangent gives for a residual (n, 3)."""
        answer = np.zeros_like(residual)
        answer[self.free] = self.solver.solve(residual[self.free].ravel()).reshape(-1, 3)
        return answer


@njit(inline="always")
def _kinematics(
    u: np.ndarray,
    elements: np.ndarray,
    gradients: np.ndarray,
    e: int,
    q: int,
    f: np.ndarray,
    g: np.ndarray,
    h: np.ndarray,
) -> tuple[float, float]:
    for i in range(3):
        for k in range(3):
            f[i, k] = 1.0 if i == k else 0.0
    for a in range(10):
        node = elements[e, a]
        for i in range(3):
            for k in range(3):
                f[i, k] += u[node, i] * gradients[e, q, a, k]
    j = (
        f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
        - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
        + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
    )
    inv = np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            a1, a2, b1, b2 = (k + 1) % 3, (k + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inv[i, k] = (f[a1, b1] * f[a2, b2] - f[a1, b2] * f[a2, b1]) / j
    trace = 0.0
    for i in range(3):
        for k in range(3):
            trace += f[i, k] * f[i, k]
    for a in range(10):
        for i in range(3):
            # g: gradient in space, h: F times the gradient at rest
            g[a, i] = (
                gradients[e, q, a, 0] * inv[0, i]
                + gradients[e, q, a, 1] * inv[1, i]
                + gradients[e, q, a, 2] * inv[2, i]
            )
            h[a, i] = (
                f[i, 0] * gradients[e, q, a, 0] + f[i, 1] * gradients[e, q, a, 1] + f[i, 2] * gradients[e, q, a, 2]
            )
    return j, trace


@njit(cache=True, nogil=True, error_model="numpy")
def _forces(
    u: np.ndarray,
    elements: np.ndarray,
    gradients: np.ndarray,
    weights: np.ndarray,
    shear: float,
    bulk: float,
    forces: np.ndarray,
) -> float:
    f, g, h = np.empty((3, 3)), np.empty((10, 3)), np.empty((10, 3))
    smallest = 1e30
    for e in range(elements.shape[0]):
        for q in range(4):
            j, trace = _kinematics(u, elements, gradients, e, q, f, g, h)
            smallest = min(smallest, j)
            if j <= 0.0:
                return j
            c = shear * j ** (-2.0 / 3.0) * weights[e, q]
            p = bulk * (j - 1.0) * j * weights[e, q] - c * trace / 3.0
            for a in range(10):
                node = elements[e, a]
                for i in range(3):
                    forces[node, i] += c * h[a, i] + p * g[a, i]
    return smallest


@njit(cache=True, nogil=True, error_model="numpy")
def _tangent(
    u: np.ndarray,
    elements: np.ndarray,
    gradients: np.ndarray,
    weights: np.ndarray,
    shear: float,
    bulk: float,
    pressed: float,
    base: np.ndarray,
    width: np.ndarray,
    values: np.ndarray,
) -> None:
    f, g, h = np.empty((3, 3)), np.empty((10, 3)), np.empty((10, 3))
    block = np.empty((55, 3, 3))
    for e in range(elements.shape[0]):
        block[:] = 0.0
        for q in range(4):
            j, trace = _kinematics(u, elements, gradients, e, q, f, g, h)
            w = weights[e, q]
            c = shear * j ** (-2.0 / 3.0) * w
            across = -2.0 / 3.0 * c
            outer = 2.0 / 9.0 * c * trace + bulk * (j + pressed * (j - 1.0)) * j * w
            turned = c * trace / 3.0 - pressed * bulk * (j - 1.0) * j * w
            pair = 0
            for a in range(10):
                for b in range(a, 10):
                    dot = 0.0
                    for k in range(3):
                        dot += gradients[e, q, a, k] * gradients[e, q, b, k]
                    for i in range(3):
                        for k in range(3):
                            block[pair, i, k] += (
                                across * (h[a, i] * g[b, k] + g[a, i] * h[b, k])
                                + outer * g[a, i] * g[b, k]
                                + turned * g[a, k] * g[b, i]
                            )
                        block[pair, i, i] += c * dot
                    pair += 1
        pair = 0
        for a in range(10):
            for b in range(a, 10):
                add_block(values, base[e, pair], width[e, pair], block[pair], a == b)
                pair += 1


@njit(cache=True, nogil=True)
def _add_faces(base: np.ndarray, width: np.ndarray, stiffness: np.ndarray, values: np.ndarray) -> None:
    for e in range(base.shape[0]):
        pair = 0
        for a in range(6):
            for b in range(a, 6):
                add_block(values, base[e, pair], width[e, pair], stiffness[e, pair], a == b)
                pair += 1
