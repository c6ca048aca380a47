"""Fidelity `hex`: the whole contact problem in process, on bricks with mean dilatation."""

import resource
import time
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np

from gelforge.errors import BadInput, SolveFailed
from gelforge.geometry.gel import Gel
from gelforge.mechanics import element
from gelforge.mechanics.contact import (
    FREE,
    GLUED,
    TOUCHING,
    ContactState,
    FacePlaces,
    Pose,
    contact_points,
    contact_springs,
    positions,
)
from gelforge.mechanics.hexmesh import FineBox, HexMesh, build_mesh, interpolate_surface
from gelforge.mechanics.linear import symmetric_solver
from gelforge.mechanics.scene import Result, Scene, Status

__all__ = ["HexSettings", "HexSolver", "HexResult", "QUALITIES", "solve_hex", "interpolate_surface"]


@dataclass(frozen=True)
class HexSettings:
    """How finely a scene is solved.

    size: side of the bricks under the press, mm. layers, layer_ratio: bricks through the height and
    how much thicker the lowest is. growth, largest: coarsening away from the press, mm.
    press_steps, shear_steps: load steps of the two legs (more where Newton asks for it).
    gauss: order of the contact rule on a face. penalty: contact stiffness times size / C10.
    tolerance, final_tolerance: residual over contact force, within the path and at its end.
    box: fixed fine part (FineBox) in place of one that follows the press.
    """

    size: float = 0.7
    layers: int = 6
    layer_ratio: float = 3.0
    growth: float = 1.5
    largest: float = 2.0
    press_steps: int = 6
    shear_steps: int = 3
    gauss: int = 3
    penalty: float = 1000.0
    tolerance: float = 1e-4
    final_tolerance: float = 1e-9
    max_iterations: int = 14
    max_cuts: int = 8
    settle_rounds: int = 6
    friction_rounds: int = 8
    friction_tolerance: float = 0.01
    pull_tolerance: float = 1e-3
    anchoring: str = "crossing"
    box: FineBox | None = None


@dataclass
class HexResult(Result):
    """A Result with the mesh it lives on and the contact at its Gauss points (None where nothing was solved)."""

    mesh: HexMesh | None = None
    contact: ContactState | None = None


class NoEquilibrium(Exception):
    """Newton's method stopped without a state; internal to the load stepping."""


def solve_hex(scene: Scene, settings: HexSettings = HexSettings()) -> HexResult:
    """Solve one scene with a solver of its own."""
    return HexSolver(settings).solve(scene)


class HexSolver:
    """Solves many scenes, keeping meshes and symbolic factorisations (`kept` of each)."""

    def __init__(self, settings: HexSettings = HexSettings(), kept: int = 4):
        self.settings = settings
        self._meshes = _Kept(kept)
        self._systems = _Kept(kept)

    def mesh(self, gel: Gel, box: FineBox) -> HexMesh:
        """The brick mesh for a fine box (cached)."""
        s = self.settings
        return self._meshes.get(
            (gel, box), lambda: build_mesh(gel, box, s.layers, s.layer_ratio, s.growth, s.largest)
        )

    def solve(self, scene: Scene) -> HexResult:
        """State at the end of the scene's path. Failure is a status, not an exception."""
        started = time.perf_counter()
        start = first_touch(scene)
        if start is None:
            return self._untouched(scene, started)
        mesh = self.mesh(scene.gel, self.settings.box or fine_box(scene, self.settings.size))
        run = _Run(scene, self.settings, mesh, self._system(mesh))
        status = run.follow(start)
        result = run.result(status)
        result.evidence["seconds"] = time.perf_counter() - started
        return result

    def _system(self, mesh: HexMesh) -> "_System":
        """Matrix and factorisation: they depend on the numbers of bricks only."""
        return self._systems.get(mesh.shape, lambda: _System(mesh))

    def _untouched(self, scene, started) -> HexResult:
        gel = scene.gel
        s = self.settings
        box = s.box or FineBox(-gel.width / 4, gel.width / 4, -gel.length / 4, gel.length / 4, 2 * s.size)
        mesh = self.mesh(gel, box)
        zero = np.zeros_like(mesh.nodes)
        evidence = _evidence(0.0, 0.0, 0.0, 0.0, 0, 0, 0)
        evidence["seconds"] = time.perf_counter() - started
        return HexResult(Status.NO_CONTACT, zero, zero.copy(), evidence, mesh, None)


