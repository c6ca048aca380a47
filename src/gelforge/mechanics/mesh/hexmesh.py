"""Structured hexahedral meshes of the gel: fine under one press, coarser away from it and with depth."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry import touch
from gelforge.geometry.gel import Gel
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.stepped import Cells, Hanging, Planes, planes_of
from gelforge.mechanics.scene import Scene

SMALLEST_PART = 3  # columns, in x and y, of a part that nested dissection does not divide


@dataclass(frozen=True)
class HexMesh(GelMesh):
    """A GelMesh of hexahedra whose nodes are numbered x fastest, then y, then z from the base up.

    xs: (nx + 1,), ys: (ny + 1,) mesh lines before the outline's corners are rounded, mm.
    layers: number of layers nz. planes: the lines that pass through each plane of nodes. `elements` are those of the
    full grid down to the base, for plots; `cells` are the hexahedra that are solved.
    """

    xs: np.ndarray
    ys: np.ndarray
    layers: int
    planes: Planes

    @property
    def shape(self) -> tuple[int, int, int]:
        """Hexahedra along x, y and z if all lines went down to the base."""
        return len(self.xs) - 1, len(self.ys) - 1, self.layers

    @property
    def pattern_key(self) -> tuple:
        """Key of the sparsity pattern: the lines through each plane determine it."""
        return tuple((x.left.tobytes(), y.left.tobytes()) for x, y in self.planes.lines)

    @cached_property
    def cells(self) -> Cells:
        """The hexahedra that are solved."""
        return self.planes.cells()

    @cached_property
    def hanging(self) -> Hanging:
        """The hanging nodes, which move with the faces of wide hexahedra."""
        return self.planes.hanging()

    @cached_property
    def heights(self) -> np.ndarray:
        """Relative heights (nz + 1,) of the planes of nodes, 0 at the base and 1 at the top."""
        # of a column through all planes, because hanging nodes lie on flat faces, a little off their plane
        x, y = (lines.left for lines in self.planes.lines[0])
        through = np.flatnonzero(y[:, None] & x)
        column = self.nodes[through[len(through) // 2] :: len(self.xs) * len(self.ys), 2]
        return (column - column[0]) / (column[-1] - column[0])


@dataclass(frozen=True)
class FineBox:
    """Contact, seen from above: mesh lines pass through its sides, and hexahedra in and around it have side `size`; mm."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    size: float


def graded_lines(
    low: float, high: float, fine_low: float, fine_high: float, size: float, growth: float = 1.5, largest: float = 2.0,
    many: int = 1,
) -> np.ndarray:  # fmt: skip
    """Mesh lines (n + 1,) on [low, high], also through the ends of the fine part; mm.

    Cells of about `size` on the fine part, a multiple of `many` of them, and `around` it, growing to `largest` beyond.
    growth: width of a cell over that of its inner neighbour. BadInput if the fine part lies outside [low, high].
    """
    fine_low, fine_high = max(low, fine_low), min(high, fine_high)
    if not fine_high > fine_low:
        raise BadInput(f"fine part [{fine_low}, {fine_high}] lies outside [{low}, {high}]; move the box onto the gel")
    cells = many * max(1, round((fine_high - fine_low) / (many * size)))
    middle = np.linspace(fine_low, fine_high, cells + 1)
    size = (fine_high - fine_low) / cells
    left = fine_low - _outward(fine_low - low, size, growth, largest)[::-1]
    right = fine_high + _outward(high - fine_high, size, growth, largest)
    return np.concatenate([left, middle, right])


def _outward(distance: float, size: float, growth: float, largest: float) -> np.ndarray:
    """Growing offsets (k,) that end exactly at `distance`, mm; size: of the first cell's inner neighbour."""
    if distance < 0.5 * size:
        return np.array([distance]) if distance > 1e-9 else np.empty(0)
    sizes = [size] * int(np.ceil(min(around(size), distance) / size))
    while sum(sizes) < distance:
        size = min(size * growth, largest)
        sizes.append(size)
    if len(sizes) > 1 and sum(sizes) - distance > distance - sum(sizes[:-1]):
        sizes.pop()
    return np.cumsum(sizes) * (distance / sum(sizes))


