"""Mean displacement of the gel's surface in each cell of the image, and its area before and after deformation.

A cell is the piece of the gel's surface that it shows before contact, and follows that piece. Means and areas come
from nodal values by sparse matrices and use the same clipped face parts that spread forces (`labelling.operator`), so
that traction times area is the force of a cell.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.labelling.clip import clip_to_grid, polygon_area
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import CORNERS, face_parts, part_to_cell
from gelforge.labelling.sensor import Sensor, transform
from gelforge.mechanics.contact.facerule import bilinear, shapes
from gelforge.mechanics.mesh.gelmesh import GelMesh

NEWTON_STEPS = 8  # to invert a bilinear map; each doubles the correct digits


@dataclass(frozen=True)
class SurfaceMap:
    """Linear maps of one mesh seen by one sensor on one grid.

    mean: CSR (cells, nodes), rows sum to one, empty where a cell shows no gel. fraction: CSR (parts, cells + 1), of
    each part's area in each cell, the last column outside. weights: CSR (points, nodes), interpolates points on
    faces. corners: (parts, triangles, 3), indices of these points.
    """

    grid: Grid
    nodes: np.ndarray
    mean: Any
    fraction: Any
    weights: Any
    corners: np.ndarray

    def displacement(self, moved: np.ndarray) -> np.ndarray:
        """Mean of a displacement (nodes, 3) over each cell, (3, rows, cols) along gel x, y, z; NaN without gel."""
        found = self.mean @ moved
        found[np.diff(self.mean.indptr) == 0] = np.nan
        return found.T.reshape(3, *self.grid.shape)

    def area(self, moved: np.ndarray | None = None) -> np.ndarray:
        """Area (rows, cols) mm^2 of the surface in each cell, after a displacement (nodes, 3) where one is given."""
        points = (self.weights @ (self.nodes if moved is None else self.nodes + moved))[self.corners]
        normal = np.cross(points[:, :, 1] - points[:, :, 0], points[:, :, 2] - points[:, :, 0])
        parts = 0.5 * np.linalg.norm(normal, axis=2).sum(axis=1)
        return (parts @ self.fraction)[:-1].reshape(self.grid.shape)


def traction(force: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Force per cell (3, rows, cols) N over its area (rows, cols) mm^2, in kPa; NaN where a cell shows no gel."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(area > 0, 1e3 * force / area, np.nan)


def surface_map(mesh: GelMesh, sensor: Sensor, grid: Grid) -> SurfaceMap:
    """Build the maps of `mesh` seen by `sensor` on `grid`."""
    parts, areas = face_parts(mesh)
    weights, corners = _corners(mesh)
    return SurfaceMap(
        grid, mesh.nodes, _mean(mesh, parts, areas, sensor, grid), part_to_cell(parts, areas, sensor, grid),
        weights, corners,
    )  # fmt: skip


def _corners(mesh: GelMesh) -> tuple[Any, np.ndarray]:
    """`weights` and `corners` of `SurfaceMap`: corners of the triangles that make up every part."""
    from scipy.sparse import csr_matrix

    k = CORNERS[mesh.kind]
    # shape functions of a second-order triangle at its centroid: -1/9 per corner, 4/9 per midside node
    unit = np.eye(mesh.faces.shape[1])
    if mesh.kind == "tet10":
        corner, side, middle = unit[:3], unit[3:6], np.repeat([-1 / 9, 4 / 9], 3)
        pattern = [[i, k + i, 2 * k] for i in range(k)], [[k + i, (i + 1) % k, 2 * k] for i in range(k)]
    else:
        corner, side, middle = unit, (unit + np.roll(unit, -1, axis=0)) / 2, np.full(k, 1 / k)
        pattern = [[i, k + i, 2 * k] for i in range(k)], [[i, 2 * k, k + (i - 1) % k] for i in range(k)]
    local = np.vstack([corner, side, middle])
    faces = len(mesh.faces)
    rows = np.repeat(np.arange(faces * len(local)), local.shape[1])
    entries = (np.tile(local.ravel(), faces), (rows, np.repeat(mesh.faces, len(local), axis=0).ravel()))
    weights = csr_matrix(entries, shape=(faces * len(local), len(mesh.nodes)))
    own = np.stack(pattern, axis=1)
    return weights, (np.arange(faces)[:, None, None, None] * len(local) + own).reshape(-1, 2, 3)


def _mean(mesh: GelMesh, parts: np.ndarray, areas: np.ndarray, sensor: Sensor, grid: Grid) -> Any:
    """CSR (cells, nodes): mean of a nodal field over each cell, from its values at centroids of clipped pieces."""
    from scipy.sparse import csr_matrix

    polygons, k = parts.reshape(-1, *parts.shape[2:]), areas.shape[1]
    real = np.flatnonzero(areas.ravel() > 0)
    pixels, back = sensor.project(polygons[real]), np.linalg.inv(sensor.projection)
    low = polygons[real].min(axis=(0, 1), initial=0.0) - 1.0

    def moment(axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        def measure(piece: np.ndarray) -> np.ndarray:
            flat = transform(back, piece)
            return polygon_area(flat) * (_middle(flat)[:, axis] - low[axis])

        return clip_to_grid(pixels, grid.shape, sensor.image, measure)

    found, cell, area = clip_to_grid(pixels, grid.shape, sensor.image, lambda p: polygon_area(transform(back, p)))
    middle = np.stack([moment(axis)[2] / area + low[axis] for axis in (0, 1)], axis=1)
    face = real[found] // k
    shapes = _shapes(mesh, face, middle)
    entries = (area[:, None] * shapes).ravel(), (np.repeat(cell, shapes.shape[1]), mesh.faces[face].ravel())
    total = csr_matrix(entries, shape=(grid.cells, len(mesh.nodes)))
    size = np.bincount(cell, area, grid.cells)
    total.data /= np.repeat(np.maximum(size, np.finfo(float).tiny), np.diff(total.indptr))
    return total


def _middle(polygons: np.ndarray) -> np.ndarray:
    """Centroids (m, 2) of convex polygons (m, k, 2); for degenerate ones the mean of the corners."""
    first = polygons[:, :1]
    local = polygons - first
    following = np.roll(local, -1, axis=1)
    cross = local[..., 0] * following[..., 1] - following[..., 0] * local[..., 1]
    double = cross.sum(axis=1)
    mean = local.mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = ((local + following) * cross[..., None]).sum(axis=1) / (3.0 * double[:, None])
    inside = np.isfinite(found) & (found >= local.min(axis=1)) & (found <= local.max(axis=1))
    return np.where(inside.all(axis=1)[:, None], found, mean) + first[:, 0]


def _shapes(mesh: GelMesh, face: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Shape functions (m, nodes of a face) of faces at points (m, 2) of the gel's plane; they sum to one."""
    corners = mesh.nodes[mesh.faces[face][:, : CORNERS[mesh.kind]]][..., :2]
    if mesh.kind == "tet10":
        edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        inner = np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
        fraction = np.column_stack([1.0 - inner.sum(axis=1), inner])
        return shapes(fraction)
    place = np.zeros_like(points)
    for _ in range(NEWTON_STEPS):
        value, slope = bilinear(place)
        wrong = np.einsum("mk,mkd->md", value, corners) - points
        place -= np.linalg.solve(np.einsum("mke,mkd->mde", slope, corners), wrong[..., None])[..., 0]
    return bilinear(place)[0]
