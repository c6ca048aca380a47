"""The gel's deformed surface as smooth fields, and the indenter's underside as a height map."""

from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from gelforge.flow.files import publish
from gelforge.geometry.gel import Gel
from gelforge.geometry.solids import Indenter
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexmesh import surface_lines
from gelforge.records.arrays import Schema, read_arrays
from gelforge.records.press import Press

STEP = 0.1  # mm between the samples of a field
SCHEMA = Schema(
    "a surface of a press", {"xs": ("f", 1), "ys": ("f", 1), "moved": ("f", 3), "press": ("f", 1)}, {"down": ("f", 3)}
)
FAR = 4.0  # mm above the tip; higher parts of the body cannot touch the gel


@dataclass(frozen=True)
class Field:
    """Displacement of the gel's surface on a regular grid, (ny, nx, 3) float32 mm.

    Sample (j, i) lies at x = x0 + i STEP, y = y0 + j STEP of the unloaded surface. down: (ny, nx, 2) float32 mm, the
    in-plane motion due to the way down; None if only its sum with the sideways motion is known.
    """

    values: np.ndarray
    x0: float
    y0: float
    down: np.ndarray | None = None

    def scaled(self, factor: float) -> "Field":
        """The field with the in-plane motion due to the way down scaled; ValueError if `down` is None."""
        if self.down is None:
            raise ValueError("the field does not know what the way down alone has moved")
        values = self.values.copy()
        values[..., :2] += np.float32(factor - 1.0) * self.down
        return replace(self, values=values)


def unloaded(gel: Gel) -> Field:
    """The field of a gel that nothing touches."""
    x, y = _grid(gel)
    shape = len(y), len(x)
    return Field(np.zeros((*shape, 3), np.float32), x[0], y[0], np.zeros((*shape, 2), np.float32))


@dataclass(frozen=True)
class Surface:
    """What an image of a press needs: displacement (ny, nx, 3) mm at the nodes of grid lines xs, ys mm, and the path.

    down: (ny, nx, 2) mm, the in-plane motion at the end of the way down; None if not stored.
    """

    xs: np.ndarray
    ys: np.ndarray
    moved: np.ndarray
    press: Press
    down: np.ndarray | None = None

    def save(self, path) -> None:
        """Write to an .npz file, whole or not at all."""
        with publish(path) as part:
            arrays: dict[str, Any] = {
                "xs": self.xs,
                "ys": self.ys,
                "moved": self.moved,
                "press": np.array(astuple(self.press)),
            }
            if self.down is not None:
                arrays["down"] = self.down
            np.savez_compressed(part, **arrays)

    @classmethod
    def load(cls, path) -> "Surface":
        """Read what `save` wrote; anything else raises BadInput."""
        found = read_arrays(path, SCHEMA, "remove it, and the press is repeated")
        press = Press(*found["press"].tolist())
        return cls(found["xs"], found["ys"], found["moved"], press, found.get("down"))


def surface_of(mesh: GelMesh, displacement: np.ndarray, press: Press, down: np.ndarray | None = None) -> Surface:
    """The surface of a solved press that a camera sees; displacement: (n, 3) mm at the nodes of a hexahedral mesh.

    down: displacement (n, 3) mm at the end of the way down, for a press that then goes sideways.
    """
    xs, ys, first = surface_lines(mesh)

    def seen(values: np.ndarray) -> np.ndarray:
        return values[first : first + len(xs) * len(ys)].reshape(len(ys), len(xs), 3).astype(np.float32)

    moved = seen(displacement)
    if not (press.dx or press.dy):
        return Surface(xs, ys, moved, press, moved[..., :2])
    return Surface(xs, ys, moved, press, None if down is None else seen(down)[..., :2])


def field_of(gel: Gel, surface: Surface) -> Field:
    """Displacement of a surface as a continuously differentiable field.

    Tensor-product cubic Hermite interpolation through the nodes with finite-difference slopes: piecewise linear
    interpolation would show the hexahedra as facets in the shading.
    """
    x, y = _grid(gel)
    along_x, along_y = _interpolation(surface.xs, x), _interpolation(surface.ys, y)

    def smooth(nodal: np.ndarray) -> np.ndarray:
        values = np.einsum("aj,jik->aik", along_y, nodal.astype(float))
        return np.einsum("bi,aik->abk", along_x, values).astype(np.float32)

    return Field(smooth(surface.moved), x[0], y[0], None if surface.down is None else smooth(surface.down))


