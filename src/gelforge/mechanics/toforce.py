"""Press to a normal force: the depth is the root of the path's force-depth curve, corrected by the solves themselves.

The path on the coarse hexahedra of "draft" gives forces at many depths. Their ratio to the forces of a finer solve depends on
the body and hardly on the depth, so one solve gives the ratio, and the next one has the right force (a secant).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from gelforge.errors import GelforgeError
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.result import Result, Solve
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.status import Status

CLOSE = 0.005  # largest relative error of the force
FIRST_MM = 0.4  # depth below the first touch of the first path
BEYOND = 1.1  # a path is followed to this multiple of the force that it must contain
RATIO = 0.93  # of the force of a solve to that of the coarse path: 0.90 under flat bodies, 0.95 under balls
DEEPEST = 0.6  # of the gel's thickness: largest depth that is tried
MOST_PATHS, MOST_SOLVES = 5, 4


@dataclass(frozen=True)
class DepthCurve:
    """Normal force over depth on the coarse hexahedra: depths (n,) mm and forces (n,) N, from the first touch on."""

    depth: np.ndarray
    force: np.ndarray

    def depth_of(self, force: float) -> float:
        """Depth, mm, at a normal force, N; beyond the last point by a power law of the depth below the first touch."""
        if force <= self.force[-1]:
            return float(PchipInterpolator(self.force, self.depth)(force))
        below = self.depth - self.depth[0]
        power = np.log(self.force[-1] / self.force[-2]) / np.log(below[-1] / below[-2])
        return float(self.depth[0] + below[-1] * (force / self.force[-1]) ** (1.0 / max(power, 1.0)))


def press_to(force: float, scene_at: Callable[[float], Scene], solve: Solve) -> tuple[float, Result]:
    """The depth (mm) at which the solved normal force at the end of a press is `force` (N, above 0), and its result.

    scene_at: the press of a depth, mm. solve: gives its state. The force is met to CLOSE; usually by two solves. Raises
    GelforgeError where the gel does not bear the force, or a press is not solved.
    """
    aim = force / RATIO  # force of the coarse hexahedra at the depth
    curve = _curve(aim, scene_at)
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
        aim *= force / found
    raise GelforgeError(f"no depth was found at which the press has {force:g} N: {found:g} N at {depth:.3f} mm")


def _curve(force: float, scene_at: Callable[[float], Scene]) -> DepthCurve:
    """The curve of a press that contains a normal force, N, of the coarse hexahedra."""
    solver = HexSolver(quality("draft"))
    deepest = DEEPEST * scene_at(0.0).gel.height
    touch = first_touch(scene_at(deepest))
    if touch is None or touch >= 1.0:
        raise GelforgeError(f"the indenter does not reach the gel within {deepest:g} mm")
    start = touch * deepest
    depth = min(start + FIRST_MM, deepest)
    for _ in range(MOST_PATHS):
        scene = scene_at(depth)
        (frame,) = solver.coarse_path([replace(scene, press=replace(scene.press, dx=0.0, dy=0.0))])
        if frame is None:
            break
        steps = np.array([(t * depth, -fz) for t, _, _, fz in frame.curve if t <= 1.0])
        rising = np.append(True, np.diff(steps[:, 1]) > 0.0) & (steps[:, 1] > 0.0)
        curve = DepthCurve(np.append(start, steps[rising, 0]), np.append(0.0, steps[rising, 1]))
        if curve.force[-1] >= force:
            return curve
        if depth >= deepest:
            break
        depth = min(curve.depth_of(BEYOND * force), deepest, start + 3.0 * (depth - start))
    raise GelforgeError(
        f"the gel does not bear {RATIO * force:.4g} N by this indenter: no equilibrium was found up to {depth:.3g} mm; give a smaller force"
    )
