"""Structured hexahedral meshes of the gel: fine under one press, growing coarser away from it and with depth."""

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

SMALLEST_PART = 3  # columns either way, of a part that nested dissection cuts no further


@dataclass(frozen=True)
class HexMesh(GelMesh):
    """A GelMesh of hexahedra whose nodes are numbered x fastest, then y, then z from the base up.

    xs: (nx + 1,), ys: (ny + 1,) mesh lines before the outline's corners are rounded, mm.
    layers: number of layers nz. planes: which lines go through each plane of nodes. `elements` are those of all lines
    down to the base, as pictures show them; `cells` are the hexahedra that are solved.
    """

    xs: np.ndarray
    ys: np.ndarray
    layers: int
    planes: Planes

    @property
    def shape(self) -> tuple[int, int, int]:
        """Hexahedra along x, y and z, were all lines to go down to the base."""
        return len(self.xs) - 1, len(self.ys) - 1, self.layers

    @property
    def pattern_key(self) -> tuple:
        """What decides the sparsity pattern: the lines through each plane."""
        return tuple((x.left.tobytes(), y.left.tobytes()) for x, y in self.planes.lines)

    @cached_property
    def cells(self) -> Cells:
        """The hexahedra that are solved."""
        return self.planes.cells()

    @cached_property
    def hanging(self) -> Hanging:
        """The nodes that move with wide hexahedra."""
        return self.planes.hanging()

    @cached_property
    def heights(self) -> np.ndarray:
        """Relative heights (nz + 1,) of the planes of nodes, 0 at the base and 1 at the top."""
        # of a column that goes through all planes: nodes that hang lie on flat faces, a little beside their plane
        x, y = (lines.left for lines in self.planes.lines[0])
        through = np.flatnonzero(y[:, None] & x)
        column = self.nodes[through[len(through) // 2] :: len(self.xs) * len(self.ys), 2]
        return (column - column[0]) / (column[-1] - column[0])


@dataclass(frozen=True)
class FineBox:
    """Part of the gel, seen from above, that needs small hexahedra of side about `size`; all mm."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    size: float


def graded_lines(
    low: float, high: float, fine_low: float, fine_high: float, size: float, growth: float = 1.5, largest: float = 2.0
) -> np.ndarray:
    """Mesh lines (n + 1,) on [low, high]: cells of about `size` on the fine part, growing outwards up to `largest`, all mm.

    growth: how many times as wide as its inner neighbour a cell is. BadInput where the fine part lies beside [low, high].
    """
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
    """Growing offsets (k,) that end exactly at `distance`, mm; size: of the cell from which they grow."""
    if distance < 0.5 * size:
        return np.array([distance]) if distance > 1e-9 else np.empty(0)
    sizes: list[float] = []
    while sum(sizes) < distance:
        size = min(size * growth, largest)
        sizes.append(size)
    if len(sizes) > 1 and sum(sizes) - distance > distance - sum(sizes[:-1]):
        sizes.pop()
    return np.cumsum(sizes) * (distance / sum(sizes))


def dissected(cuts_x: np.ndarray, cuts_y: np.ndarray) -> np.ndarray:
    """Order in which the columns of a grid are eliminated, x fastest in their numbers: nested dissection.

    George 1973, SIAM J. Numer. Anal. 10, 345-363: both halves before the line that parts them. cuts_x, cuts_y: (nx,),
    (ny,) bool, the lines that may part it: a line that ended half-way down lies within wide hexahedra.
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
    """The index in [low, high) nearest to its middle at which `cuts` (n,) allows a cut; None where none does."""
    allowed = np.flatnonzero(cuts[low:high]) + low
    return int(allowed[np.argmin(np.abs(allowed - (low + high) // 2))]) if len(allowed) else None


def elimination_order(mesh: "HexMesh") -> np.ndarray:
    """Order (unknowns,) for a direct solver: whole columns of nodes by nested dissection of the plane.

    The unknowns are 3 a node of `mesh.unknown`.
    """
    plane = len(mesh.xs) * len(mesh.ys)
    # a line that ends on the way down lies within wide hexahedra: only those that reach the base part the gel
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
    """How many layers, and their ratio (see `layer_heights`), where the uppermost is `thickest` at most; mm.

    As given where they are thin enough on a gel of that height. Else each layer is thicker than the one above by one
    factor, and there are more of them where that would be more than `growth`.
    """
    heights = layer_heights(layers, ratio)
    if (1.0 - heights[-2]) * height <= thickest:
        return layers, ratio
    thicknesses = height / thickest  # all, in units of the uppermost
    while (growth ** np.arange(layers)).sum() < thicknesses:
        layers += 1
    roots = np.roots([*np.ones(layers - 1), 1.0 - thicknesses])
    factor = roots[np.abs(roots.imag) < 1e-9].real.max()
    # few digits, because the ratio is part of a mesh's name
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
    """hexahedral mesh of the gel, fine in `box`; in the lowest layers hexahedra are wider (see stepped.planes_of).

    layers, layer_ratio: as in `layer_heights`. growth, largest: as in `graded_lines`. BadInput where the box lies beside
    the gel.
    """
    half = gel.width / 2, gel.length / 2
    xs = graded_lines(-half[0], half[0], box.x_min, box.x_max, box.size, growth, largest)
    ys = graded_lines(-half[1], half[1], box.y_min, box.y_max, box.size, growth, largest)
    planes = planes_of(xs, ys, layers, widened, (box.x_min, box.x_max, box.y_min, box.y_max))
    return mesh_on_lines(gel, xs, ys, layer_heights(layers, layer_ratio), planes)


def mesh_on_lines(
    gel: Gel, xs: np.ndarray, ys: np.ndarray, heights: np.ndarray, planes: Planes | None = None
) -> HexMesh:
    """hexahedral mesh on given lines: xs, ys in mm, heights relative from 0 at the base to 1 at the top.

    planes: which lines go through each of the heights; all by default.
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
    """Map places x, y (...) mm of a rectangle smoothly onto one with rounded corners (identity but for the corner squares).

    The elliptical map of the unit square onto a quarter disc, u = s sqrt(1 - t^2 / 2) (Fong 2015, Analytical
    Methods for Squaring the Disc, arXiv:1509.06344).
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


NARROW = 0.8  # of the hexahedra across a whole contact must lie across its parts
SMALLEST = 0.15  # mm, of hexahedra made smaller for a small contact
# A contact under TINY mm across is looked at with POINTS points across, and at least FEWEST hexahedra are, however small:
# three of them make the force on a cone's tip a tenth too large. MARGIN of them are small around it.
TINY, POINTS, FEWEST, MARGIN = 1.2, 40, 6, 5
SPACING = 0.2  # mm between the points at which other contacts are looked at
AROUND = 0.5  # mm of small hexahedra around what is touched, whose box is rounded outwards to multiples of it


def fine_box(scene: Scene, size: float, across: int = 0) -> FineBox:
    """Part of the gel that the press can touch, rounded outwards so that presses share meshes.

    The undeformed surface inside the indenter anywhere on the path, and AROUND mm around it, less around a contact under
    TINY mm across. Hexahedra
    are of `size`, or smaller where the shorter side of what is touched is under `across` hexahedra, or its parts are narrow.
    """
    smallest, around = SMALLEST, AROUND
    points, shape = touch.under_path(scene.gel, scene.indenter, scene.press, SPACING)
    inside = touch.touched(scene.indenter, scene.press, points)
    if across and inside.any() and np.ptp(points[inside, :2], axis=0).max() < TINY:
        low, high = points[inside, :2].min(axis=0) - SPACING, points[inside, :2].max(axis=0) + SPACING
        points, shape = touch.top_points(scene.gel, low, high, float((high - low).max()) / POINTS)
        inside = touch.touched(scene.indenter, scene.press, points)
        if inside.any():
            smallest = min(smallest, max(0.01, float(np.ptp(points[inside, :2], axis=0).max()) / FEWEST))
            around = min(around, float(np.round(MARGIN * smallest, 2)))
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
    gel = scene.gel
    half = np.array([gel.width / 2, gel.length / 2])
    low = np.maximum(np.floor((met.min(axis=0) - around) / around) * around, -half)
    high = np.minimum(np.ceil((met.max(axis=0) + around) / around) * around, half)
    return FineBox(float(low[0]), float(high[0]), float(low[1]), float(high[1]), size)
