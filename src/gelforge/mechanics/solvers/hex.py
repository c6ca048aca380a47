"""Method on hexahedra: the whole contact problem is solved in process, on hexahedra with mean dilatation."""

import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gelforge.geometry import touch
from gelforge.geometry.gel import Gel
from gelforge.mechanics.contact.penalty import ContactState
from gelforge.mechanics.extrapolate import UNCORRECTED, UNCORRECTED_CELLS, edge_of
from gelforge.mechanics.hexsettings import FLATNESS, WIDEST, HexSettings
from gelforge.mechanics.mesh.hexmesh import FineBox, HexMesh, build_mesh, fine_box, sharpness, thinner_layers
from gelforge.mechanics.mesh.hexname import HexMeshName
from gelforge.mechanics.path.equilibrium import System
from gelforge.mechanics.path.loadpath import first_touch, fitted, frame_time
from gelforge.mechanics.path.scenepath import ScenePath
from gelforge.mechanics.path.transfer import LoadPath, walk_start
from gelforge.mechanics.result import BALANCE, BEYOND_CONE, Result
from gelforge.mechanics.scene import Scene
from gelforge.records.status import Status

# Largest penetration of a valid result, mm. It is at most 0.02 mm on the benchmark scenes, and half a millimetre or
# more where the gel is pressed through: such a state is in equilibrium, but is no solution of the press.
MOST_INSIDE_MM = 0.1
MOST_BELOW_MM = 1e-3  # largest depth of a node below the bonded base
KEPT = 8  # size of the caches of meshes and of factorisations
TOUCH = 1e-8  # accuracy of the first touch, path parameter: a frame closer to it has no contact yet


@dataclass
class HexResult(Result):
    """A Result with its mesh, the contact at Gauss points (None: nothing was solved), and the name of the mesh.

    evidence["path"]: converged load steps [path parameter, fx, fy, fz], N: one solve gives a whole force-depth curve.
    With nested settings it is the curve of the coarse hexahedra, scaled to end at the force of the fine ones.
    """

    mesh: HexMesh | None = None
    contact: ContactState | None = None
    mesh_name: HexMeshName | None = None

    @property
    def solved_mesh(self) -> HexMesh:
        """The mesh of a solved press; raises ValueError if nothing was solved."""
        if self.mesh is None:
            raise ValueError(f"nothing was solved: {self.status.value}")
        return self.mesh


def solve_hex(scene: Scene, settings: HexSettings = HexSettings()) -> HexResult:
    """Solve one scene with a new solver."""
    return HexSolver(settings).solve(scene)


