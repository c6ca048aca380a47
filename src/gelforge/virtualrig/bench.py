"""The bench itself: one ordered press becomes forces, a row of the log, and the gel's shape."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gelforge.geometry.gel import Gel, load_gel
from gelforge.geometry.solids import Indenter
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexResult, HexSolver
from gelforge.records.press import Press
from gelforge.virtualrig import streams
from gelforge.virtualrig.fields import FAR, RoughBody, body_of
from gelforge.virtualrig.rigplan import Order, Plan, Truth, generator

SETTINGS = quality("draft")  # of the hexahedra that the truth is solved on
# Power of how much thinner a gel is, by which its force is larger: 1.0 under shallow balls, 1.7 under blocks.
STIFFER = 1.5
EVERY = 4  # of the lines of a body's heights by which its footprint is found
# A bench never diverges: where the steps were too long it takes shorter ones, and at last a less deep press,
# which the log then reports.
FINER = SETTINGS.with_steps(3)
ATTEMPTS = ((SETTINGS, 1.0), (FINER, 1.0), (FINER, 0.8))


@dataclass(frozen=True)
class Pressing:
    """What one press really was and what the bench reports of it.

    real: the path the tip took, mm. log: the same as the bench believes it. force: (3,) N on the gel,
    moment: (3,) N m about the apex. read_force, read_moment: the load cell's readings of both. down: displacement (n, 3) mm
    at the end of the way down, for a press that goes sideways.
    """

    order: Order
    real: Press
    log: Press
    force: np.ndarray
    moment: np.ndarray
    read_force: np.ndarray
    read_moment: np.ndarray
    result: HexResult
    down: np.ndarray | None = None


class Bench:
    """Presses indenters as a plan's truth has it; keeps bodies between presses."""

    def __init__(self, plan: Plan, indenters: Mapping[str, Indenter], gel: Gel):
        self.plan, self.indenters, self.gel = plan, indenters, gel
        self._bodies: dict[str, RoughBody] = {}

    @property
    def _law(self) -> Interface:
        return Interface.of_friction(self.plan.truth.friction)

    def body(self, name: str) -> RoughBody:
        """Underside of an indenter with the texture its printing left, the same in every run."""
        if name not in self._bodies:
            rng = np.random.default_rng(zlib.crc32(name.encode()))
            angle = float(rng.choice([135.0, 45.0])) + rng.normal(scale=2.0)
            self._bodies[name] = body_of(
                self.indenters[name], rng.uniform(0.025, 0.045), rng.uniform(0.55, 0.75), angle
            )
        return self._bodies[name]

    def press(self, order: Order) -> list[Pressing]:
        """Carry out one order, the frames of its press in order of time; all of them from one load path.

        A state that no attempt could reach has a status that is not valid; so may a frame on the way.
        """
        truth, rng = self.plan.truth, generator(self.plan, order.index, streams.BENCH)
        play = rng.uniform(-1.0, 1.0, size=6) * truth.cnc_um * 1e-3
        if order.shear == (0.0, 0.0):
            play[3:5] = 0.0  # axes that do not travel make no error of travel
        height = truth.touch_offset_mm + rng.normal(scale=truth.touch_scatter_mm)
        read_noise = rng.normal(scale=truth.force_noise_n, size=3)
        moment_noise = rng.normal(scale=truth.moment_noise_nm, size=3)
        depth = self.reached(order, height)
        for settings, fraction in ATTEMPTS:
            real = _path(order, height, fraction * depth, play)
            results = self._solve(order, real, settings)
            if results[-1].status.valid:
                break
        _, at_bottom = self._states(real)
        down = results.pop(at_bottom).displacement if at_bottom is not None else None
        noises = [self._later_noise(order, k) for k in range(len(results) - 1)] + [(read_noise, moment_noise)]
        return [
            self._reported(order, replace(real, **state), result, _part(play, real, state), noise, down)
            for state, result, noise in zip(frames_along(real, self.plan.frames), results, noises, strict=True)
        ]

    def _states(self, real: Press) -> tuple[list[dict[str, float]], int | None]:
        """States of a press that are solved, in order of time, and which of them is the end of its way down and no frame.

        Units scale the motion of the way down, so that of a press which goes sideways is solved for them.
        """
        states = frames_along(real, self.plan.frames)
        if real.end == 1.0:
            return states, None
        at = sum(1 for state in states if not (state["dx"] or state["dy"]))
        return [*states[:at], {"dx": 0.0, "dy": 0.0, "dz": real.dz}, *states[at:]], at

    def _later_noise(self, order: Order, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Noise of force and moment that the load cell reads at a frame before the last."""
        rng = generator(self.plan, order.index, streams.load_cell(frame))
        truth = self.plan.truth
        return rng.normal(scale=truth.force_noise_n, size=3), rng.normal(scale=truth.moment_noise_nm, size=3)

    def _reported(self, order: Order, real: Press, result: HexResult, play, noise, down) -> Pressing:
        """What the bench reports of one solved frame."""
        truth = self.plan.truth
        scale = truth.c10_mpa / REFERENCE_C10
        force = scale * result.total
        arm = result.solved_mesh.nodes + result.displacement
        moment = np.cross(arm, scale * result.forces).sum(axis=0) * 1e-3
        log = believed(order, real, play, force, truth)
        read = force + load_cell_error(self.plan, order.index) + noise[0]
        return Pressing(order, real, log, force, moment, read, moment + noise[1], result, down)

    def _solve(self, order: Order, real: Press, settings: HexSettings) -> list[HexResult]:
        body, gel, material = self.indenters[order.indenter], load_gel(order.gel), Material(nu=self.plan.truth.nu)
        states, _ = self._states(real)
        scenes = [Scene(gel, material, body, replace(real, **state), self._law) for state in states]
        return HexSolver(settings).solve_frames(scenes)

    def reached(self, order: Order, height: float) -> float:
        """Depth that is left of the ordered one when the frame has given way and the load limit was kept.

        Only an estimate enters here: the log's depth follows afterwards from the force that was computed.
        """
        low, high = 0.0, order.depth
        compliance = self.plan.truth.compliance_mm_per_n
        force = self.estimate(order, height, order.depth)
        if compliance * force <= 0.0 and force <= order.max_force_n:
            return order.depth
        for _ in range(24):
            middle = 0.5 * (low + high)
            force = self.estimate(order, height, middle)
            if middle + compliance * force > order.depth or force > order.max_force_n:
                high = middle
            else:
                low = middle
        return low

    def estimate(self, order: Order, height: float, depth: float) -> float:
        """Normal force in N, good to a seventh: displaced volume on a bed that stiffens with mean depth and area.

        The stiffness is a fit to solves of 24 presses of the training plan, spheres to bars, 0.2 to 1.7 mm deep; how it
        grows as the pad gets thinner, to balls and a block on pads of 3.6, 4 and 4.4 mm.
        """
        place = Press(order.x, order.y, height, 0.0, 0.0, -depth, order.rot_deg)
        _, _, sunk, cell = self._sunk(order.indenter, place)
        volume, area = sunk.sum() * cell, (sunk > 0).sum() * cell
        mean = volume / area if area else 0.0
        stiffness = 0.304 - 0.027 * mean - 0.00011 * area + 0.00124 * mean * area
        thinner = (self.gel.height / load_gel(order.gel).height) ** STIFFER
        return self.plan.truth.c10_mpa / REFERENCE_C10 * volume * stiffness * thinner

    def _sunk(self, name: str, press: Press):
        """Gel points x, y under the body at the end of the path, how far it is below the gel there, cell area."""
        body = self.body(name)
        under = body.bare[::EVERY, ::EVERY]
        axis = np.arange(len(under)) * EVERY * body.step - body.reach
        x, y = np.meshgrid(axis, axis)
        turn, tip = press.pose(1.0, 1.0)
        gx, gy = tip[0] + turn[0, 0] * x + turn[0, 1] * y, tip[1] + turn[1, 0] * x + turn[1, 1] * y
        on_gel = (np.abs(gx) < self.gel.width / 2) & (np.abs(gy) < self.gel.length / 2) & (under < FAR - 0.01)
        return gx, gy, np.clip(self.gel.top(gx, gy) - (tip[2] + under), 0.0, None) * on_gel, (EVERY * body.step) ** 2


def _path(order: Order, height: float, depth: float, play) -> Press:
    fraction = depth / order.depth
    dx, dy = order.shear[0] * fraction, order.shear[1] * fraction
    path = order.x + play[0], order.y + play[1], height + play[2], dx + play[3], dy + play[4], -depth + play[5]
    x0, y0, z0, dx, dy, dz = map(float, path)
    return Press(x0, y0, z0, dx, dy, dz, order.rot_deg)


def frames_along(real: Press, count: int) -> list[dict[str, float]]:
    """How far down and sideways (dx, dy, dz in mm) a press is at `count` frames, evenly along its path, the last its end."""
    times = [real.end * (k + 1) / count for k in range(count)]
    return [
        {"dx": max(t - 1.0, 0.0) * real.dx, "dy": max(t - 1.0, 0.0) * real.dy, "dz": min(t, 1.0) * real.dz}
        for t in times
    ]


def _part(play: np.ndarray, real: Press, state: dict[str, float]) -> np.ndarray:
    """The axes' errors (6,) at a frame: those of the travel grow with it."""
    down = state["dz"] / real.dz
    aside = (state["dx"] / real.dx if real.dx else state["dy"] / real.dy) if real.dx or real.dy else 1.0
    return play * [1.0, 1.0, 1.0, aside, aside, down]


def believed(order: Order, real: Press, play, force, truth: Truth) -> Press:
    """The path as commanded: the real one plus what frame and gantry gave way under `force`."""
    return Press(
        order.x,
        order.y,
        0.0,
        real.dx - play[3] + truth.shear_compliance_mm_per_n * force[0],
        real.dy - play[4] + truth.shear_compliance_mm_per_n * force[1],
        real.dz - play[5] + truth.compliance_mm_per_n * force[2],
        order.rot_deg,
    )


def load_cell_error(plan: Plan, index: int) -> np.ndarray:
    """Bias and drift of the load cell at a press, (3,) N: slow waves over the presses, known from the seed alone."""
    rng = generator(plan, streams.EVERY_PRESS, streams.ORDER)
    phase, period = rng.uniform(0, 2 * np.pi, (3, 3)), rng.uniform(80.0, 900.0, (3, 3))
    waves = np.sin(2 * np.pi * index / period + phase).sum(axis=1) / np.sqrt(3.0)
    return np.array(plan.truth.force_bias_n) + plan.truth.drift_n * waves
