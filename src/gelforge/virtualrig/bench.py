"""The bench: carries out an ordered press, which gives forces, rows of the log and the gel's shape."""

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
from gelforge.records.press import N_M, Press
from gelforge.virtualrig import streams
from gelforge.virtualrig.fields import FAR, RoughBody, body_of
from gelforge.virtualrig.rigplan import Order, Plan, Truth, generator

SETTINGS = quality("draft")  # of the hexahedra on which the truth is solved
# Force scales with gel thickness to the power -STIFFER; the exponent is 1.0 for shallow balls and 1.7 for blocks.
STIFFER = 1.5
EVERY = 4  # subsampling of a body's height map for the footprint
# A real bench never diverges: if a solve does, it is repeated with shorter load steps, and at last with a less deep
# press, which the log then reports.
FINER = SETTINGS.with_steps(3)
ATTEMPTS = ((SETTINGS, 1.0), (FINER, 1.0), (FINER, 0.8))


@dataclass(frozen=True)
class Pressing:
    """The truth about one frame of a press, and what the bench reports.

    real: true path of the tip, mm. log: the path that the bench reports. force: (3,) N on the gel, moment: (3,) N m
    about the apex. read_force, read_moment: the load cell's readings of both. down: displacement (n, 3) mm at the end
    of the way down, for a press that goes sideways.
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
    """Presses indenters with a plan's truth; caches bodies between presses."""

    def __init__(self, plan: Plan, indenters: Mapping[str, Indenter], gel: Gel):
        self.plan, self.indenters, self.gel = plan, indenters, gel
        self._bodies: dict[str, RoughBody] = {}

    @property
    def _law(self) -> Interface:
        return Interface.of_friction(self.plan.truth.friction)

    def body(self, name: str) -> RoughBody:
        """Underside of an indenter with its printed texture, the same in every run."""
        if name not in self._bodies:
            rng = np.random.default_rng(zlib.crc32(name.encode()))
            angle = float(rng.choice([135.0, 45.0])) + rng.normal(scale=2.0)
            self._bodies[name] = body_of(
                self.indenters[name], rng.uniform(0.025, 0.045), rng.uniform(0.55, 0.75), angle
            )
        return self._bodies[name]

    def press(self, order: Order) -> list[Pressing]:
        """Carry out one order; return the frames of its press in order of time, all from one load path.

        If every attempt fails, the last frame's status is not valid. Earlier frames may be invalid in any case.
        """
        truth, rng = self.plan.truth_of(order.mounting), generator(self.plan, order.index, streams.BENCH)
        play = rng.uniform(-1.0, 1.0, size=6) * truth.cnc_um * 1e-3
        if order.shear == (0.0, 0.0):
            play[3:5] = 0.0  # axes that do not move have no error of travel
        height = truth.touch_offset_mm + rng.normal(scale=truth.touch_scatter_mm)
        read_noise = rng.normal(scale=truth.force_noise_n, size=3)
        moment_noise = rng.normal(scale=truth.moment_noise_nm, size=3)
        depth = self.reached(order, height)
        for settings, fraction in ATTEMPTS:
            real = _path(order, height, fraction * depth, play, truth.tilt_deg)
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
        """States of a press that are solved, in order of time, and the index of the end of its way down, or None.

        This state is no frame. It is solved for presses that go sideways, because units scale the motion of the way
        down.
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
        truth = self.plan.truth_of(order.mounting)
        scale = truth.c10_mpa / REFERENCE_C10
        force = scale * result.total
        moment = N_M * scale * result.moment
        log = believed(order, real, play, force, truth)
        read = force + load_cell_error(self.plan, order.index) + noise[0]
        return Pressing(order, real, log, force, moment, read, moment + noise[1], result, down)

    def _solve(self, order: Order, real: Press, settings: HexSettings) -> list[HexResult]:
        body, gel, material = self.indenters[order.indenter], load_gel(order.gel), Material(nu=self.plan.truth.nu)
        states, _ = self._states(real)
        scenes = [Scene(gel, material, body, replace(real, **state), self._law) for state in states]
        return HexSolver(settings).solve_frames(scenes)

    def reached(self, order: Order, height: float) -> float:
        """Depth in mm, at most the ordered one, after deflection of the frame and within the load limit.

        It uses an estimate of the force; the log's depth follows later from the computed force.
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
        """Normal force in N, to within a seventh: displaced volume times a stiffness by mean depth and area.

        The stiffness is a fit to solves of 24 presses of the training plan, spheres to bars, 0.2 to 1.7 mm deep. Its
        dependence on thickness is fitted to balls and a block on pads of 3.6, 4 and 4.4 mm.
        """
        truth = self.plan.truth_of(order.mounting)
        place = Press(order.x, order.y, height, 0.0, 0.0, -depth, order.rot_deg, *truth.tilt_deg)
        _, _, sunk, cell = self._sunk(order.indenter, place)
        volume, area = sunk.sum() * cell, (sunk > 0).sum() * cell
        mean = volume / area if area else 0.0
        stiffness = 0.304 - 0.027 * mean - 0.00011 * area + 0.00124 * mean * area
        thinner = (self.gel.height / load_gel(order.gel).height) ** STIFFER
        return truth.c10_mpa / REFERENCE_C10 * volume * stiffness * thinner

    def _sunk(self, name: str, press: Press):
        """Gel points x, y under the body at the end of the path and its depth there, mm, and the cell area, mm^2."""
        body = self.body(name)
        under = body.bare[::EVERY, ::EVERY]
        axis = np.arange(len(under)) * EVERY * body.step - body.reach
        x, y = np.meshgrid(axis, axis)
        turn, tip = press.pose(1.0, 1.0)
        gx, gy = tip[0] + turn[0, 0] * x + turn[0, 1] * y, tip[1] + turn[1, 0] * x + turn[1, 1] * y
        on_gel = (np.abs(gx) < self.gel.width / 2) & (np.abs(gy) < self.gel.length / 2) & (under < FAR - 0.01)
        height = tip[2] + turn[2, 0] * x + turn[2, 1] * y + under
        return gx, gy, np.clip(self.gel.top(gx, gy) - height, 0.0, None) * on_gel, (EVERY * body.step) ** 2


