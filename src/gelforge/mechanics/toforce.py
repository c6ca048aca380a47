"""Press to a normal force: the depth is the root of the force-depth curve that the path of a solve gives.

The first depth comes from the curve of a path on the coarse hexahedra of "draft" without slip, at a tenth of the time of a
solve; the solve there gives its own curve, whose root is the depth of the next one (a secant).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from gelforge.errors import GelforgeError
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.result import Result, Solve
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.status import Status

CLOSE = 0.005  # largest relative error of the force
FIRST_MM = 0.6  # depth below the first touch of the first coarse path
BEYOND = 1.1  # a path is followed to this multiple of the force that it must contain
# Force of a solve over that of the coarse path: 0.88 under flat bodies to 0.96 under balls.
RATIO = 0.93
DEEPEST = 0.6  # of the gel's thickness: largest depth that is tried
MOST_PATHS, MOST_SOLVES = 5, 4


@dataclass(frozen=True)
class DepthCurve:
    """Normal force over depth: depths (n,) mm and forces (n,) N, from the first touch on, both rising."""

    depth: np.ndarray
    force: np.ndarray

    @classmethod
    def of(cls, touch: float, depth: float, path: list[list[float]]) -> "DepthCurve":
        """From load steps [path parameter, fx, fy, fz] of a press of that depth, mm, that touches the gel at `touch`, mm."""
        steps = np.array([(t * depth, -fz) for t, _, _, fz in path if t <= 1.0])
        rising = (steps[:, 1] > 0.0) & (np.diff(np.maximum.accumulate(steps[:, 1]), prepend=0.0) > 0.0)
        return cls(np.append(touch, steps[rising, 0]), np.append(0.0, steps[rising, 1]))

    def depth_of(self, force: float) -> float:
        """Depth, mm, at a normal force, N; beyond the last point by a power law of the depth below the first touch."""
        if force <= self.force[-1]:
            return float(PchipInterpolator(self.force, self.depth)(force))
        below = self.depth - self.depth[0]
        power = np.log(self.force[-1] / self.force[-2]) / np.log(below[-1] / below[-2])
        return float(self.depth[0] + below[-1] * (force / self.force[-1]) ** (1.0 / max(power, 1.0)))

    def ending_at(self, force: float) -> "DepthCurve":
        """The same with all forces in one ratio, so that the last is `force`, N: sideways motion may change it."""
        return replace(self, force=self.force * force / self.force[-1])


def press_to(force: float, scene_at: Callable[[float], Scene], solve: Solve) -> tuple[float, Result]:
    """The depth (mm) at which the solved normal force at the end of a press is `force` (N, above 0), and its result.

    scene_at: the press of a depth, mm. solve: gives its state. The force is met to CLOSE, usually by two solves. Raises
    GelforgeError where the gel does not bear the force, or a press is not solved.
    """
    curve, aim = _coarse(force / RATIO, scene_at), force / RATIO
    for count in range(1, MOST_SOLVES + 1):
        depth = curve.depth_of(aim)
        result = solve(scene_at(depth))
        found = -float(result.total[2])
        if result.status is not Status.OK or found <= 0.0:
            why = result.evidence.get("reason") or result.status.value
            raise GelforgeError(f"the press was not solved at {depth:.3f} mm, where {force:g} N are expected: {why}")
        if abs(found / force - 1.0) <= CLOSE:
            result.evidence["solves_to_force"] = count
            return depth, result
        if path := result.evidence.get("path"):
            curve, aim = DepthCurve.of(curve.depth[0], depth, path).ending_at(found), force
        else:  # CalculiX gives the end alone
            aim *= force / found
    raise GelforgeError(f"no depth was found at which the press has {force:g} N: {found:g} N at {depth:.3f} mm")


def _coarse(force: float, scene_at: Callable[[float], Scene]) -> DepthCurve:
    """The curve of a press straight down on coarse hexahedra, up to a normal force, N, or beyond."""
    solver, deepest = HexSolver(quality("draft")), DEEPEST * scene_at(0.0).gel.height
    start = first_touch(scene_at(deepest))
    if start is None or start >= 1.0:
        raise GelforgeError(f"the indenter does not reach the gel within {deepest:g} mm")
    touch = start * deepest
    depth = min(touch + FIRST_MM, deepest)
    for _ in range(MOST_PATHS):
        scene = scene_at(depth)
        straight = replace(scene, press=replace(scene.press, dx=0.0, dy=0.0), interface=Interface())
        (frame,) = solver.coarse_path([straight])
        if frame is None:
            depth = 0.5 * (touch + depth)
            continue
        curve = DepthCurve.of(touch, depth, frame.curve)
        if curve.force[-1] >= force:
            return curve
        if depth >= deepest:
            break
        depth = min(curve.depth_of(BEYOND * force), deepest, touch + 3.0 * (depth - touch))
    raise GelforgeError(
        f"the gel does not bear {RATIO * force:.4g} N by this indenter: no equilibrium was found up to {depth:.3g} mm; give a smaller force"
    )