class _Kept:
    """The most recently used few of what is costly to make."""

    def __init__(self, size):
        self._size, self._items = size, OrderedDict()

    def get(self, key, make):
        if key not in self._items:
            self._items[key] = make()
        self._items.move_to_end(key)
        while len(self._items) > self._size:
            self._items.popitem(last=False)
        return self._items[key]


class _System:
    """Sparsity pattern, assembly places and symbolic factorisation of one mesh topology."""

    def __init__(self, mesh: HexMesh):
        self.pattern = element.build_pattern(mesh.elements, len(mesh.nodes), mesh.base)
        self.base, self.width = element.block_places(self.pattern, mesh.elements)
        self.faces = FacePlaces(mesh, self.pattern)
        self.linear = symmetric_solver(self.pattern.indptr, self.pattern.indices)
        self.free = np.flatnonzero(self.pattern.first_row >= 0)
        self.values = np.zeros(len(self.pattern.indices))


# ---- geometry of the path ------------------------------------------------------------------


def path_pose(scene: Scene, t: float) -> Pose:
    """Pose at path parameter t: 0 to 1 press, 1 to 2 shear; below 0 the press goes on upwards."""
    return Pose(*scene.press.pose(min(t, 1.0), max(t - 1.0, 0.0)))


def _surface_grid(scene: Scene, spacing: float):
    """Points of the undeformed top surface around the press, (m, 3)."""
    gel, reach = scene.gel, scene.indenter.radius() + spacing
    ends = np.array([path_pose(scene, t).translation[:2] for t in (0.0, 0.5, 1.0, 1.5, 2.0)])
    low = np.maximum(ends.min(axis=0) - reach, [-gel.width / 2, -gel.length / 2])
    high = np.minimum(ends.max(axis=0) + reach, [gel.width / 2, gel.length / 2])
    if np.any(high <= low):
        return np.empty((0, 3))
    counts = np.maximum(2, np.ceil((high - low) / spacing).astype(int))
    x, y = np.meshgrid(*(np.linspace(low[i], high[i], counts[i]) for i in range(2)), indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.asarray(gel.top(x, y), float).ravel()], axis=1)


def _gap(scene, points, t):
    return scene.indenter.distance(path_pose(scene, t).to_indenter(points))[0]


def first_touch(scene: Scene, spacing: float = 0.2) -> float | None:
    """Path parameter where the indenter first meets the undeformed gel, or None where it never does."""
    points = _surface_grid(scene, spacing)
    if not len(points):
        return None
    samples = np.concatenate([np.linspace(0.0, 1.0, 5), np.linspace(1.2, 2.0, 5)])
    lowest = [float(_gap(scene, points, t).min()) for t in samples]
    inside = np.flatnonzero(np.array(lowest) < 0.0)
    if not len(inside):
        return None
    high = samples[inside[0]]
    low = samples[inside[0] - 1] if inside[0] else -1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if _gap(scene, points, middle).min() < 0.0:
            high = middle
        else:
            low = middle
    return float(low)


def fine_box(scene: Scene, size: float, margin: float = 0.5, grid: float = 0.5) -> FineBox:
    """Part of the gel that the press can touch, rounded outwards to `grid` so that presses share meshes.

    The undeformed surface inside the indenter anywhere on the path, and `margin` mm around it.
    """
    points = _surface_grid(scene, 0.2)
    inside = np.zeros(len(points), bool)
    for t in (1.0, 1.25, 1.5, 1.75, 2.0):
        inside |= _gap(scene, points, t) < 0.0
    if not inside.any():
        inside |= _gap(scene, points, 1.0) <= _gap(scene, points, 1.0).min() + 1e-9
    touched = points[inside, :2]
    gel = scene.gel
    half = np.array([gel.width / 2, gel.length / 2])
    low = np.maximum(np.floor((touched.min(axis=0) - margin) / grid) * grid, -half)
    high = np.minimum(np.ceil((touched.max(axis=0) + margin) / grid) * grid, half)
    return FineBox(float(low[0]), float(high[0]), float(low[1]), float(high[1]), size)


