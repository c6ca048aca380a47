"""The user's gels from workflow/gels.toml: pads given by dimensions, or a closed STL with its bonded face named."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import digest_of, read_toml
from gelforge.flow.schema import Number, ParameterTable, Place, Within, parse
from gelforge.geometry.gel import Gel, catalogue, is_free
from gelforge.geometry.stlfile import read_stl
from gelforge.geometry.triangles import is_watertight, volume

Base = Literal["-x", "+x", "-y", "+y", "-z", "+z"]
BASES = get_args(Base)
THINNEST_MM = 0.3  # least thickness of a gel anywhere
LEAST_RADIUS_MM = 0.2  # of the outline's corners: meshes cannot follow sharper ones
RASTER_MM = 0.1  # spacing of the height map of an STL's top
MOST_APART = 0.02  # largest difference in volume between an STL and the pad made from it, over the STL's
LEAST_FILLED = 0.8  # fraction of its bounding rectangle that an STL's bonded face must fill
Size = Annotated[Number, Within(0.5, 100.0, "mm")]
Drop = Annotated[Number, Within(0.0, 20.0, "mm")]


@dataclass(frozen=True)
class Pad(Gel):
    """A pad given by dimensions: a dome that falls by `sag` to where the edges begin, then circular arcs to `rim`."""

    def _dome(self, x, y):
        if self.sag == 0.0:
            flat = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
            return flat, flat, flat
        return super()._dome(x, y)

    def _fall(self, t, span, z, slope):
        return (
            super()._fall(t, span, z, slope)
            if span > 0.0
            else np.zeros(np.broadcast_shapes(np.shape(t), np.shape(z)))
        )

    FITTED: ClassVar[float] = 0.0

    def _edge(self, ring: np.ndarray) -> np.ndarray:
        return self.top(*ring.T)


@dataclass(frozen=True)
class SolidPad(Gel):
    """A pad whose top is that of an STL, bonded on the face `base`; sha256: of the file's content."""

    file: str = ""
    base: str = "-z"
    scale: float = 1.0
    sha256: str = ""

    def top(self, x, y) -> np.ndarray:
        """Height z of the undeformed top at (x, y), mm, by linear interpolation of a height map (RASTER_MM)."""
        from scipy.ndimage import map_coordinates

        xs, ys, z = _solid(self.file, self.base, self.scale, self.sha256).heights
        at = [(np.asarray(v, float) - lines[0]) / (lines[1] - lines[0]) for v, lines in ((x, xs), (y, ys))]
        return map_coordinates(z, np.broadcast_arrays(*at), order=1, mode="nearest")

    def surface(self, _size_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """Triangles of the solid as its file has them: vertices (v, 3) mm in the gel frame, faces (f, 3)."""
        found = _solid(self.file, self.base, self.scale, self.sha256)
        return found.vertices, found.faces


class PadTable(ParameterTable):
    """A table of gels.toml that describes a pad; lengths in mm."""

    width: Size
    length: Size
    thickness: Annotated[Number, Within(0.5, 20.0, "mm")]
    corner_radius: Annotated[Number, Within(LEAST_RADIUS_MM, 50.0, "mm")]
    apex: Drop = 0.0
    edge_width: Drop = 0.0
    edge_drop: Drop = 0.0

    def fault(self) -> str | None:
        """Why corners, edges or dome do not fit the pad; None if they do."""
        half = min(self.width, self.length) / 2
        if self.corner_radius > half or self.edge_width >= half:
            return f"corner_radius = {self.corner_radius:g}, edge_width = {self.edge_width:g}: half of the short side is {half:g} mm"
        if self.edge_width and self.edge_drop <= 2 * self.apex:
            return (
                f"edge_drop = {self.edge_drop:g}: edges fall from a dome that is {2 * self.apex:g} mm below its apex in the"
                " corners; give more, or edge_width = 0"
            )
        if self.edge_drop and not self.edge_width:
            return f"edge_drop = {self.edge_drop:g}: give edge_width, too, over which the edges fall so far"
        return None

    def gel(self, name: str) -> Gel:
        """The gel of this table."""
        rim = -self.edge_drop if self.edge_width else -2 * self.apex
        return Pad(
            name, self.width, self.length, self.corner_radius, self.thickness, self.apex,
            self.width / 2 - self.edge_width, self.length / 2 - self.edge_width, 0.0, rim,
        )  # fmt: skip


class SolidTable(ParameterTable):
    """A table of gels.toml: a closed STL, and which of its sides is bonded."""

    file: str
    base: Base
    scale: Annotated[Number, Within(1e-6, 1e6)] = 1.0

    def gel(self, name: str, folder: Path) -> Gel:
        """The gel of this table, whose file lies below `folder`."""
        path, where = folder / self.file, f"{folder}/gels.toml: [{name}] file = {self.file!r}"
        if Path(self.file).is_absolute() or ".." in Path(self.file).parts:
            raise BadInput(f"{where}: copy the file into {folder} and give its path from there, without `..`")
        if not path.is_file():
            raise BadInput(f"{where}: there is no file {path}; put it there, or correct its name")
        sha256 = digest_of(path)
        found = _solid(str(path), self.base, self.scale, sha256)
        return SolidPad(
            name, found.width, found.length, found.radius, found.height, 0.0, rim=float(found.heights[2].min()),
            file=str(path), base=self.base, scale=self.scale, sha256=sha256,
        )  # fmt: skip


def names_in(path: Path) -> list[str]:
    """Names of a catalogue's gels, none where there is no such file."""
    return list(_tables(path, path.stat().st_mtime_ns)) if path.is_file() else []


def refuse_taken(name: str) -> None:
    """Raise BadInput for a catalogue table with a reserved name (built-in, or with thickness): it is never read."""
    path = catalogue()
    if path and not is_free(name) and name in names_in(path):
        raise BadInput(
            f"{path}: [{name}]: this name is reserved (a built-in gel, or ending in a thickness); choose another name"
        )


def gel_of(path: Path, name: str) -> Gel:
    """A gel of a catalogue; a faulty table raises BadInput."""
    table, place = _tables(path, path.stat().st_mtime_ns)[name], Place(str(path), (name,))
    if not isinstance(table, dict):
        raise BadInput(f"{path}: {name}: give a table, as [{name}] with its keys below")
    if "file" in table:
        gel = parse(SolidTable, table, place).gel(name, path.parent)
    else:
        gel = parse(PadTable, table, place).gel(name)
    return _checked(gel, f"{path}: [{name}]")


@lru_cache(4)
def _tables(path: Path, _time: int) -> dict:
    return read_toml(path)


def _checked(gel: Gel, where: str) -> Gel:
    """The gel; BadInput if its top rises above the apex or is closer than THINNEST_MM to the base."""
    x, y = (np.linspace(-side / 2, side / 2, 101) for side in (gel.width, gel.length))
    with np.errstate(invalid="ignore"):
        top = np.asarray(gel.top(x[:, None], y[None]))
    if not np.isfinite(top).all() or top.max() > 1e-6:
        raise BadInput(f"{where}: its edges cannot continue the slope of the dome; give less apex, or more edge_drop")
    if top.min() + gel.height < THINNEST_MM:
        left = top.min() + gel.height
        raise BadInput(
            f"{where}: is {left:.3g} mm thick at its thinnest, {THINNEST_MM:g} are needed; give more thickness"
        )
    return gel


@dataclass(frozen=True)
class _Solid:
    """An STL in the gel frame: triangles, dimensions in mm, and heights (xs, ys, z (x, y)) of its top."""

    vertices: np.ndarray
    faces: np.ndarray
    width: float
    length: float
    height: float
    radius: float
    heights: tuple[np.ndarray, np.ndarray, np.ndarray]


@lru_cache(4)
def _solid(file: str, base: str, scale: float, _sha256: str) -> _Solid:
    vertices, faces = read_stl(file, scale)
    if not is_watertight(faces):
        raise BadInput(f"{file}: the surface is not closed; close its holes in the program that exported it")
    if volume(vertices, faces) < 0.0:
        faces = faces[:, ::-1]
    vertices = vertices @ _upright(base).T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = vertices - [*(low + high)[:2] / 2, high[2]]
    (width, length, height), base_z = high - low, low[2] - high[2]
    _check_unit(file, sorted([float(width), float(length), float(height)]))
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    bonded = (np.abs(corners[..., 2] - base_z) < 1e-3 * height).all(axis=1)
    area = float(-0.5 * cross[bonded, 2].sum())
    if area < LEAST_FILLED * width * length:
        raise BadInput(
            f"{file}: its side {base} is not a flat base: only {area / (width * length):.0%} of its {width:.4g} x {length:.4g} mm is"
            f" flat; name the side that is bonded, one of {', '.join(BASES)}"
        )
    radius = float(max(LEAST_RADIUS_MM, np.sqrt(max(0.0, width * length - area) / (4.0 - np.pi))))
    heights = _heights(corners[cross[:, 2] > 0.0], width, length)
    made = _volume_of(Gel("", width, length, min(radius, width / 2, length / 2), height), heights)
    own = abs(volume(vertices, faces))
    if abs(made - own) > MOST_APART * own:
        raise BadInput(
            f"{file}: encloses {own:.4g} mm^3, the pad of its outline and top {made:.4g}: gels are rectangles with rounded"
            " corners, upright sides and one height at each place"
        )
    return _Solid(vertices, faces, float(width), float(length), float(height), radius, heights)


def _check_unit(file: str, sides: list[float]) -> None:
    """Raise BadInput for a solid whose size is implausible for a gel: STL files state no unit."""
    low, high = 0.5, 100.0  # mm, as for the sides of a pad (Size)
    if low <= sides[0] and sides[-1] <= high:
        return
    said = " x ".join(f"{side:.3g}" for side in sides)
    raise BadInput(
        f"{file}: measures {said} mm, a gel's sides are from {low:g} to {high:g}; an STL states no unit: give scale, the mm per"
        " unit of the file (1000 for metres, 25.4 for inches)"
    )


def _upright(base: str) -> np.ndarray:
    """Rotation (3, 3) that turns the side `base` down."""
    axis = "xyz".index(base[1])
    if base == "-z":
        return np.eye(3)
    if base == "+z":
        return np.diag([1.0, -1.0, -1.0])
    sign = 1.0 if base[0] == "-" else -1.0
    turned = np.zeros((3, 3))
    turned[2, axis] = sign
    turned[axis, 2] = -sign
    turned[1 - axis, 1 - axis] = 1.0
    return turned


def _heights(up: np.ndarray, width: float, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height map on lines xs, ys of the upward triangles (f, 3, 3); gaps get the height of the nearest point."""
    from scipy.ndimage import distance_transform_edt

    xs, ys = (np.linspace(-s / 2, s / 2, int(np.ceil(s / RASTER_MM)) + 1) for s in (width, length))
    z = np.full((len(xs), len(ys)), -np.inf)
    for a, b, c in up:
        i, j = (slice(*np.searchsorted(lines, [min(v) - 1e-9, max(v) + 1e-9])) for lines, v in ((xs, (a[0], b[0], c[0])), (ys, (a[1], b[1], c[1]))))  # fmt: skip
        px, py = xs[i, None] - a[0], ys[None, j] - a[1]
        (ux, uy), (vx, vy) = (b - a)[:2], (c - a)[:2]
        whole = ux * vy - uy * vx
        s, t = (px * vy - py * vx) / whole, (ux * py - uy * px) / whole
        inside = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1.0 + 1e-9)
        z[i, j] = np.where(inside, np.maximum(z[i, j], a[2] + s * (b - a)[2] + t * (c - a)[2]), z[i, j])
    nearest = distance_transform_edt(np.isinf(z), return_distances=False, return_indices=True)
    return xs, ys, np.minimum(z[tuple(nearest)], 0.0)


def _volume_of(outline: Gel, heights: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    """Volume between the heights and the base of a pad with that outline, mm^3."""
    xs, ys, z = heights
    x, y = (0.5 * (lines[1:] + lines[:-1]) for lines in (xs, ys))
    middle = 0.25 * (z[1:, 1:] + z[:-1, 1:] + z[1:, :-1] + z[:-1, :-1])
    inside = outline.inside(x[:, None], y[None])
    return float(((middle + outline.height) * inside).sum() * (xs[1] - xs[0]) * (ys[1] - ys[0]))