def _path(order: Order, height: float, depth: float, play, tilt_deg: tuple[float, float]) -> Press:
    fraction = depth / order.depth
    dx, dy = order.shear[0] * fraction, order.shear[1] * fraction
    path = order.x + play[0], order.y + play[1], height + play[2], dx + play[3], dy + play[4], -depth + play[5]
    x0, y0, z0, dx, dy, dz = map(float, path)
    return Press(x0, y0, z0, dx, dy, dz, order.rot_deg, *tilt_deg)


def frames_along(real: Press, count: int) -> list[dict[str, float]]:
    """Travel dx, dy, dz in mm of a press at `count` frames, evenly spaced along its path, the last at its end."""
    times = [real.end * (k + 1) / count for k in range(count)]
    return [
        {"dx": max(t - 1.0, 0.0) * real.dx, "dy": max(t - 1.0, 0.0) * real.dy, "dz": min(t, 1.0) * real.dz}
        for t in times
    ]


def _part(play: np.ndarray, real: Press, state: dict[str, float]) -> np.ndarray:
    """Position errors (6,) mm of the axes at a frame; errors of travel grow in proportion to it."""
    down = state["dz"] / real.dz
    aside = (state["dx"] / real.dx if real.dx else state["dy"] / real.dy) if real.dx or real.dy else 1.0
    return play * [1.0, 1.0, 1.0, aside, aside, down]


def believed(order: Order, real: Press, play, force, truth: Truth) -> Press:
    """The commanded path: the real one without axis errors, plus the deflection of frame and gantry under `force`."""
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
    """Bias and drift of the load cell at a press, (3,) N; the drift, slow waves over presses, depends on the seed."""
    rng = generator(plan, streams.EVERY_PRESS, streams.ORDER)
    phase, period = rng.uniform(0, 2 * np.pi, (3, 3)), rng.uniform(80.0, 900.0, (3, 3))
    waves = np.sin(2 * np.pi * index / period + phase).sum(axis=1) / np.sqrt(3.0)
    return np.array(plan.truth.force_bias_n) + plan.truth.drift_n * waves
