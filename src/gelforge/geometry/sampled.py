"""Indenters from a user's STL: checked, then held as a smooth grid of distances."""

from functools import cached_property

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry.shells import outer_surface
from gelforge.geometry.solids import Body
from gelforge.geometry.stlfile import read_stl
from gelforge.geometry.triangles import Mesh

MARGIN_MM = 1.0  # of the grid around the body: farther away only the sign and a rough distance matter
LARGEST_MM = 60.0
MOST_POINTS = 6_000_000


def check_body(vertices: np.ndarray, faces: np.ndarray, what: str) -> Mesh:
    """The outer surface of a body that can be pressed; anything else is BadInput naming `what`."""
    extent = np.ptp(vertices, axis=0).max()
    if not 0.5 <= extent <= LARGEST_MM:
        raise BadInput(
            f"{what}: the body measures {extent:.4g} mm after scaling, expected 0.5 to {LARGEST_MM:g} mm; "
            "set `scale` in the catalogue (1000 for a file in metres, 25.4 for inches)"
        )
    vertices, faces = outer_surface(vertices, faces, what)
    aside = np.maximum(vertices.min(axis=0), -vertices.max(axis=0))[:2].max()
    if aside > 0.0:
        raise BadInput(
            f"{what}: the body stands {aside:.4g} mm beside the z axis, on which it is pressed; move it there in the program "
            "that exported it"
        )
    return vertices, faces


class Sampled(Body):
    """A closed surface as a cubic spline of its signed distance on a grid of `spacing` mm up to the height `reach`.

    The error is of the order of the spacing's square over the edge radius; a sharp edge is rounded with about half
    the spacing. Outside the grid the distance is an upper bound, good enough to say that nothing touches.
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

        return spline_filter(
            _distance_grid(self.vertices, self.faces, self._low, self.spacing, self._shape), order=3, mode="mirror"
        )

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


def sampled_from_stl(path, scale=1.0, spacing=0.2, reach=4.0, *, name, **flags) -> Sampled:
    """The indenter that an STL file describes, after the checks of `check_body`."""
    vertices, faces = check_body(*read_stl(path, scale), f"indenter {name}: {path}")
    return Sampled(name, vertices, faces, spacing=spacing, reach=reach, **flags)
