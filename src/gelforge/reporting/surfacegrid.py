"""The gel's surface of any mesh on one grid, so that a page draws every press alike."""

from functools import lru_cache

import numpy as np

from gelforge.geometry.gel import Gel

SPACING_MM = 0.35


@lru_cache(maxsize=4)
def grid_points(gel: Gel) -> tuple[int, int, np.ndarray]:
    """Rows along x, columns along y, and the points (rows * columns, 3) of the undeformed top, mm."""
    rows, columns = round(gel.width / SPACING_MM) + 1, round(gel.length / SPACING_MM) + 1
    x = np.linspace(-gel.width / 2, gel.width / 2, rows)
    y = np.linspace(-gel.length / 2, gel.length / 2, columns)
    x, y = (axis.ravel() for axis in np.meshgrid(x, y, indexing="ij"))
    return rows, columns, np.column_stack([x, y, gel.top(x, y)])


class Resampler:
    """Carries displacements from a mesh's surface nodes to the grid of a gel.

    mesh: GelMesh, whose surface is a height over x and y. Midside nodes of tetrahedra serve like corners.
    """

    def __init__(self, mesh, gel: Gel):
        from scipy.spatial import Delaunay

        self.nodes = mesh.surface_nodes
        self.places = mesh.nodes[self.nodes]
        flat = self.places[:, :2]
        triangles = Delaunay(flat)
        points = grid_points(gel)[2][:, :2] * (1 - 1e-6)
        found = triangles.find_simplex(points)
        affine = triangles.transform[found]
        part = np.einsum("gij,gj->gi", affine[:, :2], points - affine[:, 2])
        self.corners = triangles.simplices[found]
        weight = np.column_stack([part, 1 - part.sum(axis=1)])
        # Rounded corners of the outline leave points of the grid outside: there the gel does not move.
        self.weight = np.where((found >= 0)[:, None], np.nan_to_num(weight), 0.0)

    def __call__(self, displacement: np.ndarray) -> np.ndarray:
        """Displacement (g, 3) mm on the grid of one (s, 3) mm on the surface nodes."""
        return np.einsum("gk,gkj->gj", self.weight, displacement[self.corners])
