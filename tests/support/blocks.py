"""Gel meshes of tetrahedra that are as symmetric as the gel."""

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import FACES, from_flat, kuhn_grid


def symmetric_block(gel: Gel, size: float, layers: int) -> GelMesh:
    """Second-order tetrahedra of a gel without rounded corners: cells of about `size`, symmetric about x = 0 and y = 0.

    For laws that a lopsided mesh would blur; layers grow thinner towards the top.
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
    faces = tets[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]