def _reachable_faces(scene: Scene, mesh: HexMesh, margin: float = 1.0) -> np.ndarray:
    """Faces whose undeformed corners come within `margin` of the indenter somewhere on the path."""
    corners = mesh.nodes[mesh.faces]
    centre = corners.mean(axis=1)
    size = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    near = np.zeros(len(centre), bool)
    for t in (1.0, 1.25, 1.5, 1.75, 2.0):
        near |= _gap(scene, centre, t) < margin + size
    return np.flatnonzero(near)


# ---- one scene -----------------------------------------------------------------------------


@dataclass
class _Run:
    scene: Scene
    settings: HexSettings
    mesh: HexMesh
    system: _System
    iterations: int = 0
    rounds: int = 0
    steps: int = 0
    residual: float = np.inf
    springs: object = None
    history: list = field(default_factory=list)
    curve: list = field(default_factory=list)

    def __post_init__(self):
        material = self.scene.material
        self.penalty = self.settings.penalty * material.c10 / self.settings.size
        self.shear, self.bulk = material.shear_modulus, material.bulk_modulus
        self.bricks = element.bricks(self.mesh.nodes, self.mesh.elements)
        self.state = contact_points(self.mesh, self.settings.gauss, _reachable_faces(self.scene, self.mesh))
        self.nodes = np.ascontiguousarray(self.mesh.faces[self.state.face])
        self.u = np.zeros_like(self.mesh.nodes)
        self.candidates = np.empty(0, np.int64)
        self.law = self.scene.interface.law
        if self.law not in ("no_slip", "coulomb", "frictionless"):
            raise BadInput(f"interface law {self.law!r} is unknown; choose no_slip, coulomb or frictionless")

    # -- path

    def follow(self, start: float) -> Status:
        """Walk the path from first touch to its end."""
        try:
            for stop, count in self._legs(start):
                start = self._leg(start, stop, (stop - start) / count)
            self.t = start
            return self._settle(start)
        except (NoEquilibrium, SolveFailed):
            return Status.DIVERGED

    def _legs(self, start):
        press = self.scene.press
        legs = [(1.0, self.settings.press_steps)] if start < 1.0 else []
        if press.dx or press.dy or start >= 1.0:
            legs.append((2.0, self.settings.shear_steps))
        return legs

    def _leg(self, t, stop, step):
        largest, smallest = step, step / 2**self.settings.max_cuts
        while stop - t > 1e-9:
            ahead = min(step, stop - t)
            if stop - t - ahead < 0.3 * ahead:
                ahead = stop - t
            try:
                used = self._advance(t, t + ahead)
            except NoEquilibrium:
                step = 0.5 * ahead
                if step < smallest:
                    raise
                continue
            t += ahead
            if used <= 6:
                step = min(2.0 * step, largest)
        return t

    def _advance(self, t, t_next) -> int:
        """One load step; commits u and the contact state, or raises NoEquilibrium and changes nothing."""
        before, after = path_pose(self.scene, t), path_pose(self.scene, t_next)
        x = self._points(self.u)
        gap = self._gaps(x, before)
        self.candidates = np.flatnonzero((self.state.status != GLUED) & (gap < self._reach(before, after)))
        guess = self._predict(t, t_next)
        for trial in [guess, self.u] if guess is not None else [self.u]:
            try:
                u, used = self._newton(trial, after, self.settings.tolerance)
                break
            except NoEquilibrium:
                if trial is self.u:
                    raise
        predicted = guess if guess is not None else self.u
        self.history = [(t, self.u), (t_next, u)]
        start = (x, before, gap, self._points(predicted))
        self.u = u
        self.steps += 1
        total = self.state.weights[self.springs.point] @ self.springs.traction
        self.curve.append([float(t_next), *(float(f) for f in total)])
        self._glue(start, after)
        return used

    def _predict(self, t, t_next):
        if not self.history or self.history[-1][0] != t:
            return None
        (t0, u0), (t1, u1) = self.history
        if t1 <= 1.0 < t_next:
            return None
        return u1 + (t_next - t1) / (t1 - t0) * (u1 - u0)

    def _reach(self, before, after):
        return 1.5 * np.linalg.norm(after.translation - before.translation) + self.settings.size

    def _points(self, u):
        return positions(self.state.shape, self.nodes, self.mesh.nodes + u)

    def _gaps(self, x, pose):
        return self.scene.indenter.distance(pose.to_indenter(x))[0]

    # -- equilibrium

    def _residual(self, u, pose):
        """Nodal residual (n, 3), springs, and the sum of contact force magnitudes."""
        forces = np.zeros_like(u)
        b = self.bricks
        smallest = element.internal_forces(u, b.elements, b.gradients, b.weights, self.shear, self.bulk, forces)
        if not smallest > 0.0:
            raise NoEquilibrium
        springs = contact_springs(
            self.state, self._points(u), pose, self.scene.indenter, self.penalty, self.candidates
        )
        self.system.faces.add(self.state, springs, forces, None)
        weights = self.state.weights[springs.point]
        scale = float(weights @ np.linalg.norm(springs.traction, axis=1))
        return forces, springs, scale

    def _newton(self, u, pose, tolerance) -> tuple[np.ndarray, int]:
        system, b = self.system, self.bricks
        free, values = system.free, system.values
        for iteration in range(self.settings.max_iterations + 1):
            forces, springs, scale = self._residual(u, pose)
            size = float(np.linalg.norm(forces[free]))
            self.residual = size / max(scale, 1e-12 * self.shear)
            if not np.isfinite(size):
                raise NoEquilibrium
            if self.residual <= tolerance:
                self.springs = springs
                return u, iteration
            if iteration == self.settings.max_iterations:
                break
            values[:] = 0.0
            element.tangent(
                u, b.elements, b.gradients, b.weights, self.shear, self.bulk, system.base, system.width, values
            )
            system.faces.add(self.state, springs, forces.copy(), values)
            system.linear.factorise(values)
            change = system.linear.solve(forces[free].ravel())
            self.iterations += 1
            u = u.copy()
            u[free] -= change.reshape(-1, 3)
        raise NoEquilibrium

    # -- contact set

    def _touching(self):
        """Points pressed by the last solve that are not glued."""
        point = self.springs.point
        return point[self.state.status[point] != GLUED]

    def _glue(self, start, pose) -> None:
        """End of a step: let go what pulls, hold what touched first in this step where it touched."""
        state = self.state
        self._release(pose)
        new = self._touching()
        state.status[state.status == TOUCHING] = FREE
        if self.law == "frictionless":
            state.status[new] = TOUCHING
            return
        self._anchor(new, self._touch_places(new, start, pose))

    def _touch_places(self, new, start, pose):
        """Indenter-frame places where new points first touched."""
        x0, before, gap, predicted = start
        end = pose.to_indenter(self._points(self.u)[new])
        if self.settings.anchoring == "end":
            return end
        begin = before.to_indenter(x0[new])
        g0 = np.maximum(gap[new], 0.0)
        if self.settings.anchoring == "linear":
            fraction = g0 / max(g0.max(initial=0.0), 1e-12)
        else:
            ahead = self._gaps(predicted, pose)[new]
            fraction = np.clip(g0 / np.maximum(g0 - ahead, 1e-12), 0.0, 1.0)
            fraction[ahead >= 0.0] = 1.0
        if self.settings.anchoring == "predicted":
            end = np.where((fraction < 1.0)[:, None], pose.to_indenter(predicted[new]), end)
        return begin + fraction[:, None] * (end - begin)

    def _anchor(self, points, places) -> None:
        """Glue points at places of the indenter's frame, moved onto its surface."""
        if not len(points):
            return
        state, indenter = self.state, self.scene.indenter
        for _ in range(2):
            distance, normal = indenter.distance(places)
            places = places - distance[:, None] * normal
        state.status[points] = GLUED
        state.anchor[points] = places
        state.normal[points] = normal
        state.bound[points] = np.inf

    def _pulling(self, pose):
        """Glued points whose traction draws the gel out, and their normal pull (MPa)."""
        springs, state = self.springs, self.state
        glued = state.status[springs.point] == GLUED
        point = springs.point[glued]
        pull = np.einsum("pi,pi->p", springs.traction[glued], pose.turn(state.normal[point]))
        # the indenter's outward normal points into the gel: a positive component presses
        return point, pull

    def _release(self, pose) -> int:
        point, push = self._pulling(pose)
        worst = self.settings.pull_tolerance * max(push.max(initial=0.0), 0.0)
        gone = point[push < -worst]
        self._free(gone)
        return len(gone)

    def _free(self, points) -> None:
        self.state.status[points] = FREE
        self.state.anchor[points] = np.nan

    # -- end of the path

    def _settle(self, t) -> Status:
        """Solve at the end of the path until nothing pulls and nothing new touches."""
        pose = path_pose(self.scene, t)
        self._ease(pose)
        for self.rounds in range(2, self.settings.settle_rounds + 1):
            kept = self.u, self.state.status.copy(), self.state.anchor.copy()
            if not self._release(pose):
                break
            try:
                self._resolve(pose, self.settings.tolerance)
            except NoEquilibrium:
                self.u, self.state.status, self.state.anchor = kept
                break
        self._resolve(pose, self.settings.final_tolerance)
        self.state.status[self._touching()] = TOUCHING
        return Status.OK

    def _resolve(self, pose, tolerance) -> None:
        """Equilibrium at a fixed pose with the contact set as it stands."""
        gap = self._gaps(self._points(self.u), pose)
        self.candidates = np.flatnonzero((self.state.status != GLUED) & (gap < self.settings.size))
        self.u, _ = self._newton(self.u, pose, tolerance)

    def _ease(self, pose) -> None:
        """Bring the last step's points from where they are to their anchors, in parts where one go fails."""
        glued = np.flatnonzero(self.state.status == GLUED)
        goal = self.state.anchor[glued].copy()
        origin = pose.to_indenter(self._points(self.u)[glued])
        done, part = 0.0, 1.0
        while done < 1.0:
            ahead = min(1.0, done + part)
            self.state.anchor[glued] = origin + ahead * (goal - origin)
            try:
                self._resolve(pose, self.settings.tolerance)
                done = ahead
            except NoEquilibrium:
                part *= 0.5
                if part < 0.1:
                    raise

    # -- result

    def result(self, status: Status) -> HexResult:
        """Forces, evidence and contact state."""
        forces = np.zeros_like(self.u)
        evidence = _evidence(self.residual, np.nan, np.nan, np.nan, self.iterations, self.rounds, self.steps)
        # Converged load steps as [path parameter, fx, fy, fz]: one solve is a whole force-depth curve.
        evidence["path"] = self.curve
        if status is Status.OK:
            self.system.faces.add(self.state, self.springs, forces, None)
            forces *= -1.0
            evidence |= self._checks(forces)
        self.state.position = self._points(self.u)
        self.state.traction = np.zeros_like(self.state.position)
        if self.springs is not None:
            self.state.traction[self.springs.point] = self.springs.traction
        if status is Status.OK and evidence["base_mismatch"] > 1e-6:
            status = Status.UNBALANCED
        return HexResult(status, forces, self.u, evidence, self.mesh, self.state)

    def _checks(self, forces) -> dict:
        pose = path_pose(self.scene, self.t)
        b, weights = self.bricks, self.state.weights
        inner = np.zeros_like(self.u)
        element.internal_forces(self.u, b.elements, b.gradients, b.weights, self.shear, self.bulk, inner)
        total = forces.sum(axis=0)
        point, push = self._pulling(pose)
        normal_force = max(np.abs(total[2]), 1e-12)
        gap = self._gaps(self._points(self.u), pose)
        return {
            "penetration_mm": float(max(0.0, -gap.min(initial=0.0))),
            "pulling_fraction": float(weights[point] @ np.maximum(-push, 0.0) / normal_force),
            "base_mismatch": float(np.linalg.norm(inner[self.mesh.base].sum(axis=0) + total) / np.linalg.norm(total)),
        }


def _evidence(residual, penetration, pulling, mismatch, iterations, rounds, steps) -> dict:
    return {
        "equilibrium_residual": float(residual),
        "penetration_mm": float(penetration),
        "pulling_fraction": float(pulling),
        "base_mismatch": float(mismatch),
        "newton_iterations": int(iterations),
        "rounds": int(rounds),
        "load_steps": int(steps),
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


QUALITIES = {
    "demo": HexSettings(size=1.0, layers=4),
    "label": HexSettings(size=0.6, layers=6),
    "fine": HexSettings(size=0.4, layers=8),
}
