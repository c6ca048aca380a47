"""Patch tests of the binning operator: irregular surfaces, known tractions, and their exact force per cell."""

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.labelling.clip import clip_to_grid, polygon_area
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import CORNERS, face_loads
from gelforge.labelling.sensor import Sensor, transform
from gelforge.mechanics.mesh.gelmesh import GelMesh

TRIANGLE_RULE = (  # degree 4, Dunavant (1985), table 1: weight, then two of the area coordinates
    (0.223381589678011, 0.445948490915965, 0.445948490915965),
    (0.223381589678011, 0.10810301816807, 0.445948490915965),
    (0.223381589678011, 0.445948490915965, 0.10810301816807),
    (0.109951743655322, 0.091576213509771, 0.091576213509771),
    (0.109951743655322, 0.816847572980459, 0.091576213509771),
    (0.109951743655322, 0.091576213509771, 0.816847572980459),
)
SQUARE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def irregular_surface(kind: str, size: float, rng, gel: Gel | None = None, jitter: float = 0.3) -> GelMesh:
    """Surface mesh over the gel's rectangle with corners moved at random by up to `jitter` of `size` mm.

    "tet10" gives a Delaunay triangulation with midside nodes on the dome, "hex8" skewed quadrangles on its
    apex plane. There are no volume elements.
    """
    from scipy.spatial import Delaunay

    gel = gel or Gel()
    counts = [round(length / size) for length in (gel.width, gel.length)]
    lines = [
        np.linspace(-length / 2, length / 2, n + 1) for length, n in zip((gel.width, gel.length), counts, strict=True)
    ]
    flat = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    inner = (np.abs(flat) < np.array([gel.width, gel.length]) / 2 - 1e-9).all(axis=1)
    flat[inner] += rng.uniform(-jitter * size, jitter * size, (inner.sum(), 2))
    if kind == "hex8":
        index = np.arange(len(flat)).reshape(counts[0] + 1, counts[1] + 1)
        faces = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
        return _surface(kind, np.column_stack([flat, np.zeros(len(flat))]), faces)
    corners = Delaunay(flat).simplices
    a, b, c = (flat[corners[:, k]] for k in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    corners = np.where(turn[:, None] < 0, corners[:, ::-1], corners)[np.abs(turn) > 1e-9]
    edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, number = np.unique(edges, axis=0, return_inverse=True)
    flat_all = np.vstack([flat, flat[edges].mean(axis=1)])
    faces = np.hstack([corners, len(flat) + number.reshape(-1, 3)])
    return _surface(kind, np.column_stack([flat_all, gel.top(*flat_all.T)]), faces)


def _surface(kind, nodes, faces) -> GelMesh:
    width = {"hex8": 8, "tet10": 10}[kind]
    return GelMesh(kind, nodes, np.empty((0, width), np.int32), faces.astype(np.int32), np.empty(0, np.int32))


def consistent_loads(mesh: GelMesh, traction) -> np.ndarray:
    """Nodal forces (n,) of a traction(x, y) per unit of surface, integrated with the faces' shape functions."""
    corners, forces = mesh.nodes[mesh.faces[:, : CORNERS[mesh.kind]]], np.zeros(len(mesh.nodes))
    for weight, shape, place in _triangle_points(corners) if mesh.kind == "tet10" else _square_points(corners):
        np.add.at(forces, mesh.faces, (weight * traction(place[:, 0], place[:, 1]))[:, None] * shape)
    return forces


def _triangle_points(corners):
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    for weight, a, b in TRIANGLE_RULE:
        at = np.array([1 - a - b, a, b])
        shape = np.concatenate([at * (2 * at - 1), 4 * at * np.roll(at, -1)])
        yield weight * area, shape, np.einsum("fkd,k->fd", corners, at)


def _square_points(corners):
    points, weights = np.sqrt(0.6) * np.array([-1, 0, 1]), np.array([5, 8, 5]) / 9
    for i in range(3):
        for j in range(3):
            at = np.array([points[i], points[j]])
            along = [
                np.einsum("fkd,k->fd", corners, SQUARE[:, k] * (1 + SQUARE[:, 1 - k] * at[1 - k]) / 4) for k in (0, 1)
            ]
            shape = np.prod(1 + SQUARE * at, axis=1) / 4
            area = np.linalg.norm(np.cross(*along), axis=1)
            yield weights[i] * weights[j] * area, shape, np.einsum("fkd,k->fd", corners, shape)


def exact_cells(mesh: GelMesh, traction, sensor: Sensor, grid: Grid) -> np.ndarray:
    """Exact force (rows, cols) of a linear traction(x, y) on each cell: clipped area times traction at centroid."""
    flat = mesh.nodes[mesh.faces[:, : CORNERS[mesh.kind]], :2]
    slope = face_loads(mesh).sum(axis=1) / polygon_area(flat)
    back, total = np.linalg.inv(sensor.projection), np.zeros(grid.cells)
    lift = 1.0 + 2.0 * np.abs(traction(flat[..., 0], flat[..., 1])).max()  # keeps every measure positive
    for sign, measure in ((1.0, lambda p: _integral(p, lambda x, y: traction(x, y) + lift)), (-lift, polygon_area)):
        face, cell, value = clip_to_grid(
            sensor.project(flat), grid.shape, sensor.image, lambda p, m=measure: m(transform(back, p))
        )
        total += sign * np.bincount(cell, value * slope[face], grid.cells)
    return total.reshape(grid.shape)


def _integral(polygons, linear) -> np.ndarray:
    """Integral (m,) of a linear function over polygons (m, k, 2), as a fan of triangles."""
    first, a, b = polygons[:, :1], polygons[:, 1:-1], polygons[:, 2:]
    u, v = a - first, b - first
    area = (u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]) / 2
    centre = (first + a + b) / 3
    return np.abs((area * linear(centre[..., 0], centre[..., 1])).sum(axis=1))
