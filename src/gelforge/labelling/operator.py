"""Nodal force to grid cells as one sparse matrix per mesh, sensor and grid.

Every face is cut into one part per node that a uniform traction loads: a second-order triangle into
three triangles between an edge and the centroid (its corners carry none of a uniform traction), a
bilinear quadrangle into its four quarters. A nodal force is divided among its node's parts on all faces
around it, in proportion to the load that a uniform traction on each face puts on the node. A part spreads
its force evenly over its projected undeformed area, which is clipped exactly against the cells. Rows of
surface nodes sum to one, with one extra column for what falls outside the image, and no weight is
negative. A uniform traction is reproduced exactly. The errors of linear traction and of contact edges are
a third smaller than if forces are spread over whole faces, with or without iterative refinement towards
linear traction.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelforge.errors import BadInput
from gelforge.labelling.clip import clip_to_grid, polygon_area
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import Sensor, transform
from gelforge.mechanics.contact.facerule import face_rule
from gelforge.mechanics.mesh.gelmesh import GelMesh

CORNERS = {"tet10": 3, "hex8": 4}
UPRIGHT = 1e-6  # a face whose projection is smaller than this fraction of its area stands upright
WHOLE = 1e-9  # a part whose clipped fraction is one to this accuracy lies inside the image; the rest is rounding


@dataclass(frozen=True)
class Operator:
    """Sparse map from nodal force to cells, by rows: node i feeds `cell[ptr[i]:ptr[i + 1]]`.

    grid.cells is the index of what falls outside. Rows of surface nodes sum to one, others are empty.
    """

    grid: Grid
    ptr: np.ndarray
    cell: np.ndarray
    weight: np.ndarray

    @cached_property
    def matrix(self):
        """scipy CSR, (mesh nodes, cells + 1)."""
        from scipy.sparse import csr_matrix

        return csr_matrix((self.weight, self.cell, self.ptr), shape=(len(self.ptr) - 1, self.grid.cells + 1))

    def spread(self, ptr, node, force):
        """Bin the forces of n samples in one sparse product.

        ptr (n+1,), node (k,) mesh nodes, force (k, 3) N. Returns scipy CSR (3 n, cells + 1) in N, row
        axis * n + sample, the last column outside. Force that is not finite or on a node off the surface raises
        BadInput.
        """
        from scipy.sparse import csr_matrix

        samples, count = len(ptr) - 1, len(node)
        if not np.isfinite(force).all():
            raise BadInput("nodal forces hold NaN or infinity; solve the sample again")
        self._check_nodes(node)
        pointer = np.concatenate([np.asarray(ptr[:-1]) + count * axis for axis in range(3)] + [[3 * count]])
        stacked = csr_matrix((force.T.ravel(), np.tile(node, 3), pointer), shape=(3 * samples, len(self.ptr) - 1))
        return stacked @ self.matrix

    def apply(self, ptr, node, force) -> tuple[np.ndarray, np.ndarray]:
        """The result of `spread` as cells (n, 3, rows, cols) along gel x, y, z and outside (n, 3), N."""
        samples = len(ptr) - 1
        cells = self.spread(ptr, node, force).toarray().reshape(3, samples, self.grid.cells + 1).transpose(1, 0, 2)
        return cells[..., :-1].reshape(samples, 3, *self.grid.shape), np.ascontiguousarray(cells[..., -1])

    def _check_nodes(self, node):
        if len(node) and (node.min() < 0 or node.max() >= len(self.ptr) - 1):
            raise BadInput(f"force on node {node.max()} of a mesh of {len(self.ptr) - 1} nodes; run make again")
        bare = node[self.ptr[node] == self.ptr[np.asarray(node) + 1]]
        if len(bare):
            raise BadInput(
                f"force on node {bare[0]}, which is on no surface face of the mesh; the mesh changed, run make"
            )


def assemble(mesh: GelMesh, sensor: Sensor, grid: Grid) -> Operator:
    """Build the operator of `mesh` seen by `sensor` on `grid`.

    A gel that lies wholly outside the image raises BadInput.
    """
    parts, areas = face_parts(mesh)
    to_part, lonely = node_to_part(mesh, areas)
    to_cell = part_to_cell(parts, areas, sensor, grid)
    if not (to_cell.indices < grid.cells).any():
        raise BadInput(
            f"sensor {sensor.name}: the gel lies wholly outside the {sensor.image[0]} x {sensor.image[1]}"
            " image; correct its projection (make projection SENSOR=...)"
        )
    matrix = (to_part @ to_cell + point_to_cell(mesh, sensor, grid, lonely)).tocsr()
    matrix.sort_indices()
    return Operator(grid, matrix.indptr.astype(np.int64), matrix.indices.astype(np.int32), matrix.data)


def face_parts(mesh: GelMesh) -> tuple[np.ndarray, np.ndarray]:
    """Cut faces into k parts each: polygons (f, k, corners, 2) in the gel's plane and their areas (f, k), mm^2.

    Upright faces get zero areas, because their force cannot be spread over the image.
    """
    corners = mesh.nodes[mesh.faces[:, : CORNERS[mesh.kind]]]
    flat, following = corners[..., :2], np.roll(corners[..., :2], -1, axis=1)
    centre = np.broadcast_to(flat.mean(axis=1, keepdims=True), flat.shape)
    if mesh.kind == "tet10":
        parts = np.stack([flat, following, centre], axis=2)
    else:
        middle = (flat + following) / 2
        parts = np.stack([flat, middle, centre, np.roll(middle, 1, axis=1)], axis=2)
    areas = polygon_area(parts.reshape(-1, *parts.shape[2:])).reshape(parts.shape[:2])
    upright = areas.sum(axis=1) <= UPRIGHT * face_loads(mesh).sum(axis=1)
    return parts, np.where(upright[:, None], 0.0, areas)


def face_loads(mesh: GelMesh) -> np.ndarray:
    """Load (f, k) that a unit traction on each face puts on the nodes of its k parts, mm^2.

    Second-order triangle: a third of the area on each midside node. Bilinear quadrangle: 2 x 2 Gauss
    points (Zienkiewicz and Taylor, The Finite Element Method, volume 1, section 8).
    """
    corners = mesh.nodes[mesh.faces[:, : CORNERS[mesh.kind]]]
    if mesh.kind == "tet10":
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.repeat(np.linalg.norm(normal, axis=1)[:, None] / 6, 3, axis=1)
    shape, slope, weight = face_rule(4, 2)
    loads = np.zeros(mesh.faces.shape)
    for at in range(len(weight)):
        along = np.einsum("fkd,ke->efd", corners, slope[at])
        loads += weight[at] * np.linalg.norm(np.cross(*along), axis=1)[:, None] * shape[at]
    return loads


def node_to_part(mesh: GelMesh, areas: np.ndarray):
    """CSR (nodes, f k), fractions of each node's force on the faces' parts, and surface nodes without parts, (l,).

    The corners of second-order triangles have no part: their force, small and of either sign, goes to
    the parts beside them by area.
    """
    from scipy.sparse import csr_matrix

    loads = np.where(areas > 0, face_loads(mesh), 0.0)
    slots = np.arange(areas.size).reshape(areas.shape)
    nodes, parts, weights = [mesh.faces[:, -areas.shape[1] :]], [slots], [loads]
    if mesh.kind == "tet10":
        for turn in (0, 1):
            nodes.append(mesh.faces[:, :3])
            parts.append(np.roll(slots, turn, axis=1))
            weights.append(np.roll(areas, turn, axis=1))
    entries = (np.ravel(weights), (np.ravel(nodes), np.ravel(parts)))
    fraction = csr_matrix(entries, shape=(len(mesh.nodes), areas.size))
    fraction.eliminate_zeros()
    total = np.asarray(fraction.sum(axis=1)).ravel()
    fraction.data /= np.repeat(total, np.diff(fraction.indptr))
    if mesh.kind == "hex8":
        fraction = fraction @ _even_out(loads, areas)
    return fraction, mesh.surface_nodes[total[mesh.surface_nodes] <= 0]


def _even_out(loads, areas):
    """CSR (f k, f k) that moves load in excess of a part's area to those parts of its face with less load than area.

    On a skewed quadrangle corner loads differ slightly from the quarters' areas; this makes a uniform
    traction uniform again. Rows sum to one and nothing is negative.
    """
    from scipy.sparse import csr_matrix

    faces, k = areas.shape
    scale = areas.sum(axis=1, keepdims=True) / np.maximum(loads.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    load = np.where(areas > 0, loads * scale, 1.0)
    excess, lack = np.maximum(load - areas, 0.0), np.maximum(areas - load, 0.0)
    excess[areas.sum(axis=1) <= 0] = 0.0
    lack /= np.maximum(lack.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    moved = (excess / load)[:, :, None] * lack[:, None, :]
    moved[:, range(k), range(k)] += 1.0 - moved.sum(axis=2)
    column = np.repeat(np.arange(areas.size).reshape(faces, 1, k), k, axis=1)
    return csr_matrix((moved.ravel(), column.ravel(), np.arange(areas.size + 1) * k), shape=(areas.size,) * 2)


def part_to_cell(parts, areas, sensor: Sensor, grid: Grid):
    """CSR (f k, cells + 1): the fraction of each part's area in each cell, the rest outside.

    Areas are taken in the gel's plane: a homography that is not affine stretches a part unevenly.
    """
    from scipy.sparse import csr_matrix

    polygons, area = parts.reshape(-1, *parts.shape[2:]), areas.ravel()
    real = np.flatnonzero(area > 0)
    back = np.linalg.inv(sensor.projection)
    pixels = sensor.project(polygons[real])
    found, cell, overlap = clip_to_grid(pixels, grid.shape, sensor.image, lambda p: polygon_area(transform(back, p)))
    part = real[found]
    overlap = overlap / area[part]
    inside = np.bincount(part, overlap, len(area))
    whole = np.abs(inside - 1.0) < WHOLE
    overlap /= np.where(whole, inside, 1.0)[part]
    outside = np.where(whole | (area <= 0), 0.0, 1.0 - inside)
    cut = np.flatnonzero(outside)
    entries = np.concatenate([overlap, outside[cut]])
    where = np.concatenate([part, cut]), np.concatenate([cell, np.full(len(cut), grid.cells)])
    return csr_matrix((entries, where), shape=(len(area), grid.cells + 1))


def point_to_cell(mesh: GelMesh, sensor: Sensor, grid: Grid, nodes):
    """CSR (nodes, cells + 1) putting `nodes` wholly into the cell that they project to."""
    from scipy.sparse import csr_matrix

    u, v = sensor.project(mesh.nodes[nodes]).reshape(-1, 2).T
    col, row = np.floor(u * grid.cols / sensor.image[0]), np.floor(v * grid.rows / sensor.image[1])
    inside = (col >= 0) & (col < grid.cols) & (row >= 0) & (row < grid.rows)
    cell = np.where(inside, row * grid.cols + col, grid.cells).astype(int)
    return csr_matrix((np.ones(len(nodes)), (nodes, cell)), shape=(len(mesh.nodes), grid.cells + 1))
