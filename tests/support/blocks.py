"""Grids of tetrahedra, symmetric gel meshes of them, and boxes of triangles."""

import itertools
from collections.abc import Sequence

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.geometry.triangles import Mesh, volume
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import FACES as OF_TET
from gelforge.mechanics.mesh.tetmesh import from_flat, orient

FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
# Corners with x and y exchanged: faces split along their other diagonals.
MIRRORED = np.array([0, 2, 1, 3, 4, 6, 5, 7])


def kuhn_grid(axes: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and tetrahedra (e, 4) of a grid with lines `axes` (x, y, z), six per cell (Kuhn 1960)."""
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    _, ny, nz = (len(lines) for lines in axes)
    inner = np.stack(np.meshgrid(*(np.arange(len(lines) - 1) for lines in axes), indexing="ij"), -1).reshape(-1, 3)
    tets = []
    for order in itertools.permutations(range(3)):
        steps = np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(order)]], axis=0)
        tets.append(np.column_stack([(inner + step) @ [ny * nz, nz, 1] for step in steps]))
    return nodes, orient(nodes, np.concatenate(tets))


def symmetric_block(gel: Gel, size: float, layers: int) -> GelMesh:
    """Second-order tetrahedra of a gel without rounded corners: cells of about `size`, symmetric about x = 0 and y = 0.

    For tests that an asymmetric mesh would blur; layers become thinner towards the top.
    """
    x, y = (np.linspace(0, extent / 2, max(1, round(extent / 2 / size)) + 1) for extent in (gel.width, gel.length))
    z = -gel.height + gel.height * np.sin(np.linspace(0, np.pi / 2, layers + 1))
    nodes, tets = kuhn_grid((x, y, z))
    for axis in (0, 1):
        mirrored = nodes * np.where(np.arange(3) == axis, -1.0, 1.0)
        tets = np.concatenate([tets, tets + len(nodes)])
        nodes, same = np.unique(np.round(np.concatenate([nodes, mirrored]), 9) + 0.0, axis=0, return_inverse=True)
        tets = same.ravel()[tets]
    return from_flat(gel, nodes, tets)


def boundary_faces(tets: np.ndarray) -> np.ndarray:
    """Corner triples (f, 3) of the faces that belong to one tetrahedron only, oriented outward."""
    faces = tets[:, OF_TET].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def box(low, size, inverted: bool = False, other_diagonals: bool = False) -> Mesh:
    """A box with its lowest corner at `low` mm and sides of `size` mm."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    faces = FACES if not other_diagonals else MIRRORED[FACES][:, ::-1]
    solid = corners * size + np.asarray(low, float), faces
    return (solid[0], faces[:, ::-1]) if inverted != (volume(*solid) < 0.0) else solid
