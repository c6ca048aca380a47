"""Force against depth and friction, from a handful of finite element solves.

Force is proportional to C10 at fixed D1*C10 when the indenter is rigid and its path prescribed, so
C10 needs no solve. What is tabulated is the force at REFERENCE_C10 on a fine grid of depth and
friction; a table is interpolated linearly, which makes the rig's compliance an exact inversion.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from gelforge.errors import BadInput
from gelforge.mechanics.material import REFERENCE_C10

DEPTHS = 161
FRICTIONS = 33
HALF_MU = 0.5  # the friction coefficient in the middle of the axis


def friction_axis(mu) -> np.ndarray:
    """Map a friction coefficient in [0, inf] to the axis along which forces change evenly, [0, 1]: mu / (mu + HALF_MU)."""
    mu = np.asarray(mu, float)
    return np.where(np.isinf(mu), 1.0, mu / (np.where(np.isinf(mu), 1.0, mu) + HALF_MU))


def friction_of(axis) -> np.ndarray:
    """Friction coefficient at positions in [0, 1) of the axis."""
    return HALF_MU * axis / (1.0 - axis)


@dataclass(frozen=True)
class Curve:
    """Contact force at REFERENCE_C10 along the depth of one press, from converged load steps.

    depth: (k,) mm, increasing. force: (k, 3) N on the gel, at the end of the path from that depth.
    """

    depth: np.ndarray
    force: np.ndarray


@dataclass(frozen=True)
class Emulator:
    """Tables for n presses.

    table: (n, FRICTIONS, DEPTHS, 3) N at REFERENCE_C10. top: (n,) mm, deepest tabulated depth.
    group: (n,) index of each press's indenter. travel: (n,) mm that a press moves sideways.
    """

    table: np.ndarray
    top: np.ndarray
    group: np.ndarray
    travel: np.ndarray

    def forces(self, depth, values: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces (w, n, 3) N, slopes (w, n, 3) N per mm, and effective depths (w, n) mm, for w parameter sets.

        depth: (n,) commanded depth, mm. values: arrays (w,) by name (parameters.NAMES). The
        effective depth is commanded + offset - compliance * |normal force|, solved exactly; slopes
        are with respect to the commanded depth. Beyond the table the last slope goes on. A frame that yields sideways
        takes shear_compliance * |sideways force| of the travel.
        """
        from gelforge.calibration.kernel import evaluate

        error = np.exp(values["discretisation"][:, None] + values["indenter"][:, self.group])
        scale = values["c10"][:, None] / REFERENCE_C10 * error
        axis = friction_axis(values["mu"]) * (FRICTIONS - 1)
        return evaluate(
            self.table, self.top, np.asarray(depth, float), self.travel, scale, values["offset"],
            values["compliance"], values["shear_compliance"], axis,
        )  # fmt: skip

    def take(self, rows) -> "Emulator":
        """The emulator of some of the presses."""
        return Emulator(self.table[rows], self.top[rows], self.group[rows], self.travel[rows])


def curve_table(curve: Curve, top: float) -> np.ndarray:
    """Force (DEPTHS, 3) on the uniform grid from 0 to `top` of one curve.

    The normal force is a monotone cubic in the square root of depth, in which both a sphere's d^1.5
    and a punch's d are gentle; shear is interpolated as its ratio to the normal force.
    """
    grid = np.linspace(0.0, top, DEPTHS)
    touching = np.abs(curve.force[:, 2]) > 0
    if not touching.any():
        return np.zeros((DEPTHS, 3))
    first = max(int(np.argmax(touching)) - 1, -1)
    touch = curve.depth[first] if first >= 0 else 0.0
    depth, force = curve.depth[first + 1 :], curve.force[first + 1 :]
    x = np.concatenate([[0.0], np.sqrt(depth - touch)])
    fz = np.concatenate([[0.0], force[:, 2]])
    at = np.sqrt(np.clip(grid - touch, 0.0, None))
    normal = PchipInterpolator(x, fz)(at) if len(x) > 2 else np.interp(at, x, fz)
    ratio = np.stack([np.interp(grid, depth, force[:, i] / force[:, 2]) for i in (0, 1)], axis=1)
    return np.column_stack([ratio * normal[:, None], normal])


def sheared_table(press: np.ndarray, top: float, depths, forces) -> np.ndarray:
    """Force (DEPTHS, 3) after shear, from the table before it and a few solves with shear.

    press: (DEPTHS, 3) of the press alone. depths: (k,), forces: (k, 3) at the end of the sheared path.
    With the sideways travel fixed, each component over the normal force of the press alone is
    a + b / depth in every limit: full stick of a sphere or a punch (the tangential stiffness goes as
    the normal one, Mindlin 1949), full slip, and a tilted surface. So it is interpolated linearly in
    1 / depth and held constant beyond the solves.
    """
    grid = np.linspace(0.0, top, DEPTHS)
    depths, forces = np.asarray(depths, float), np.asarray(forces, float)
    order = np.argsort(-depths)
    depths, forces = depths[order], forces[order]
    normal = np.interp(depths, grid, press[:, 2])
    if (normal == 0).any():
        raise BadInput("a press with shear does not touch the gel at one of its emulated depths")
    ratio = forces / normal[:, None]
    at = 1.0 / np.maximum(grid, 1e-9)
    return np.stack([np.interp(at, 1.0 / depths, ratio[:, i]) for i in range(3)], axis=1) * press[:, 2:3]


def friction_table(nodes, tables) -> np.ndarray:
    """Tables (FRICTIONS, DEPTHS, 3) on the uniform friction axis from those at the friction `nodes`.

    nodes: (m,) coefficients, first 0, last inf where all laws are needed. One node gives a constant.
    """
    axis = friction_axis(nodes)
    tables = np.asarray(tables)
    if len(axis) == 1:
        return np.repeat(tables, FRICTIONS, axis=0)
    fine = np.linspace(0.0, 1.0, FRICTIONS)
    return PchipInterpolator(axis, tables, axis=0)(np.clip(fine, axis[0], axis[-1]))
