"""Force against depth and friction, from a handful of finite element solves.

Force is proportional to C10 at fixed D1*C10 when the indenter is rigid and its path prescribed, so
C10 needs no solve. What is tabulated is the force at REFERENCE_C10 on a fine grid of depth and
friction; a table is interpolated linearly, which makes the rig's compliance an exact inversion.
"""

from collections.abc import Callable
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
        from gelforge.calibration.kernel import Walkers, evaluate

        error = np.exp(values["discretisation"][:, None] + values["indenter"][:, self.group])
        scale = values["c10"][:, None] / REFERENCE_C10 * error
        axis = friction_axis(values["mu"]) * (FRICTIONS - 1)
        walkers = Walkers(scale, values["offset"], values["compliance"], values["shear_compliance"], axis)
        return evaluate(self.table, self.top, np.asarray(depth, float), self.travel, walkers)

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


def sheared_table(alone: np.ndarray, top: float, nodes, ends, depths, stuck) -> np.ndarray:
    """Forces (FRICTIONS, DEPTHS, 3) after shear, from those of the press alone and a few solves with shear.

    alone: (FRICTIONS, DEPTHS, 3), from the friction `nodes` (m,), rising. ends: (m, 3) N after shear at the depth `top`.
    stuck: (k, 3) N after shear at the last of the nodes, at `depths` (k,), mm, the first of which is `top`.
    A contact that obeys Coulomb's law is the same when travel and mu are scaled alike (Cattaneo 1938, Mindlin 1949). So what
    friction adds to sideways over normal force at another depth is what it adds at the top at another mu. The factor is
    that by which it grows where nothing slips; there forces over normal force are linear in 1 / depth (of a sphere and of a
    punch the tangential stiffness goes as the normal one). Where that differs from the scaled force, as across the travel
    and in the normal force, the difference counts by how much is dragged along of what is where nothing slips. Beyond the
    solves all is held constant.
    """
    grid = np.linspace(0.0, top, DEPTHS)
    depths, stuck = np.asarray(depths, float), np.asarray(stuck, float)
    normal = np.interp(depths, grid, alone[-1, :, 2])
    if (normal == 0.0).any():
        raise BadInput("a press with shear does not touch the gel at one of its emulated depths")
    pressing = alone[..., 2:] < 0.0
    before = np.divide(alone, alone[..., 2:], out=np.zeros_like(alone), where=pressing)[0]
    at_nodes = np.interp(friction_axis(nodes), np.linspace(0.0, 1.0, FRICTIONS), alone[:, -1, 2])
    added = friction_curve(nodes, np.asarray(ends, float) / at_nodes[:, None] - before[-1])
    order = np.argsort(1.0 / depths)
    deeper = 1.0 / np.maximum(grid, 1e-9)
    sticking = np.stack(
        [np.interp(deeper, 1.0 / depths[order], one) for one in (stuck / normal[:, None])[order].T], axis=1
    )
    held = (sticking - before)[:, :2]
    along = held @ held[-1]
    factor = np.maximum(along / along[-1], 0.1) if along[-1] else np.ones(DEPTHS)
    fine = np.linspace(0.0, 1.0, FRICTIONS)[:, None]
    axis = np.vstack([friction_axis(friction_of(fine[:-1]) / factor), np.ones(DEPTHS)])
    dragged, lifted = factor[:, None] * added(axis)[..., :2], added(fine * np.ones(DEPTHS))[..., 2:]
    scaled = before + np.concatenate([dragged, lifted], axis=2)
    sticks = np.clip(dragged @ held[-1] / along, 0.0, 1.0) if along.all() else fine * np.ones(DEPTHS)
    return (scaled + sticks[..., None] * (sticking - scaled[-1])) * alone[..., 2:]


def friction_curve(nodes, values) -> Callable[[np.ndarray], np.ndarray]:
    """Monotone cubic of `values` (m, …) at friction nodes (m,) as a function of the friction axis; constant beyond its ends."""
    axis, values = friction_axis(nodes), np.asarray(values)
    if len(axis) == 1:
        return lambda at: np.broadcast_to(values[0], (*np.shape(at), *values.shape[1:]))
    return lambda at: PchipInterpolator(axis, values, axis=0)(np.clip(at, axis[0], axis[-1]))


def friction_table(nodes, tables) -> np.ndarray:
    """Tables (FRICTIONS, DEPTHS, 3) on the uniform friction axis from those at the friction `nodes`.

    nodes: (m,) coefficients, first 0, last inf where all laws are needed. One node gives a constant.
    """
    return np.array(friction_curve(nodes, tables)(np.linspace(0.0, 1.0, FRICTIONS)))
