"""Indenters from a user's STL: checked, then stored as a spline of the signed distance on a grid."""

import sys
from functools import cached_property
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import digest_of, digest_of_value, kept
from gelforge.geometry.shells import outer_surface
from gelforge.geometry.solids import Body
from gelforge.geometry.standing import cut_at, standing
from gelforge.geometry.stlfile import read_stl
from gelforge.geometry.triangles import Mesh, volume

MARGIN_MM = 1.0  # of the grid around the body: farther away only the sign and a rough distance matter
LEAST_MM, LARGEST_MM = 0.5, 60.0  # largest extent of a body
MOST_POINTS = 6_000_000
LOOKED_AT_MM, MOST_LOST = 0.2, 0.4  # height of a section above the tip, and fraction of it that the grid may lose
MOST_LOOKED_AT = 250_000  # sample points of that section
INCH_MM, METRE_MM = 25.4, 1000.0
MEASURED = 1  # version: raise it when surfaces or distance grids change, so that cached ones are recomputed


def check_body(vertices: np.ndarray, faces: np.ndarray, what: str) -> Mesh:
    """The outer surface of a body that can be pressed; any other body raises BadInput naming `what`."""
    if not LEAST_MM <= np.ptp(vertices, axis=0).max() <= LARGEST_MM:
        raise BadInput(
            f"{what}: the body measures {size_of(vertices)} after scaling, expected {LEAST_MM:g} to {LARGEST_MM:g} mm along"
            " its longest side; set `scale` in the catalogue (1000 for a file in metres, 25.4 for inches)"
        )
    vertices, faces = outer_surface(vertices, faces, what)
    aside = np.maximum(vertices.min(axis=0), -vertices.max(axis=0))[:2].max()
    if aside > 0.0:
        raise BadInput(
            f"{what}: the body stands {aside:.4g} mm beside the z axis, on which it is pressed; move it there in the program "
            "that exported it"
        )
    return vertices, faces


def size_of(vertices: np.ndarray) -> str:
    """The extents of a body along x, y and z, for messages."""
    return " x ".join(f"{extent:.3g}" for extent in np.ptp(vertices, axis=0)) + " mm"


class Sampled(Body):
    """A closed surface as a cubic spline of its signed distance on a grid of `spacing` mm up to the height `reach`.

    The error is of the order of spacing^2 / edge radius; a sharp edge stays sharp where it lies on points of the
    grid, and is rounded with up to 0.6 of the spacing elsewhere (boxes of 8.00 to 8.17 mm). Outside the grid, where
    nothing touches, the distance is only an upper bound. Too many grid points raise BadInput.
    """

    def __init__(self, name, vertices, faces, spacing=0.2, reach=4.0, **flags):
        vertices = vertices - [0.0, 0.0, vertices[:, 2].min()]
        super().__init__(name, vertices[:, 2].max(), **flags)
        self.vertices, self.faces = vertices, faces
        low, high = vertices.min(axis=0) - MARGIN_MM, vertices.max(axis=0) + MARGIN_MM
        high[2] = min(high[2], reach + MARGIN_MM)
        self.spacing, self._low = float(spacing), low
        self._shape = np.ceil((high - low) / spacing).astype(int) + 3
        if self._shape.prod() > MOST_POINTS:
            raise BadInput(
                f"indenter {name}: spacing {spacing} mm makes {self._shape.prod()} grid points; "
                "choose a coarser `spacing` or a smaller `reach`"
            )

    @cached_property
    def _coefficients(self) -> np.ndarray:
        from scipy.ndimage import spline_filter

        field = _distance_grid(self.vertices, self.faces, self._low, self.spacing, self._shape)
        self.__dict__["_coefficients"] = found = spline_filter(field, order=3, mode="mirror")
        if (lost := self._lost(min(LOOKED_AT_MM, self.height / 2.0))) > MOST_LOST:
            raise BadInput(
                f"indenter {self.name}: near its lowest point its walls are too thin for spacing = {self.spacing:g} mm: the"
                f" distance grid loses {lost:.0%} of its section; give a `spacing` of half the wall thickness or less"
            )
        return found

    def _lost(self, height: float) -> float:
        """Fraction of the body's section at a height (mm) above its lowest point that the sampled distance misses."""
        section = cut_at((self.vertices, self.faces), height)
        low, high = section.low - 2.0 * self.spacing, section.high + 2.0 * self.spacing
        step = max(self.spacing / 4.0, float(np.sqrt(np.prod(high - low) / MOST_LOOKED_AT)))
        x, y = (np.arange(start, end, step) for start, end in zip(low, high, strict=True))
        places = np.stack([*(axis.ravel() for axis in np.meshgrid(x, y)), np.full(len(x) * len(y), height)], axis=1)
        return 1.0 - np.count_nonzero(self.distance(places)[0] < 0.0) * step**2 / section.area

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3)."""
        points = np.asarray(points, float)
        c, h, n = self._coefficients, self.spacing, self._shape
        at = np.clip((points - self._low) / h, 1.0, n - 2.0 - 1e-9)
        cell = at.astype(int)
        w, dw = _basis(at - cell)
        index = cell[:, :, None] + np.arange(-1, 3)
        block = c[index[:, 0, :, None, None], index[:, 1, None, :, None], index[:, 2, None, None, :]]
        along_z, slope_z = (np.einsum("nabc,nc->nab", block, k[:, 2]) for k in (w, dw))
        yz, y_slope, z_slope = (
            np.einsum("nab,nb->na", m, k[:, 1]) for m, k in ((along_z, w), (along_z, dw), (slope_z, w))
        )
        value = np.einsum("na,na->n", yz, w[:, 0])
        gradient = (
            np.column_stack(
                [
                    np.einsum("na,na->n", yz, dw[:, 0]),
                    np.einsum("na,na->n", y_slope, w[:, 0]),
                    np.einsum("na,na->n", z_slope, w[:, 0]),
                ]
            )
            / h
        )
        return self._beyond(points, at, value, gradient)

    def _beyond(self, points, at, value, gradient):
        away = points - (self._low + at * self.spacing)
        away[:, 2] = np.minimum(away[:, 2], 0.0)
        far = np.linalg.norm(away, axis=1)
        out = far > 1e-6
        gradient[out] = away[out]
        length = np.linalg.norm(gradient, axis=1)
        flat = length < 1e-9
        gradient[flat], length[flat] = [0.0, 0.0, 1.0], 1.0
        return value + far, gradient / length[:, None]

    @property
    def _surface(self) -> tuple[np.ndarray, np.ndarray]:
        """The file's own triangles, lowest point on z = 0: vertices (v, 3) mm and faces (f, 3)."""
        return self.vertices, self.faces

    def radius(self) -> float:
        """Largest horizontal distance from the z axis, mm."""
        return float(np.hypot(*self.vertices[:, :2].T).max())


