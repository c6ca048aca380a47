"""How a press is solved: the methods, what is tried where one fails, and the key by which a solve is found again.

A method is one name: hexahedra in process at a quality ("draft", "label", "fine"), CalculiX ("ccx"), or "auto", which goes
from "draft" to "label" to "ccx" until one states an error within `tolerance`.
"""

from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import digest_of_value
from gelforge.flow.tables import IN_PROCESS, METHODS, TAKEN, FeaTable
from gelforge.geometry.gel import gel_shape, load_gel
from gelforge.mechanics.ccx.program import need_ccx
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.mesh.family import MeshFamily, choose_mesh, unplaced
from gelforge.mechanics.path.transfer import LoadPath
from gelforge.mechanics.result import Result, Solve
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.ccx import CcxSettings, CcxSolver
from gelforge.mechanics.solvers.hex import HexSolver

# Hexahedra on which the load path of `ccx` is found, and which solve a press for which it finds no valid state.
GUIDE = "label"
# Of CcxSettings: how long CalculiX may run. A press that it stopped is solved again where it may take longer (stages/fea.py).
NO_RESULT = {"timeout_s"}
CCX_ERROR, CCX_CELLS = (
    0.045,
    0.14,
)  # of the force that `ccx` may be off: nine of ten presses of known force, and scenes, are within
FINER = 4  # times as many load steps where a press on hexahedra failed


class Solvers:
    """Solvers of one family of tetrahedral meshes, kept between scenes; files of a solve lie in `workdir`, settings: [fea].

    family: of meshes of the gel that all scenes sit on; hexahedra follow the gel of each scene. workdir: of this process alone.
    """

    def __init__(self, family: MeshFamily, workdir: Path | str, settings: FeaTable) -> None:
        self.family, self.workdir, self.settings = family, Path(workdir), settings
        self.ccx = CcxSettings.of(settings)
        self.guide = HexSolver(quality(GUIDE))
        self._ccx: dict[str, CcxSolver] = {}
        self._hex: dict[tuple[str, int], HexSolver] = {}

    def solve(self, scene: Scene, method: str) -> Result:
        """Solve by a method, one of METHODS.

        Forces (n, 3) N on the gel and displacement (n, 3) mm are those of the mesh named by evidence["mesh"];
        evidence["method"] is what solved it. A failed solve is a status with its reason in the evidence; a missing CalculiX
        or a full disk raises BadInput.
        """
        return self.solve_frames([scene], method)[0]

    def solve_frames(self, scenes: Sequence[Scene], method: str) -> list[Result]:
        """Solve frames of one press, scenes in order of time along one path; one result each, as `solve` gives it.

        Without slip their path is followed once, on coarse hexahedra, for all of them.
        """
        if method not in METHODS:
            raise BadInput(f"method = {method!r} is unknown; choose one of {', '.join(METHODS)}")
        if len(scenes) == 1:
            scenes = [scenes[0].direct]
        if method == "auto":
            return self._within_tolerance(scenes)
        if method not in IN_PROCESS:
            need_ccx()
        first = self._as_asked(scenes, method)
        return [self._with_fallbacks(scene, method, attempt) for scene, attempt in zip(scenes, first, strict=True)]

    def _within_tolerance(self, scenes: Sequence[Scene]) -> list[Result]:
        """The first of TAKEN whose stated error at the end of the press is within `tolerance`, else the one of the least."""
        tried: list[tuple[float, list[Result]]] = []
        for method in TAKEN:
            found = self.solve_frames(scenes, method)
            tried.append((found[-1].error_share, found))
            if tried[-1][0] <= self.settings.tolerance:
                return found
        return min(tried, key=lambda one: one[0])[1]

    def _as_asked(self, scenes: Sequence[Scene], method: str) -> list[Solve]:
        """How each scene is solved as asked; where a path serves several of them it is followed here."""
        if method in IN_PROCESS:
            return [_answer(found) for found in self._solve_hex(scenes, method)]
        frames = self.guide.coarse_path(scenes)
        # with Coulomb friction a force depends on all of a point's slip, so its path is followed on the tetrahedra
        slips = scenes[-1].interface.contact.frictional
        paths = [None if slips or frame is None else frame.path for frame in frames]
        return [partial(self._solve_ccx, coarse_path=path) for path in paths]

    def _with_fallbacks(self, scene: Scene, method: str, first: Solve) -> Result:
        """The first valid result of the attempts, else the last one, with what failed before it."""
        failed = []
        for name, attempt in [(method, first), *self._fallbacks(method)]:
            result = attempt(scene)
            result.evidence["attempt"] = name
            if result.status.valid:
                break
            failed.append(f"{name}: {result.status.name}, {result.evidence.get('reason') or result.status.value}")
        result.evidence["failed_attempts"] = failed + result.evidence.get("failed_attempts", [])
        return result

    def _fallbacks(self, method: str) -> list[tuple[str, Solve]]:
        """What is tried where solving as asked fails: smaller load steps, more contact iterations, hexahedra for CalculiX."""
        if method in IN_PROCESS:
            return [(f"{method}, smaller load steps", lambda scene: self._solve_hex([scene], method, FINER)[0])]
        return [
            ("ccx, smaller load steps", partial(self._solve_ccx, steps=3)),
            ("ccx, more contact rounds", partial(self._solve_ccx, steps=3, rounds=3)),
            (GUIDE, lambda scene: self._solve_hex([scene], GUIDE)[0]),
        ]

    def _solve_ccx(
        self, scene: Scene, steps: int = 1, rounds: int = 1, coarse_path: LoadPath | None = None
    ) -> Result:
        mesh, base = choose_mesh(scene, self.family), self.ccx
        finer = replace(base, press_steps=steps * base.press_steps, shear_steps=steps * base.shear_steps,
                        step_mm=base.step_mm / steps, rounds=rounds * base.rounds)  # fmt: skip
        result = self._ccx_on(mesh).solve(scene, settings=finer, coarse_path=coarse_path)
        result.evidence |= {"mesh": mesh, "method": "ccx"}
        force = float(np.linalg.norm(result.total))
        result.evidence |= {"error_n": CCX_ERROR * force, "cells_error_n": CCX_CELLS * force}
        return result

    def _ccx_on(self, mesh: str) -> CcxSolver:
        """The solver of a mesh; one whose fine part is moved shares all that it can with the one it is made from."""
        own, _ = unplaced(mesh)
        if own not in self._ccx:
            self._ccx[own] = CcxSolver(self.family.load(own), self.workdir / own, self.ccx)
        solver = self._ccx[own]
        return solver if mesh == own else solver.on(self.family.load(mesh), self.workdir / mesh)

    def _solve_hex(self, scenes: Sequence[Scene], method: str, finer: int = 1) -> list[Result]:
        """Solve on hexahedra that follow the press; a result's mesh is a name that holds all numbers of it."""
        for gel in {scene.gel for scene in scenes}:
            if load_gel(gel.name) != gel:
                raise BadInput(f"gel {gel.name!r} of the scene is not the one of that name; give it one of its own")
        if (method, finer) not in self._hex:
            self._hex[method, finer] = HexSolver(quality(method).with_steps(finer))
        results = self._hex[method, finer].solve_frames(scenes)
        for result in results:
            result.evidence |= {"mesh": result.mesh_name.name if result.mesh_name else "", "method": method}
        return list(results)