def dissected(cuts_x: np.ndarray, cuts_y: np.ndarray) -> np.ndarray:
    """Elimination order of the columns of a grid, numbered x fastest, by nested dissection.

    George 1973, SIAM J. Numer. Anal. 10, 345-363: both halves come before the line that separates them. cuts_x,
    cuts_y: (nx,), (ny,) bool, lines that may separate: not those that end above the base, within wide hexahedra.
    """
    nx, ny = len(cuts_x), len(cuts_y)

    def part(x0: int, x1: int, y0: int, y1: int) -> list[np.ndarray]:
        if min(x1 - x0, y1 - y0) <= 0:
            return []
        whole = (np.arange(y0, y1)[:, None] * nx + np.arange(x0, x1)).ravel()
        if max(x1 - x0, y1 - y0) <= SMALLEST_PART:
            return [whole]
        m = middle_cut(cuts_x, x0, x1) if x1 - x0 >= y1 - y0 else middle_cut(cuts_y, y0, y1)
        if m is None:
            return [whole]
        if x1 - x0 >= y1 - y0:
            return [*part(x0, m, y0, y1), *part(m + 1, x1, y0, y1), np.arange(y0, y1) * nx + m]
        return [*part(x0, x1, y0, m), *part(x0, x1, m + 1, y1), m * nx + np.arange(x0, x1)]

    return np.concatenate(part(0, nx, 0, ny))


