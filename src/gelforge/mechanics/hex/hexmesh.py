"""Structured brick meshes of the gel: fine under one press, growing coarser away from it and with depth."""

from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry.gel import Gel
from gelforge.mechanics.mesh import GelMesh

SMALLEST_PART = 3  # columns either way, of a part that nested dissection cuts no further


@dataclass(frozen=True)
class HexMesh(GelMesh):
    """A GelMesh of bricks whose nodes are numbered x fastest, then y, then z from the base up.

    xs: (nx + 1,), ys: (ny + 1,) mesh lines before the outline's corners are rounded, mm.
    layers: number of layers nz.
    """

    xs: np.ndarray
    ys: np.ndarray
    layers: int

    @property
    def shape(self) -> tuple[int, int, int]:
        """Bricks along x, y and z: what decides the sparsity pattern."""
        return len(self.xs) - 1, len(self.ys) - 1, self.layers

    @property
    def heights(self) -> np.ndarray:
        """Relative heights (nz + 1,) of the planes of nodes, 0 at the base and 1 at the top."""
        plane = len(self.xs) * len(self.ys)
        column = self.nodes[plane // 2 :: plane, 2]
        return (column - column[0]) / (column[-1] - column[0])


@dataclass(frozen=True)
class FineBox:
    """Part of the gel, seen from above, that needs small bricks of side about `size`; all mm."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    size: float


def graded_lines(
    low: float, high: float, fine_low: float, fine_high: float, size: float, growth: float = 1.5, largest: float = 2.0
) -> np.ndarray:
    """Mesh lines on [low, high]: cells of about `size` on the fine part, growing outwards, (n + 1,)."""
    fine_low, fine_high = max(low, fine_low), min(high, fine_high)
    if not fine_high > fine_low:
        raise BadInput(f"fine part [{fine_low}, {fine_high}] lies outside [{low}, {high}]; move the box onto the gel")
    cells = max(1, round((fine_high - fine_low) / size))
    middle = np.linspace(fine_low, fine_high, cells + 1)
    size = (fine_high - fine_low) / cells
    left = fine_low - _outward(fine_low - low, size, growth, largest)[::-1]
    right = fine_high + _outward(high - fine_high, size, growth, largest)
    return np.concatenate([left, middle, right])


def _outward(distance: float, size: float, growth: float, largest: float) -> np.ndarray:
    """Growing offsets that end exactly at `distance`."""
    if distance < 0.5 * size:
        return np.array([distance]) if distance > 1e-9 else np.empty(0)
    sizes: list[float] = []
    while sum(sizes) < distance:
        size = min(size * growth, largest)
        sizes.append(size)
    if len(sizes) > 1 and sum(sizes) - distance > distance - sum(sizes[:-1]):
        sizes.pop()
    return np.cumsum(sizes) * (distance / sum(sizes))


def dissected(nx: int, ny: int) -> np.ndarray:
    """Order (nx * ny,) in which the columns of a grid are eliminated, x fastest in their numbers: nested dissection.

    George 1973, SIAM J. Numer. Anal. 10, 345-363: both halves before the line that parts them.
    """

    def part(x0: int, x1: int, y0: int, y1: int) -> list[np.ndarray]:
        if min(x1 - x0, y1 - y0) <= 0:
            return []
        if max(x1 - x0, y1 - y0) <= SMALLEST_PART:
            return [(np.arange(y0, y1)[:, None] * nx + np.arange(x0, x1)).ravel()]
        if x1 - x0 >= y1 - y0:
            m = (x0 + x1) // 2
            return [*part(x0, m, y0, y1), *part(m + 1, x1, y0, y1), np.arange(y0, y1) * nx + m]
        m = (y0 + y1) // 2
        return [*part(x0, x1, y0, m), *part(x0, x1, m + 1, y1), m * nx + np.arange(x0, x1)]

    return np.concatenate(part(0, nx, 0, ny))


def elimination_order(mesh: "HexMesh") -> np.ndarray:
    """Order (unknowns,) for a direct solver: whole columns of nodes by nested dissection of the plane.

    The unknowns are 3 a node, those of the base left out, in the order of the nodes.
    """
    plane = len(mesh.xs) * len(mesh.ys)
    columns = dissected(len(mesh.xs), len(mesh.ys))
    nodes = (columns[:, None] + plane * np.arange(mesh.layers)).ravel()
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def layer_heights(layers: int, ratio: float) -> np.ndarray:
    """Relative heights from base 0 to top 1, (layers + 1,): the bottom layer is `ratio` times the top one."""
    thickness = np.geomspace(ratio, 1.0, layers) if layers > 1 else np.ones(1)
    return np.concatenate([[0.0], np.cumsum(thickness)]) / thickness.sum()


def build_mesh(
    gel: Gel, box: FineBox, layers: int, layer_ratio: float = 3.0, growth: float = 1.5, largest: float = 2.0
) -> HexMesh:
    """Brick mesh of the gel, fine in `box`."""
    half = gel.width / 2, gel.length / 2
    xs = graded_lines(-half[0], half[0], box.x_min, box.x_max, box.size, growth, largest)
    ys = graded_lines(-half[1], half[1], box.y_min, box.y_max, box.size, growth, largest)
    return mesh_on_lines(gel, xs, ys, layer_heights(layers, layer_ratio))


def mesh_on_lines(gel: Gel, xs: np.ndarray, ys: np.ndarray, heights: np.ndarray) -> HexMesh:
    """Brick mesh on given lines: xs, ys in mm, heights relative from 0 at the base to 1 at the top."""
    x, y = np.meshgrid(xs, ys, indexing="xy")
    x, y = round_corners(x, y, gel.width / 2, gel.length / 2, gel.corner_radius)
    top = np.asarray(gel.top(x, y), float)
    z = -gel.height + (top + gel.height)[None] * np.asarray(heights)[:, None, None]
    nodes = np.stack([np.broadcast_to(x, z.shape), np.broadcast_to(y, z.shape), z], axis=-1).reshape(-1, 3)
    nx, ny, nz = len(xs) - 1, len(ys) - 1, len(heights) - 1
    plane = (nx + 1) * (ny + 1)
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="xy")
    quad = (j * (nx + 1) + i).ravel()[:, None] + np.array([0, 1, nx + 2, nx + 1])
    quads = quad[None] + plane * np.arange(nz)[:, None, None]
    elements = np.concatenate([quads, quads + plane], axis=2).reshape(-1, 8).astype(np.int32)
    faces = (quad + plane * nz).astype(np.int32)
    return HexMesh(
        "hex8", nodes, elements, faces, np.arange(plane, dtype=np.int32), np.asarray(xs), np.asarray(ys), nz
    )


def round_corners(
    x: np.ndarray, y: np.ndarray, half_x: float, half_y: float, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Map a rectangle smoothly onto one with rounded corners (identity but for the corner squares).

    The elliptical map of the unit square onto a quarter disc, u = s sqrt(1 - t^2 / 2).
    """
    if radius <= 0.0:
        return x, y
    s = np.clip((np.abs(x) - (half_x - radius)) / radius, 0.0, None)
    t = np.clip((np.abs(y) - (half_y - radius)) / radius, 0.0, None)
    corner = (s > 0) & (t > 0)
    rounded_x = np.sign(x) * (half_x - radius + radius * s * np.sqrt(np.clip(1 - t**2 / 2, 0.0, None)))
    rounded_y = np.sign(y) * (half_y - radius + radius * t * np.sqrt(np.clip(1 - s**2 / 2, 0.0, None)))
    return np.where(corner, rounded_x, x), np.where(corner, rounded_y, y)


def surface_lines(mesh: GelMesh) -> tuple[np.ndarray, np.ndarray, int]:
    """Lines xs, ys of the top surface and the index of its first node."""
    first = int(mesh.faces[0, 0])
    columns = int(mesh.faces[0, 3]) - first
    surface = mesh.nodes[first:].reshape(-1, columns, 3)
    # lines through the middle are straight: only the outline's corners are bent
    return surface[surface.shape[0] // 2, :, 0], surface[:, columns // 2, 1], first