class HexSolver:
    """Solves many scenes, keeping meshes and symbolic factorisations (KEPT of each).

    No state carries over, so results do not depend on the order of solves.
    """

    def __init__(self, settings: HexSettings = HexSettings()):
        self.settings = settings
        self._meshes = _Kept(KEPT)
        self._systems = _Kept(KEPT)

    def mesh(self, gel: Gel, box: FineBox) -> HexMesh:
        """The hexahedral mesh for a fine box (cached)."""
        return self._mesh(gel, box, self.settings)

    def solve(self, scene: Scene) -> HexResult:
        """State at the end of the scene's path. Failure is a status, not an exception."""
        return self.solve_frames([scene.direct])[0]

    def solve_frames(self, scenes: Sequence[Scene]) -> list[HexResult]:
        """States at the frames of one press, scenes in order of time along one path; one result each, on one mesh.

        With nested settings the path is followed once on coarse hexahedra, and only its frames are solved on fine
        ones, with Coulomb friction after a short walk. If the coarse path fails, the path is followed on the fine
        hexahedra, and contact is iterated at each frame that it passes; if a frame fails, so is the path to it alone.
        """
        began, start = time.perf_counter(), first_touch(scenes[-1])
        if start is None:
            return [self._no_contact(scene, began) for scene in scenes]
        box = self._box(scenes[-1])
        frames = self.coarse_path(scenes)
        share = (time.perf_counter() - began) / len(scenes)
        if len(scenes) > 1 and not any(frames) and not _below_base(scenes[-1]):
            results = self._passed(scenes, start, box)
        else:
            results = [
                self._frame(scene, coarse, box, time.perf_counter() - share)
                for scene, coarse in zip(scenes, frames, strict=True)
            ]
        for scene, coarse, result in zip(scenes, frames, results, strict=True):
            self._extrapolate(scene, coarse, box, result)
        return results

    def _passed(self, scenes: Sequence[Scene], start: float, box: FineBox) -> list[HexResult]:
        """States at the frames of one press from one path on the fine hexahedra, with contact iterations at each."""
        last, name = scenes[-1], self._mesh_name(scenes[-1].gel, box)
        mesh = self.mesh(last.gel, box)
        run = self._run(last, mesh, self.settings, box.size)
        times = [frame_time(scene, last) for scene in scenes]
        found: dict[float, HexResult] = {}

        def keep(ended: ScenePath, status: Status) -> None:
            found[ended.t] = _result(ended, mesh, status, time.perf_counter(), name)

        began = time.perf_counter()
        status = run.follow(start, times, keep)
        end = _result(run, mesh, status, began, name)
        results = []
        for scene, t in zip(scenes, times, strict=True):
            if t <= start + TOUCH:
                results.append(self._no_contact(scene, time.perf_counter()))
                continue
            passed = found.get(t) if t < times[-1] else None
            reached = passed or end
            path = _until(reached.evidence["path"], t) if passed else reached.evidence["path"]
            seconds = (time.perf_counter() - began) / len(scenes)
            # a copy, because equal frames share one result, and its evidence is changed per frame
            results.append(replace(reached, evidence=reached.evidence | {"path": path, "seconds": seconds}))
        return results

    def coarse_path(self, scenes: Sequence[Scene]) -> list["CoarseFrame | None"]:
        """The path of a press on the coarse hexahedra of nested settings, up to each of its frames.

        None for a frame without contact, and for all frames if the path fails or settings are not nested.
        """
        last = scenes[-1]
        none: list[CoarseFrame | None] = [None] * len(scenes)
        start = first_touch(last)
        nested = self.settings.nested
        if start is None or nested is None or _below_base(last):
            return none
        settings, box = self.settings.coarse, self._box(last)
        wide = replace(box, size=nested.factor * box.size)
        mesh = self._mesh(last.gel, wide, settings)
        run = self._run(last, mesh, settings, wide.size)
        times = [frame_time(scene, last) for scene in scenes]
        stops = list(times)
        if last.interface.contact.frictional:
            walks = {settings.walk_mm, run.settings.walk_mm}
            stops += [walk_start(last, start, t, walk) for walk in walks for t in times if t > start + TOUCH]
        status = run.follow(start, stops)
        # with friction the last load step suffices: points that flip at the end of a slide have equal forces either way
        at_end = last.interface.contact.frictional and run.t >= last.press.end
        if status is Status.DIVERGED and not at_end:
            return none
        run.curve[-1][1:] = run.contact_forces().sum(axis=0).tolist()
        path = run.path(wide.size)
        found: list[CoarseFrame | None] = []
        for t in times:
            curve = _until(run.curve, t)
            frame = CoarseFrame(path.until(t), curve) if curve else None
            found.append(frame if t > start + TOUCH else None)
        return found

    def _frame(self, scene: Scene, coarse: "CoarseFrame | None", box: FineBox, started: float) -> HexResult:
        """State at the end of one scene: from the coarse path if that succeeds, else by its own path."""
        start = first_touch(scene)
        if start is None:
            return self._no_contact(scene, started)
        mesh, name = self.mesh(scene.gel, box), self._mesh_name(scene.gel, box)
        if reason := _below_base(scene):
            return _refused(mesh, name, reason, started)
        if coarse:
            result = self._arrived(scene, coarse, box, name, started)
            if result.status.valid or result.status is Status.OUT_OF_RANGE:
                return result
        run = self._run(scene, mesh, self.settings, box.size)
        followed = _result(run, mesh, run.follow(start), started, name)
        if coarse:
            followed.evidence["fell_back"] = result.evidence.get("reason") or result.status.value
        return followed

    def _arrived(
        self, scene: Scene, coarse: "CoarseFrame", box: FineBox, name: HexMeshName, started: float
    ) -> HexResult:
        """The end of a coarse path, solved on the fine hexahedra."""
        mesh = self.mesh(scene.gel, box)
        run = self._run(scene, mesh, self.settings, box.size)
        result = _result(run, mesh, run.arrive(coarse.path), started, name)
        if not result.status.valid and run.settings.walk_mm > self.settings.walk_mm:
            shorter = replace(run.settings, walk_mm=self.settings.walk_mm)
            run = ScenePath(scene, shorter, mesh, self._system(mesh))
            result = _result(run, mesh, run.arrive(coarse.path), started, name)
        # the coarse curve, scaled so that it ends at the fine force
        scale = float(np.linalg.norm(result.total)) / max(coarse.force, np.finfo(float).tiny)
        curve = [[t, *(scale * np.array(force)).tolist()] for t, *force in coarse.curve[:-1]]
        result.evidence |= {"path": [*curve, [float(run.t), *result.total.tolist()]]}
        return result

    def _extrapolate(self, scene: Scene, coarse: "CoarseFrame | None", box: FineBox, result: HexResult) -> None:
        """Correct a result by extrapolation from two sizes of hexahedra, and state the remaining error."""
        force = float(np.linalg.norm(result.total))
        contact, nested = result.contact, self.settings.nested
        numbers = nested.convergence if nested else None
        if result.status is not Status.OK or contact is None or force == 0.0:
            return
        edge = edge_of(contact, sharpness(scene, box.size), box.size, scene.gel.height)
        evidence = result.evidence
        if coarse is None or numbers is None or edge is None:
            evidence |= {"error_n": UNCORRECTED * force, "cells_error_n": UNCORRECTED_CELLS * force}
            return
        difference = coarse.force / force - 1.0
        share = numbers.error(edge, difference, scene.interface.contact.frictional)
        factor = 1.0 / (1.0 + numbers.correction(edge, difference))
        # base reactions scale with the forces, so they stay balanced; new arrays, because equal frames share them
        result.forces = factor * result.forces
        result.contact = replace(contact, traction=factor * contact.traction)
        evidence |= {
            "path": [[t, *(factor * np.array(step)).tolist()] for t, *step in evidence["path"]], "extrapolated": factor,
            "error_n": share * factor * force, "cells_error_n": numbers.cells * edge.near * factor * force,
        }  # fmt: skip

    def _box(self, scene: Scene) -> FineBox:
        size = min(self.settings.size, round(WIDEST * scene.gel.height, 2))
        return self.settings.box or fine_box(scene, size, self.settings.across)

    def _run(self, scene: Scene, mesh: HexMesh, settings: HexSettings, size: float) -> ScenePath:
        steps = fitted(replace(settings, size=size), scene, first_touch(scene) or 0.0)
        return ScenePath(scene, steps, mesh, self._system(mesh))

    def _mesh(self, gel: Gel, box: FineBox, s: HexSettings) -> HexMesh:
        shape = _shape(gel, box, s)
        return self._meshes.get((gel, box, shape), lambda: build_mesh(gel, box, *shape))

    def _mesh_name(self, gel: Gel, box: FineBox) -> HexMeshName:
        return HexMeshName(gel.name, box, *_shape(gel, box, self.settings))

    def _system(self, mesh: HexMesh) -> System:
        """Matrix and factorisation, shared by meshes with the same sparsity pattern."""
        return self._systems.get(mesh.pattern_key, lambda: System(mesh))

    def _no_contact(self, scene: Scene, started: float) -> HexResult:
        gel = scene.gel
        s = self.settings
        box = s.box or FineBox(-gel.width / 4, gel.width / 4, -gel.length / 4, gel.length / 4, 2 * s.size)
        mesh = self.mesh(gel, box)
        zero = np.zeros_like(mesh.nodes)
        evidence = _evidence(unknown=0.0)
        evidence["seconds"] = time.perf_counter() - started
        return HexResult(Status.NO_CONTACT, zero, zero.copy(), evidence, mesh, None, self._mesh_name(gel, box))