def _grid(gel: Gel) -> tuple[np.ndarray, np.ndarray]:
    half_x, half_y = gel.width / 2, gel.length / 2
    return np.arange(-half_x, half_x + STEP / 2, STEP), np.arange(-half_y, half_y + STEP / 2, STEP)


def _interpolation(lines: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Matrix (points, lines) of cubic Hermite interpolation."""
    unit = np.eye(len(lines))
    return CubicHermiteSpline(lines, unit, np.gradient(unit, lines, axis=0))(np.clip(points, lines[0], lines[-1]))


@dataclass(frozen=True)
class RoughBody:
    """Underside of an indenter with its printed texture, on a regular grid in its own frame.

    height: (n, n) float32 mm above the tip plane, FAR where there is no underside; bare: the same without texture.
    Sample (j, i) lies at x = -reach + i STEP / 2, y likewise.
    """

    height: np.ndarray
    bare: np.ndarray
    reach: float
    step: float


def body_of(indenter: Indenter, texture_mm: float, pitch_mm: float, angle_deg: float) -> RoughBody:
    """Sample the underside of `indenter` and add the lines that a filament printer leaves.

    Flat faces have parallel lines of pitch `pitch_mm` at `angle_deg`, `texture_mm` deep; inclined ones have the steps
    of the printed layers, half as deep.
    """
    step = STEP / 2
    count = int(np.ceil(min(indenter.radius(), 15.0) / step)) + 2
    axis = np.arange(-count, count + 1) * step
    x, y = np.meshgrid(axis, axis)
    height = _underside(indenter, np.stack([x.ravel(), y.ravel()], axis=1)).reshape(x.shape)
    slope = np.hypot(*np.gradient(height, step))
    angle = np.deg2rad(angle_deg)
    along = (x * np.cos(angle) + y * np.sin(angle)) / pitch_mm
    # filaments are neither quite straight nor of equal height: a slow wobble makes the lines irregular
    wobble = 0.07 * np.sin(1.3 * (x - y) + 0.9) + 0.05 * np.sin(2.1 * y + 0.4)
    lines = np.cos(2 * np.pi * (along + wobble))
    lines *= 0.7 + 0.3 * np.sin(1.1 * x + 1.7) * np.sin(0.9 * y + 0.6) + 0.15 * np.sin(4.1 * along)
    layers = np.cos(2 * np.pi * height / 0.2)
    flat = np.exp(-((slope / 0.05) ** 2))
    inclined = np.clip((slope - 0.05) / 0.1, 0, 1) * np.clip((1.2 - slope) / 0.4, 0, 1)
    textured = height + texture_mm * 0.5 * (flat * (lines - 1.0) + 0.5 * inclined * (layers - 1.0))
    return RoughBody(textured.astype(np.float32), height.astype(np.float32), count * step, step)


def _underside(indenter: Indenter, xy: np.ndarray) -> np.ndarray:
    """Lowest z of the body above each point, at most FAR, by sphere tracing upwards along its distance function."""
    points = np.column_stack([xy, np.full(len(xy), -0.05)])
    open_ = np.arange(len(points))
    for _ in range(200):
        distance, _ = indenter.distance(points[open_])
        points[open_, 2] += np.maximum(distance, 0.0)
        going = (distance > 1e-3) & (points[open_, 2] < FAR)
        open_ = open_[going]
        if not len(open_):
            break
    return np.minimum(points[:, 2], FAR)


def body_position(body: RoughBody, press: Press, x, y) -> tuple[np.ndarray, np.ndarray, float]:
    """Column and row in `body` of gel points (x, y) mm at the end of the path, and the z in mm of its tip plane."""
    turn, tip = press.pose(1.0, 1.0)
    dx, dy = x - tip[0], y - tip[1]
    column = (turn[0, 0] * dx + turn[1, 0] * dy + body.reach) / body.step
    row = (turn[0, 1] * dx + turn[1, 1] * dy + body.reach) / body.step
    return column, row, float(tip[2])
