"""Quadrature on the six-node faces of second-order tetrahedra."""

from dataclasses import dataclass, replace

import numpy as np

from gelforge.mechanics.mesh.gelmesh import GelMesh


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
    """Derivatives of `shapes` by the second and third barycentric coordinate: (q, 6, 2)."""
    a, b, c = bary.T
    zero = np.zeros_like(a)
    db = np.column_stack([1 - 4 * a, 4 * b - 1, zero, 4 * (a - b), 4 * c, -4 * c])
    dc = np.column_stack([1 - 4 * a, zero, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c)])
    return np.stack([db, dc], axis=-1)


@dataclass(frozen=True)
class FacePoints:
    """Integration points of faces of a mesh (f faces, q points each).

    index: (f,) numbers of the faces among the mesh's. faces: (f, 6) their nodes.
    shape: (q, 6) shape functions. weight: (f, q) undeformed area per point, mm^2.
    position: (f, q, 3) undeformed, mm.
    """

    index: np.ndarray
    faces: np.ndarray
    shape: np.ndarray
    weight: np.ndarray
    position: np.ndarray

    def at(self, field: np.ndarray) -> np.ndarray:
        """Nodal field (n, k) at the points: (f, q, k)."""
        return np.einsum("qa,fak->fqk", self.shape, field[self.faces])

    def only(self, which: np.ndarray) -> "FacePoints":
        """Those of some of the faces, (f,) of bool."""
        return replace(
            self,
            index=self.index[which],
            faces=self.faces[which],
            weight=self.weight[which],
            position=self.position[which],
        )


def face_points(mesh: GelMesh) -> FacePoints:
    """Twelve points on every face that can be touched, weighted by the undeformed area."""
    bary, weights = dunavant12()
    shape = shapes(bary)
    corners = mesh.nodes[mesh.faces]
    tangents = np.einsum("qaj,fak->fqjk", slopes(bary), corners)
    area = np.linalg.norm(np.cross(tangents[..., 0, :], tangents[..., 1, :]), axis=-1) / 2
    return FacePoints(
        np.arange(len(mesh.faces)), mesh.faces, shape, area * weights, np.einsum("qa,fak->fqk", shape, corners)
    )
