"""The gel pad: outline, top surface, closed surface."""

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, TypeGuard

import numpy as np

from gelforge.errors import BadInput


@dataclass(frozen=True)
class Gel:
    """GelSight Mini gel in the gel frame (mm): apex at the origin, x short side, y long side, z out of the gel.

    Along each axis the dome is a circular arc that falls by `sag` at `sag_x` and at `sag_y`; off the axes
    1 + twist z = (1 + twist z_x) (1 + twist z_y). Beyond the dome, circular arcs tangent to it fall to `rim` on the
    outline. The shape matches the solid published with FEATS (gelsight_mini.step) to 0.002 mm, in the four corners to
    0.02 mm.
    """

    name: str = "gelsight_mini"
    width: float = 20.75  # along x
    length: float = 25.25  # along y
    corner_radius: float = 1.5
    height: float = 4.0
    sag: float = 0.25
    sag_x: float = 7.5354
    sag_y: float = 9.7165
    twist: float = 2.8163
    rim: float = -1.25

    FITTED: ClassVar[float] = 1.0  # weight of the term that was fitted to the solid's rounded corners

    def top(self, x, y) -> np.ndarray:
        """Height z of the undeformed top surface at (x, y), mm, broadcast; outside the outline it is `rim`."""
        x, y = np.broadcast_arrays(np.abs(np.asarray(x, float)), np.abs(np.asarray(y, float)))
        a, b = self.width / 2.0 - self.corner_radius, self.length / 2.0 - self.corner_radius
        z = self._square_top(x, y)
        corner = (x > a) & (y > b)
        if corner.any():
            z = np.array(z)
            z[corner] = self._round_corner(x[corner] - a, y[corner] - b, a, b)
        return z

    def inside(self, x, y) -> np.ndarray:
        """Whether (x, y) lies on or within the outline."""
        return self.edge_distance(x, y) <= 1e-12

    def edge_distance(self, x, y) -> np.ndarray:
        """Signed distance from (x, y) to the outline, mm, negative inside."""
        r = self.corner_radius
        qx = np.abs(np.asarray(x, float)) - self.width / 2.0 + r
        qy = np.abs(np.asarray(y, float)) - self.length / 2.0 + r
        return np.hypot(np.maximum(qx, 0.0), np.maximum(qy, 0.0)) + np.minimum(np.maximum(qx, qy), 0.0) - r

    def outline(self, size_mm: float) -> np.ndarray:
        """Points (k, 2) on the outline, counter-clockwise, at most `size_mm` apart; arcs within 0.01 mm."""
        r, w, h = self.corner_radius, self.width / 2.0, self.length / 2.0
        fine = min(size_mm, 2.0 * np.sqrt(2.0 * r * 0.01))
        angle = np.linspace(0.0, np.pi / 2.0, int(np.ceil(np.pi / 2.0 * r / fine)) + 1)
        points = []
        for turn, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            phi = angle + turn * np.pi / 2.0
            arc = np.column_stack([sx * (w - r) + r * np.cos(phi), sy * (h - r) + r * np.sin(phi)])
            straight = 2.0 * ((w if turn % 2 == 0 else h) - r)
            steps = int(np.ceil(straight / size_mm))
            ahead = np.array([-np.sin(phi[-1]), np.cos(phi[-1])])
            points += [arc, arc[-1] + straight * np.arange(1, steps)[:, None] / steps * ahead]
        outline = np.concatenate(points)
        # straight sides get exact coordinates, so that a triangulation of the outline has no slivers there
        near = np.abs(np.abs(outline) - [w, h]) < 1e-9
        return np.where(near, np.copysign([w, h], outline), outline)

    def surface(self, size_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """Watertight triangles of the undeformed gel, about `size_mm` wide: vertices (v, 3) mm, faces (f, 3)."""
        from scipy.spatial import Delaunay

        if not 0.05 <= size_mm <= self.height:
            raise BadInput(f"size_mm = {size_mm}: the gel's surface needs a size between 0.05 and {self.height} mm")
        ring = self.outline(size_mm)
        plane = np.concatenate([ring, self._grid(size_mm)])
        flat = Delaunay(plane).simplices
        a, b, c = plane[flat].transpose(1, 0, 2)
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        flat = np.where(area[:, None] > 0.0, flat, flat[:, ::-1])[np.abs(area) > 1e-9]
        n, k = len(plane), len(ring)
        layers = int(np.ceil((self.height + self.rim) / size_mm))
        levels = np.linspace(-self.height, self.rim, layers + 1)
        top = np.column_stack([plane, self.top(*plane.T)])
        edge = self._edge(ring)
        top[:k, 2] = edge
        base = np.column_stack([plane, np.full(n, -self.height)])
        walls = [
            np.column_stack([ring, z + (z + self.height) / (self.rim + self.height) * (edge - self.rim)])
            for z in levels[1:-1]
        ]
        starts = [n, *(2 * n + k * i for i in range(layers - 1)), 0]
        faces = [flat, flat[:, ::-1] + n]
        i, j = np.arange(k), (np.arange(k) + 1) % k
        for low, high in pairwise(starts):
            faces += [np.column_stack([low + i, low + j, high + j]), np.column_stack([low + i, high + j, high + i])]
        return np.concatenate([top, base, *walls]), np.concatenate(faces)

    def _edge(self, ring: np.ndarray) -> np.ndarray:
        """Height (k,) of the top's rim at points (k, 2) of the outline, mm."""
        return np.full(len(ring), self.rim)

    def _grid(self, size):
        """Points of a triangular lattice that keep clear of the outline, (m, 2)."""
        nx, ny = int(np.ceil(self.width / size)), int(np.ceil(self.length / (size * np.sqrt(0.75))))
        x = np.linspace(-self.width / 2.0, self.width / 2.0, nx + 1)
        y = np.linspace(-self.length / 2.0, self.length / 2.0, ny + 1)
        gx, gy = np.meshgrid(x, y)
        gx = gx + np.where(np.arange(ny + 1) % 2, self.width / nx / 4.0, -self.width / nx / 4.0)[:, None]
        points = np.column_stack([gx.ravel(), gy.ravel()])
        return points[self.edge_distance(*points.T) < -0.5 * size]

    def _dome(self, x, y):
        """Height (n,) of the dome and its slopes down along x and y."""
        rx, ry = _circle(self.sag_x, self.sag), _circle(self.sag_y, self.sag)
        hx, hy = np.sqrt(rx**2 - x**2), np.sqrt(ry**2 - y**2)
        fx, fy = rx - hx, ry - hy
        z = -(fx + fy - self.twist * fx * fy)
        return z, x / hx * (1.0 - self.twist * fy), y / hy * (1.0 - self.twist * fx)

    def _square_top(self, x, y):
        """The top as if the outline had sharp corners, for x and y not negative."""
        w, h = self.width / 2.0, self.length / 2.0
        z, slope_x, slope_y = self._dome(np.minimum(x, self.sag_x), np.minimum(y, self.sag_y))
        p = self._fall(np.minimum(x, w) - self.sag_x, w - self.sag_x, z, slope_x)
        q = self._fall(np.minimum(y, h) - self.sag_y, h - self.sag_y, z, slope_y)
        return z + (self.rim - z) * (p + q - p * q)

    def _fall(self, t, span, z, slope):
        """Fraction of the drop from the dome's edge to the rim at distance t, on the arc tangent to the dome."""
        drop = z - self.rim
        start = np.arctan(slope)
        radius = np.hypot(span, drop) / (2.0 * np.sin(np.arctan2(drop, span) - start))
        fallen = radius * np.cos(start) - np.sqrt(radius**2 - (np.maximum(t, 0.0) + radius * np.sin(start)) ** 2)
        return np.where(t > 0.0, fallen / drop, 0.0)

    def _round_corner(self, u, v, a, b):
        """Height where the outline is rounded, at offsets (u, v) from the centre (a, b) of the rounding.

        Blends the tops of the two neighbouring sides over the angle; the term in sin 2 phi was fitted to the solid.
        """
        rho, phi = np.minimum(np.hypot(u, v), self.corner_radius), np.arctan2(v, u)
        s = rho / self.corner_radius
        one, other = self._square_top(a + rho, np.full_like(rho, b)), self._square_top(np.full_like(rho, a), b + rho)
        blend = np.sin(phi) ** 2
        return (
            (1.0 - blend) * one + blend * other - self.FITTED * np.sin(2.0 * phi) * s * (1.0 - s) * (0.18 + 0.1 * s)
        )


def _circle(half_chord, sag):
    return half_chord**2 / (2.0 * sag) + sag / 2.0


USUAL_GEL = "gelsight_mini"  # of a sensor that names none
GELS = {USUAL_GEL: Gel()}


THICKNESS = (2.0, 8.0)  # mm, range of a thickness stated in a gel's name
_OF_THICKNESS = re.compile(r"(.+)-(\d+(?:\.\d+)?)mm")


CATALOGUE = "GELFORGE_GELS"  # environment variable with the path of the user's gels: child processes inherit it
_asked: ContextVar[Path | None] = ContextVar("catalogue of gels", default=None)


def catalogue() -> Path | None:
    """The file of the user's gels, None where none was given; none is searched for in the working folder."""
    named = _asked.get() or os.environ.get(CATALOGUE)
    return Path(named) if named else None


@contextmanager
def gels_from(file: Path | str | None) -> Iterator[None]:
    """While the block runs `load_gel` also knows the gels of a file such as workflow/gels.toml; None changes nothing."""
    reset = _asked.set(Path(file).absolute() if file is not None else _asked.get())
    try:
        yield
    finally:
        _asked.reset(reset)


def use_gels_of(workflow: Path | str) -> None:
    """From now on read gels.toml in a workflow folder, in this process and in those that it starts."""
    os.environ[CATALOGUE] = str(Path(workflow).absolute() / "gels.toml")


def load_gel(name: str) -> Gel:
    """The gel of that name: a built-in one, one of the catalogue, or NAME-3.6mm: gel NAME, 3.6 mm thick at its apex.

    An unknown name, a thickness outside THICKNESS or a faulty table raises BadInput.
    """
    if name in GELS:
        return GELS[name]
    from gelforge.geometry.gelcatalogue import gel_of, names_in

    file = catalogue()
    own = names_in(file) if file else []
    match = _OF_THICKNESS.fullmatch(name)
    if match is None and name in own and file:
        return gel_of(file, name)
    if match is None or match[1] not in (*GELS, *own):
        known = ", ".join([*GELS, *own])
        where = (
            f"a table of {file}" if file else "a file such as workflow/gels.toml, which gelforge.solve takes as gels"
        )
        raise BadInput(
            f"gel {name!r} is unknown; known: {known}, each also with a thickness, such as {next(iter(GELS))}-3.6mm; define your own"
            f" gel in {where}"
        )
    low, high = THICKNESS
    if not low <= float(match[2]) <= high:
        raise BadInput(f"gel {name!r}: give a thickness from {low:g} to {high:g} mm")
    return replace(load_gel(match[1]), name=name, height=float(match[2]))


def own_gels(names: Iterable[object]) -> dict[str, Gel]:
    """Gels by name that are from the catalogue or of a stated thickness: the code does not fix their shape."""
    return {name: load_gel(name) for name in sorted({name for name in names if is_gel(name)} - GELS.keys())}


def is_free(name: str) -> bool:
    """Whether a table of the catalogue may have this name: no built-in gel has it, and it states no thickness."""
    return name not in GELS and not _OF_THICKNESS.fullmatch(name)


def gel_shape(gel: Gel) -> dict:
    """Kind and numbers of a gel, and the digest of its file, without names: equal for gels of the same shape."""
    numbers = {key: value for key, value in asdict(gel).items() if key not in ("name", "file")}
    return numbers | {"kind": type(gel).__name__}


def without_thickness(name: str) -> str:
    """The name of a gel without its thickness: gelsight_mini for gelsight_mini-3.6mm."""
    match = _OF_THICKNESS.fullmatch(name)
    return match[1] if match else name


def is_gel(name: object) -> TypeGuard[str]:
    """Whether there is a gel of that name; its table is not checked, an unreadable catalogue raises BadInput."""
    if not isinstance(name, str):
        return False
    from gelforge.geometry.gelcatalogue import names_in

    file = catalogue()
    match = _OF_THICKNESS.fullmatch(name)
    if name not in GELS and (match[1] if match else name) not in (*GELS, *(names_in(file) if file else [])):
        return False
    return match is None or THICKNESS[0] <= float(match[2]) <= THICKNESS[1]
