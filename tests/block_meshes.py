"""Tetrahedral meshes without pytetwild, for tests."""

import itertools

import numpy as np

from gelforge.mechanics.mesh import GelMesh
from gelforge.mechanics.tet import from_flat, orient


def kuhn(axes) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and tetrahedra (e, 4) of a grid with lines `axes`, six to a cell."""
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    index = np.arange(points[..., 0].size).reshape(points.shape[:3])
    tets = []
    for cell in itertools.product(*(range(n - 1) for n in index.shape)):
        for order in itertools.permutations(range(3)):
            path = [np.array(cell)]
            for axis in order:
                path.append(path[-1] + np.eye(3, dtype=int)[axis])
            tets.append([index[tuple(p)] for p in path])
    return points.reshape(-1, 3), orient(points.reshape(-1, 3), np.array(tets))


def block_mesh(gel, size: float, layers: int) -> GelMesh:
    """Second-order tetrahedra of a gel without rounded corners, cells of about `size`, finer towards the top."""
    x, y = (np.linspace(-w / 2, w / 2, round(w / size) + 1) for w in (gel.width, gel.length))
    z = -gel.height + gel.height * np.sin(np.linspace(0, np.pi / 2, layers + 1))
    return from_flat(gel, *kuhn((x, y, z)))