def middle_cut(cuts: np.ndarray, low: int, high: int) -> int | None:
    """The index in [low, high), nearest to the middle, at which `cuts` (n,) allows a cut; None if there is none."""
    allowed = np.flatnonzero(cuts[low:high]) + low
    return int(allowed[np.argmin(np.abs(allowed - (low + high) // 2))]) if len(allowed) else None


def elimination_order(mesh: "HexMesh") -> np.ndarray:
    """Elimination order (unknowns,) for a direct solver: whole columns of nodes, by nested dissection of the plane.

    The unknowns are three per node of `mesh.unknown`.
    """
    plane = len(mesh.xs) * len(mesh.ys)
    # only lines that reach the base separate the gel; below the end of others lie wide hexahedra
    x, y = mesh.planes.lines[0]
    nodes = (dissected(x.left, y.left)[:, None] + plane * np.arange(mesh.layers + 1)).ravel()
    number = np.full(len(mesh.nodes), -1)
    number[mesh.unknown] = np.arange(len(mesh.unknown))
    order = number[nodes]
    return (3 * order[order >= 0, None] + np.arange(3)).ravel()


def layer_heights(layers: int, ratio: float) -> np.ndarray:
    """Relative heights from base 0 to top 1, (layers + 1,): the bottom layer is `ratio` times the top one."""
    thickness = np.geomspace(ratio, 1.0, layers) if layers > 1 else np.ones(1)
    return np.concatenate([[0.0], np.cumsum(thickness)]) / thickness.sum()


def thinner_layers(layers: int, ratio: float, height: float, thickest: float, growth: float) -> tuple[int, float]:
    """Number of layers and their ratio (see `layer_heights`) with a top layer of at most `thickest`; lengths in mm.

    The given ones if they are thin enough on a gel of that height. Else all layers grow downwards by one factor, and
    layers are added until that factor is at most `growth`.
    """
    heights = layer_heights(layers, ratio)
    if (1.0 - heights[-2]) * height <= thickest:
        return layers, ratio
    thicknesses = height / thickest  # total height in units of the top layer
    while (growth ** np.arange(layers)).sum() < thicknesses:
        layers += 1
    roots = np.roots([*np.ones(layers - 1), 1.0 - thicknesses])
    factor = roots[np.abs(roots.imag) < 1e-9].real.max()
    # rounded, because the ratio is part of a mesh's name
    return layers, round(float(factor ** (layers - 1)), 3)


def build_mesh(
    gel: Gel,
    box: FineBox,
    layers: int,
    layer_ratio: float = 3.0,
    growth: float = 1.5,
    largest: float = 2.0,
    widened: Sequence[int] = (),
) -> HexMesh:
    """Hexahedral mesh of the gel, fine in `box`; the lowest layers have wider hexahedra (see stepped.planes_of).

    layers, layer_ratio: as in `layer_heights`. growth, largest: as in `graded_lines`. Raises BadInput if the box lies
    beside the gel.
    """
    half = gel.width / 2, gel.length / 2
    many = 2 ** len(widened)
    xs = graded_lines(-half[0], half[0], box.x_min, box.x_max, box.size, growth, largest, many)
    ys = graded_lines(-half[1], half[1], box.y_min, box.y_max, box.size, growth, largest, many)
    planes = planes_of(xs, ys, layers, widened, (box.x_min, box.x_max, box.y_min, box.y_max))
    return mesh_on_lines(gel, xs, ys, layer_heights(layers, layer_ratio), planes)


def mesh_on_lines(
    gel: Gel, xs: np.ndarray, ys: np.ndarray, heights: np.ndarray, planes: Planes | None = None
) -> HexMesh:
    """Hexahedral mesh on given lines: xs, ys in mm, heights relative from 0 at the base to 1 at the top.

    planes: the lines that pass through each of the heights; all by default.
    """
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
    xs, ys, base = np.asarray(xs), np.asarray(ys), np.arange(plane, dtype=np.int32)
    planes = planes or planes_of(xs, ys, nz, (), (0.0, 0.0, 0.0, 0.0))
    mesh = HexMesh("hex8", nodes, elements, faces, base, xs, ys, nz, planes)
    mesh.hanging.hang(nodes)
    return mesh


def round_corners(
    x: np.ndarray, y: np.ndarray, half_x: float, half_y: float, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Map points x, y (...) mm of a rectangle to one with rounded corners (the identity outside the corner squares).

    Elliptical map of the unit square onto a quarter disc, u = s sqrt(1 - t^2 / 2) (Fong 2015, Analytical Methods for
    Squaring the Disc, arXiv:1509.06344).
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
    """Lines xs, ys (mm) of the top surface of a hexahedral mesh, and the index of the surface's first node."""
    first = int(mesh.faces[0, 0])
    columns = int(mesh.faces[0, 3]) - first
    surface = mesh.nodes[first:].reshape(-1, columns, 3)
    # lines through the middle are straight: only the outline's corners are bent
    return surface[surface.shape[0] // 2, :, 0], surface[:, columns // 2, 1], first


NARROW = 0.8  # hexahedra across narrow parts of a contact, as a fraction of those required across the whole
SMALLEST = 0.15  # mm, smallest side of hexahedra under a small contact that is not TINY
# A contact under TINY mm across is sampled at POINTS points across, and gets FEWEST hexahedra across its longer side,
# down to 0.01 mm each: with three, the force on a cone's tip is a tenth too large. MARGIN more surround it.
TINY, POINTS, FEWEST, MARGIN = 1.2, 40, 6, 5
SPACING = 0.2  # mm between the points at which other contacts are sampled
AROUND = 0.5  # mm of small hexahedra around the contact, at most MARGIN of them
SHARP = 3.0  # decay of sharpness with the distance between both sides, over the size of hexahedra


def around(size: float) -> float:
    """Width, mm, of the rim of hexahedra of side `size` mm around a contact."""
    return min(AROUND, MARGIN * size)


def sharpness(scene: Scene, size: float) -> float:
    """Mean over its four sides of how sharp the edge of contact is, from 0 under round bodies to 1; size: of hexahedra, mm."""
    met, contact = touch.sides(scene.gel, scene.indenter, scene.press)
    return float(np.exp(-SHARP * np.abs(met - contact) / size).mean()) if len(met) else 0.0


def fine_box(scene: Scene, size: float, across: int = 0) -> FineBox:
    """The contact of a press: each side where a sharp edge ends it, or where the undeformed surface meets the body.

    Hexahedra have side `size`, or less if fewer than `across` of them would fit across the shorter side of the contact,
    or if its parts are narrow, down to SMALLEST; under a contact below TINY down to its longer side / FEWEST, if that is
    less, and never below 0.01 mm. across: 0 for `size` everywhere.
    """
    smallest = SMALLEST
    points, shape = touch.under_path(scene.gel, scene.indenter, scene.press, SPACING)
    inside = touch.touched(scene.indenter, scene.press, points)
    if across and inside.any() and np.ptp(points[inside, :2], axis=0).max() < TINY:
        low, high = points[inside, :2].min(axis=0) - SPACING, points[inside, :2].max(axis=0) + SPACING
        points, shape = touch.top_points(scene.gel, low, high, float((high - low).max()) / POINTS)
        inside = touch.touched(scene.indenter, scene.press, points)
        if inside.any():
            smallest = min(smallest, max(0.01, float(np.ptp(points[inside, :2], axis=0).max()) / FEWEST))
    if not inside.any():
        least = touch.gap(scene.indenter, scene.press, points, 1.0)
        inside = least <= least.min() + 1e-9
    met = points[inside, :2]
    if across:
        shorter = float(np.ptp(met, axis=0).min())
        narrow = min(
            shorter / across,
            touch.width_of(inside.reshape(shape), touch.spacing_of(points, shape)) / (NARROW * across),
        )
        size = min(size, float(np.round(max(smallest, narrow), 2)))
    outer, inner = touch.sides(scene.gel, scene.indenter, scene.press)
    if len(outer):
        sharp = np.abs(outer - inner) < size / 2
        low, high = np.where(sharp, inner, outer).reshape(2, 2)
        # under round bodies a whole number of pairs of coarse hexahedra, so that a line passes through the middle
        wider = (low - high) % (4.0 * size) / 2.0 * ~sharp.reshape(2, 2).any(axis=0)
        low, high = low - wider, high + wider
    else:
        low, high = met.min(axis=0) - around(size), met.max(axis=0) + around(size)
    x_min, x_max, y_min, y_max = np.round([low[0], high[0], low[1], high[1]], 3).tolist()
    return FineBox(x_min, x_max, y_min, y_max, size)
