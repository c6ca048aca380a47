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
from gelforge.mechanics.path.transfer import LoadPath
from gelforge.mechanics.result import Result, Solve
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.ccx import CcxSettings, CcxSolver, mesh_of
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.status import Status

# Hexahedra on which the load path of `ccx` is found, and which solve a press for which it finds no valid state.
GUIDE = "label"
# Of CcxSettings: how long CalculiX may run. A press that it stopped is solved again where it may take longer (stages/fea.py).
NO_RESULT = {"timeout_s"}
OVERDUE = {"stopped_after_s"}  # evidence of that
# Of the force that `ccx` may be off in total, and summed over cells: nine of ten presses of known force, and scenes, are within.
CCX_ERROR, CCX_CELLS = 0.024, 0.048
FINER = 4  # times as many load steps where a press on hexahedra failed


class Solvers:
    """Solvers that are kept between scenes; files of CalculiX lie in `workdir`, of this process alone. settings: [fea]."""

    def __init__(self, workdir: Path | str, settings: FeaTable) -> None:
        self.workdir, self.settings = Path(workdir), settings
        self.ccx = CcxSettings.of(settings)
        self.guide = HexSolver(quality(GUIDE))
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
        for gel in {scene.gel for scene in scenes}:
            if load_gel(gel.name) != gel:  # of which the mesh could not be made again by its name
                raise BadInput(f"gel {gel.name!r} of the scene is not the one of that name; give it one of its own")
        return [
            self._first_valid(scene, tries) for scene, tries in zip(scenes, self._tries(scenes, method), strict=True)
        ]

    def _within_tolerance(self, scenes: Sequence[Scene]) -> list[Result]:
        """The first of TAKEN whose stated error at the end of the press is within `tolerance`, else the one of the least.

        CalculiX states the same share of every press, so it is not asked where hexahedra state less.
        """
        tried: list[tuple[float, list[Result]]] = []
        for method in TAKEN:
            if method == "ccx" and min(share for share, _ in tried) <= CCX_ERROR:
                continue
            found = self.solve_frames(scenes, method)
            tried.append((found[-1].error_share, found))
            if tried[-1][0] <= self.settings.tolerance:
                return found
        return min(tried, key=lambda one: one[0])[1]

    def _tries(self, scenes: Sequence[Scene], method: str) -> list[list[tuple[str, Solve]]]:
        """By scene, how it is solved as asked, and what is tried where that fails, by name; a path of several is followed here.

        That is smaller load steps, more contact iterations, and hexahedra for CalculiX.
        """
        if method in IN_PROCESS:
            smaller: Solve = lambda scene: self._solve_hex([scene], method, FINER)[0]  # noqa: E731
            found = self._solve_hex(scenes, method)
            return [[(method, _answer(each)), (f"{method}, smaller load steps", smaller)] for each in found]
        tries: list[list[tuple[str, Solve]]] = []
        # with Coulomb friction a force depends on all of a point's slip, so its path is followed on the tetrahedra
        slips = scenes[-1].interface.contact.frictional
        for frame in self.guide.coarse_path(scenes):
            shown = frame.path if frame else None
            solve = partial(self._solve_ccx, shown=shown)
            tries.append([
                ("ccx", partial(solve, coarse_path=None if slips else shown)), ("ccx, smaller load steps", partial(solve, steps=3)),
                ("ccx, more contact rounds", partial(solve, steps=3, rounds=3)),
                (GUIDE, lambda scene: self._solve_hex([scene], GUIDE)[0]),
            ])  # fmt: skip
        return tries

    def _first_valid(self, scene: Scene, tries: list[tuple[str, Solve]]) -> Result:
        """The first valid result of the tries, else the last one, with what failed before it."""
        failed: list[str] = []
        overdue: dict[str, Any] = {}
        for name, attempt in tries:
            result = attempt(scene)
            result.evidence["attempt"] = name
            # where CalculiX computes otherwise than this process, no other way makes its answer right
            if result.status.valid or result.status is Status.DISAGREES:
                break
            overdue |= {key: result.evidence[key] for key in OVERDUE & set(result.evidence)}
            failed.append(f"{name}: {result.status.name}, {result.evidence.get('reason') or result.status.value}")
        if result.evidence["method"] != tries[0][0]:
            result.evidence |= overdue  # CalculiX may solve it where it may take longer
        if result.status.valid and result.evidence["method"] != tries[0][0]:
            result.evidence["replaced"] = f"solved by {result.evidence['method']}, because {failed[0]}"
        result.evidence["failed_attempts"] = failed + result.evidence.get("failed_attempts", [])
        return result

    def _solve_ccx(
        self,
        scene: Scene,
        shown: LoadPath | None,
        steps: int = 1,
        rounds: int = 1,
        coarse_path: LoadPath | None = None,
    ) -> Result:
        """Solve by CalculiX on a mesh by the contact that a path on hexahedra has shown."""
        base = self.ccx
        finer = replace(base, press_steps=steps * base.press_steps, shear_steps=steps * base.shear_steps,
                        step_mm=base.step_mm / steps, rounds=rounds * base.rounds)  # fmt: skip
        mesh = mesh_of(scene, shown, base.edge_mm, base.inside_mm)
        result = CcxSolver(mesh.mesh(), self.workdir, finer).solve(scene, coarse_path=coarse_path)
        force = float(np.linalg.norm(result.total))
        result.evidence |= {
            "mesh": mesh.name,
            "method": "ccx",
            "error_n": CCX_ERROR * force,
            "cells_error_n": CCX_CELLS * force,
        }
        return result

    def _solve_hex(self, scenes: Sequence[Scene], method: str, finer: int = 1) -> list[Result]:
        """Solve on hexahedra that follow the press; a result's mesh is a name that holds all numbers of it."""
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
    from. how: settings of the solver, see `settings_of` and `hexahedra_key`. version: of the
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


def settings_of(method: str, fea: FeaTable) -> list:
    """What of [fea] changes the result of a press that is solved by a method."""
    if method in IN_PROCESS:
        return hexahedra_key(quality(method))
    if method == "auto":
        return [method, fea.tolerance, *(settings_of(one, fea) for one in TAKEN)]
    ccx = {f.name: getattr(fea, f.name) for f in fields(CcxSettings) if f.name not in NO_RESULT}
    return [method, ccx, asdict(quality(GUIDE))]