@dataclass(frozen=True)
class CoarseFrame:
    """A press on coarse hexahedra up to one frame.

    path: its states. curve: converged load steps [path parameter of a press that ends at the frame, fx, fy, fz], N.
    """

    path: LoadPath
    curve: list[list[float]]

    @property
    def force(self) -> float:
        """Size of the total force, N."""
        return float(np.linalg.norm(self.curve[-1][1:]))


def _shape(gel: Gel, box: FineBox, s: HexSettings) -> tuple[int, float, float, float, tuple[int, ...]]:
    """Arguments of `build_mesh` after gel and box: layers, layer_ratio, growth, largest, widened."""
    layers, ratio = s.layers, s.layer_ratio
    if box.size <= s.thin_below:
        layers, ratio = thinner_layers(layers, ratio, gel.height, FLATNESS * box.size, s.steepness)
    # added layers become wide ones: the number of fine upper layers stays
    return layers, ratio, s.growth, s.largest, tuple(count + layers - s.layers for count in s.widened)


def _until(curve: list[list[float]], t: float) -> list[list[float]]:
    """Load steps up to t, with the path parameters of a press that ends at t."""
    before = [row for row in curve if row[0] <= t]
    if t <= 1.0:
        return [[at / t, *force] for at, *force in before]
    return [[at if at <= 1.0 else 1.0 + (at - 1.0) / (t - 1.0), *force] for at, *force in before]