def _answer(found: Result) -> Solve:
    """What was solved already, as a method of solving it."""
    return lambda scene: found


# -- keys


def solve_key(frames: Sequence[Scene], shape: Any, how: Any, version: int, at: int = -1) -> str:
    """Key of frame `at` of a press, whose frames share one path: a digest of exactly what changes its result.

    Content and numbers, no names. shape: what the indenter's surface is, as a digest of it or the numbers that it is built
    from. how: settings of the solver and the content of its mesh, see `settings_of` and `hexahedra_key`. version: of the
    solver's answers.
    """
    scenes = [frames[0].direct] if len(frames) == 1 else list(frames)
    scene = scenes[at]
    law = [scene.interface.law, scene.interface.contact.coefficient]
    path = [asdict(each.press) for each in scenes] if len(scenes) > 1 else []
    return digest_of_value(
        [version, asdict(scene.press), path, gel_shape(scene.gel), asdict(scene.material), law, shape, how]
    )


def hexahedra_key(settings: HexSettings) -> list:
    """What of a solve on hexahedra changes its result."""
    return ["hex", asdict(settings)]


def settings_of(method: str, fea: FeaTable, mesh: str) -> list:
    """What of [fea] changes the result of a press that is solved by a method.

    mesh: name of its tetrahedra, which has a digest of their content.
    """
    if method in IN_PROCESS:
        return hexahedra_key(quality(method))
    if method == "auto":
        return [method, fea.tolerance, *(settings_of(one, fea, mesh) for one in TAKEN)]
    ccx = {f.name: getattr(fea, f.name) for f in fields(CcxSettings) if f.name not in NO_RESULT}
    return [method, ccx, mesh, asdict(quality(GUIDE))]