def notes_of(body: Body) -> list[str]:
    """How a body from a file stands, and doubts about it; empty for other bodies, which their tables describe."""
    if not isinstance(body, Sampled):
        return []
    found = standing(body.vertices, body.faces)
    return [found.touches, *found.doubts]


def _basis(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cubic B-spline weights and their derivatives at offsets t (n, 3) in a cell: (n, 3, 4) each."""
    u = 1.0 - t
    w = np.stack([u**3, 4.0 - 3.0 * t * t * (2.0 - t), 4.0 - 3.0 * u * u * (2.0 - u), t**3], axis=-1) / 6.0
    dw = np.stack([-u * u, t * (3.0 * t - 4.0), u * (4.0 - 3.0 * u), t * t], axis=-1) / 2.0
    return w, dw


def _distance_grid(vertices, faces, low, spacing, shape) -> np.ndarray:
    """Signed distances to a closed surface on a regular grid (VTK's closest triangle)."""
    import pyvista

    body = pyvista.PolyData.from_regular_faces(vertices, faces)
    grid = pyvista.ImageData(dimensions=shape, spacing=(spacing,) * 3, origin=low)
    field = grid.compute_implicit_distance(body)["implicit_distance"]
    return np.asarray(field, float).reshape(shape, order="F")


def sampled_from_stl(
    path: Path, scale=1.0, spacing=0.2, reach=4.0, *, name, folder: Path | None = None, **flags
) -> Sampled:
    """The indenter that an STL file describes, after the checks of `check_body`.

    folder: cache of sampled files, by content, because a fine file takes minutes. One process samples a file while
    others wait for it.
    """
    how = {"spacing": spacing, "reach": reach, **flags}

    def measure() -> Sampled:
        vertices, faces = read_stl(path, scale)
        body = Sampled(name, *check_body(vertices, faces, f"indenter {name}: {path}"), **how)
        body.distance(np.zeros((1, 3)))  # raises BadInput if walls are too thin
        mirrored = (
            "its faces point inward, as where the file was mirrored: compare it with the body, and mirror it back"
        )
        for line in [*notes_of(body), *[mirrored] * (volume(vertices, faces) < 0.0)]:
            print(f"note: indenter {name}: {path}: {line}", file=sys.stderr)
        return body

    def read(file: Path) -> Sampled:
        with np.load(file) as found:
            body = Sampled(name, found["vertices"], found["faces"], **how)
            body._coefficients = found["coefficients"]
        return body

    def write(file: Path, body: Sampled) -> None:
        np.savez(file, vertices=body.vertices, faces=body.faces, coefficients=body._coefficients)

    if folder is None:
        return measure()
    key = digest_of_value([MEASURED, digest_of(path), scale, spacing, reach])[:20]
    return kept(folder / f"{key}.npz", read, measure, write)