def _below_base(scene: Scene) -> str | None:
    """The reason to refuse a press that begins inside the gel or ends at or below its base; None for other presses."""
    if touch.begins_inside(scene.gel, scene.indenter, scene.press):
        return f"the press begins inside the gel, with its tip at z = {scene.press.z0:.3g} mm"
    lowest = scene.press.z0 + scene.press.dz
    if lowest > -scene.gel.height or first_touch(scene) is None:
        return None
    return f"the tip ends at z = {lowest:.3g} mm, at or below the gel's base at {-scene.gel.height:g} mm"


class _Kept:
    """Cache of the `size` most recently used items."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._items: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        if key not in self._items:
            self._items[key] = make()
        self._items.move_to_end(key)
        while len(self._items) > self._size:
            self._items.popitem(last=False)
        return self._items[key]


def _result(run: ScenePath, mesh: HexMesh, status: Status, started: float, name: HexMeshName) -> HexResult:
    """Result at the end of a path: forces, evidence and contact state."""
    evidence = _evidence(run.residual, run.iterations, run.rounds, run.steps)
    forces = np.zeros_like(run.u)
    if status is not Status.DIVERGED:
        forces = run.contact_forces()
        evidence |= run.checks(forces) | run.friction()
        if evidence["base_mismatch"] > BALANCE:
            status = Status.UNBALANCED
        elif evidence.get("beyond_cone", 0.0) > BEYOND_CONE:
            status = Status.UNSETTLED
        elif not forces.any():
            status = Status.TOO_COARSE
        elif reason := _impossible(evidence):
            status = Status.OUT_OF_RANGE
            evidence["reason"] = f"{reason}; {status.value}"
            forces = np.zeros_like(run.u)
    elif run.reason:
        evidence["reason"] = run.reason
    run.record()
    evidence["path"] = run.curve
    evidence |= {"reached": float(run.t), "cuts": run.control.cuts}
    evidence["seconds"] = time.perf_counter() - started
    return HexResult(status, forces, run.u, evidence, mesh, run.state, name)


def _impossible(evidence: dict) -> str | None:
    """The reason why an equilibrium that was found is not physical; None if it is."""
    inside, below = evidence["penetration_mm"], evidence["below_base_mm"]
    if inside > MOST_INSIDE_MM:
        return f"the indenter ends {inside:.2g} mm inside the gel, at most {MOST_INSIDE_MM:g} mm is allowed"
    if below > MOST_BELOW_MM:
        return f"the gel is pressed {below:.2g} mm through its own base"
    return None


def _refused(mesh: HexMesh, name: HexMeshName, reason: str, started: float) -> HexResult:
    """Result for a press that its geometry rules out: nothing is solved, forces are zero."""
    zero = np.zeros_like(mesh.nodes)
    evidence = _evidence() | {"reason": f"{reason}; {Status.OUT_OF_RANGE.value}"}
    evidence["seconds"] = time.perf_counter() - started
    return HexResult(Status.OUT_OF_RANGE, zero, zero.copy(), evidence, mesh, None, name)


def _evidence(
    residual: float = 0.0, iterations: int = 0, rounds: int = 0, steps: int = 0, unknown: float = np.nan
) -> dict:
    return {
        "equilibrium_residual": float(residual),
        "penetration_mm": unknown,
        "below_base_mm": unknown,
        "pulling_fraction": unknown,
        "base_mismatch": unknown,
        "newton_iterations": int(iterations),
        "rounds": int(rounds),
        "load_steps": int(steps),
    }
