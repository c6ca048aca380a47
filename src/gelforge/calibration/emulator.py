"""Force against depth and friction, from a handful of finite element solves.

Force is proportional to C10 at fixed D1*C10 when the indenter is rigid and its path prescribed, so
C10 needs no solve. The force at REFERENCE_C10 is tabulated on a fine grid of depth and friction and
interpolated linearly, so that the rig's compliance can be inverted exactly.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator, interp1d

from gelforge.calibration.tilts import Tilts
from gelforge.errors import BadInput
from gelforge.mechanics.material import REFERENCE_C10

DEPTHS = 161
FRICTIONS = 33
HALF_MU = 0.5  # the friction coefficient in the middle of the axis
HERTZ = 1.5  # exponent of the depth of a ball in its force (Hertz 1881)


def friction_axis(mu) -> np.ndarray:
    """Map a friction coefficient in [0, inf] to mu / (mu + HALF_MU) in [0, 1], along which forces change evenly."""
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
    group: (n,) index of each press's indenter. travel: (n,) mm, sideways. mounting: (n,) index of its mounting; None:
    all are of one. tilts: responses to tilt; None: no mounting's tilt is a parameter.
    """

    table: np.ndarray
    top: np.ndarray
    group: np.ndarray
    travel: np.ndarray
    mounting: np.ndarray | None = None
    tilts: Tilts | None = None

    def forces(self, depth, values: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces (w, n, 3) N, slopes (w, n, 3) N per mm, and effective depths (w, n) mm, for w parameter sets.

        depth: (n,) commanded depth, mm. values: as of `BenchModel.values`. The
        effective depth is commanded + offset - compliance * |normal force|, solved exactly; slopes
        are with respect to the commanded depth. Beyond the table the last slope is extrapolated. Sideways, the frame
        takes shear_compliance * |sideways force| of the travel. Tilt changes all components alike, by the factor at the
        depth that the press has without it: the difference of both is compliance times what tilt takes of the force.
        """
        from gelforge.calibration.kernel import Walkers, evaluate

        error = np.exp(values["discretisation"][:, None] + values["indenter"][:, self.group])
        scale = values["c10"][:, None] / REFERENCE_C10 * error
        axis = friction_axis(values["mu"]) * (FRICTIONS - 1)
        offset, tilt = (self._of_press(values[name]) for name in ("touch", "tilt"))
        walkers = Walkers(scale, offset, values["compliance"], values["shear_compliance"], axis)
        found = evaluate(self.table, self.top, np.asarray(depth, float), self.travel, walkers)
        if self.tilts is None or not tilt.any():
            return found
        walkers = walkers._replace(scale=scale * self.tilts.factor(tilt, found[2]))
        return evaluate(self.table, self.top, np.asarray(depth, float), self.travel, walkers)

    def centres(self, depth, values: dict) -> np.ndarray:
        """Centre of the force on the gel, (w, n, 2) mm, at effective depths (w, n) mm; nan where it is not known."""
        assert self.tilts is not None, "an emulator without tilts"
        return self.tilts.centres(self._of_press(values["tilt"]), depth)

    def _of_press(self, values: np.ndarray) -> np.ndarray:
        """Values (w, mountings, ...) for each press, (w, n, ...)."""
        index = np.zeros(len(self.top), int) if self.mounting is None else self.mounting
        return np.ascontiguousarray(values[:, index])

    def take(self, rows) -> "Emulator":
        """The emulator of some of the presses."""
        mounting = None if self.mounting is None else self.mounting[rows]
        tilts = None if self.tilts is None else self.tilts.take(rows)
        return Emulator(self.table[rows], self.top[rows], self.group[rows], self.travel[rows], mounting, tilts)


def curve_table(curve: Curve, top: float) -> np.ndarray:
    """Force (DEPTHS, 3) on the uniform grid from 0 to `top` of one curve.

    The logarithm of the normal force is a monotone cubic in that of the depth below first touch, and continues
    straight to lighter presses than the first point: a power of depth, as under a sphere (HERTZ) and under a punch (1).
    Shear is interpolated as its ratio to the normal force.
    """
    grid = np.linspace(0.0, top, DEPTHS)
    touching = curve.force[:, 2] < 0
    if not touching.any():
        return np.zeros((DEPTHS, 3))
    first = int(np.argmax(touching))
    touch = curve.depth[first - 1] if first else 0.0
    depth, force = curve.depth[first:], curve.force[first:]
    at, normal = grid > touch, np.zeros(DEPTHS)
    normal[at] = -power_law(grid[at] - touch, depth - touch, -force[:, 2])
    ratio = np.stack([np.interp(grid, depth, force[:, i] / force[:, 2]) for i in (0, 1)], axis=1)
    return np.column_stack([ratio * normal[:, None], normal])


def power_law(at: np.ndarray, depth: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Force at depths `at`, mm, by PCHIP between the logarithms of points (depth, force), all positive."""
    x, y = np.log(depth), np.log(force)
    if len(x) == 1:
        return force[0] * (at / depth[0]) ** HERTZ
    between = PchipInterpolator(x, y)
    inside = np.clip(np.log(at), x[0], x[-1])
    return np.exp(between(inside) + between(x[0], 1) * np.minimum(np.log(at) - x[0], 0.0))


def stuck_share(mu, ratio: float) -> np.ndarray:
    """Sideways over normal force at friction coefficients `mu`, as a fraction of its `ratio` without slip.

    For a ball on a half-space (Cattaneo 1938, Mindlin 1949): mu / ratio in full slip, 1 without slip.
    """
    s = np.asarray(mu, float) / ratio
    slipping = 1.0 - (1.0 - 2.0 / (3.0 * np.maximum(s, 2.0 / 3.0))) ** 1.5
    return np.where(np.isinf(s), 1.0, np.where(np.isinf(s), 1.0, s) * slipping)


def sheared_table(alone: np.ndarray, top: float, nodes, ends) -> np.ndarray:
    """Forces (FRICTIONS, DEPTHS, 3) after shear, from those of the press alone and a solve with shear at each node.

    alone: (FRICTIONS, DEPTHS, 3) N, before shear. nodes: (m,) friction coefficients, rising, the last without slip.
    ends: (m, 3) N, after shear at the depth `top`. A press that does not touch there raises BadInput.
    A contact under Coulomb's law stays similar if travel and mu are scaled alike (Cattaneo 1938, Mindlin 1949). So
    what shear adds to the ratio of sideways to normal force is linear in `stuck_share` between nodes, and at another
    depth it follows from that at `top` for another mu; without slip it is proportional to 1 / depth, for a sphere and
    for a punch.
    """
    grid = np.linspace(0.0, top, DEPTHS)
    normal = np.interp(friction_axis(nodes), np.linspace(0.0, 1.0, FRICTIONS), alone[:, -1, 2])
    if (normal == 0.0).any():
        raise BadInput("a press with shear does not touch the gel at the depth at which it is emulated")
    pressing = alone[..., 2:] < 0.0
    before = np.divide(alone, alone[..., 2:], out=np.zeros_like(alone), where=pressing)
    at_nodes = np.rint(friction_axis(nodes) * (FRICTIONS - 1)).astype(int)
    added = np.asarray(ends, float) / normal[:, None] - before[at_nodes, -1]
    stuck = float(np.hypot(*added[-1, :2]))
    if stuck == 0.0:
        return (before + np.array([0.0, 0.0, added[-1, 2]])) * alone[..., 2:]
    factor = top / np.maximum(grid, 0.1 * top)
    share = stuck_share(_frictions()[:, None] / factor, stuck)
    at = stuck_share(nodes, stuck)
    dragged = [np.interp(share, np.append(0.0, at), np.append(0.0, values)) * factor for values in added[:, :2].T]
    lifted = np.interp(share, at, added[:, 2])
    return (before + np.stack([*dragged, lifted], axis=2)) * alone[..., 2:]


def sticking(table: np.ndarray) -> np.ndarray:
    """Degree of sticking, 0 (full slip) to 1 (no slip), (FRICTIONS, DEPTHS), from forces (FRICTIONS, DEPTHS, 3).

    It is d ln F / d ln travel of the sideways force F. Under Coulomb's law that is 1 - d ln F / d ln mu, because F
    scales with travel and mu if these are scaled alike (Cattaneo 1938, Mindlin 1949).
    """
    aside = np.log(np.maximum(np.hypot(table[1:-1, :, 0], table[1:-1, :, 1]), 1e-12))
    over_mu = np.gradient(aside, np.log(_frictions()[1:-1]), axis=0)
    ends = np.zeros((1, table.shape[1]))
    return np.concatenate([ends, np.clip(1.0 - over_mu, 0.0, 1.0), ends + 1.0])


# The normal force lies at the fraction 1 - exp(-(mu / STICKS)^POWER) between its values without friction and without
# slip: for a ball, a block, a bar and a cylinder within 1 % from mu = 0.5 up, within 2 % at 0.2, if solved at 0.25.
STICKS, POWER = 0.27, 1.25


def friction_table(nodes, tables) -> np.ndarray:
    """Tables (FRICTIONS, DEPTHS, 3) on the uniform friction axis from `tables` (m, DEPTHS, 3) at rising `nodes` (m,).

    One node gives a constant. Below the first node the line through first and last is extrapolated.
    """
    tables = np.asarray(tables, float)
    if len(tables) == 1:
        return np.repeat(tables, FRICTIONS, axis=0)
    axis, at = (1.0 - np.exp(-((mu / STICKS) ** POWER)) for mu in (_frictions(), np.asarray(nodes, float)))
    between = interp1d(at, tables, axis=0, bounds_error=False, fill_value=(tables[0], tables[-1]))(axis)
    below = axis < at[0]
    slope = (tables[-1] - tables[0]) / (at[-1] - at[0])
    between[below] = tables[0] + (axis[below] - at[0])[:, None, None] * slope
    return between


def _frictions() -> np.ndarray:
    """The friction coefficients of a table, (FRICTIONS,), from 0 to inf."""
    return np.append(friction_of(np.linspace(0.0, 1.0, FRICTIONS)[:-1]), np.inf)
