"""How a press is solved: the methods, the fallbacks if one fails, and the key under which a solve is stored.

Methods: hexahedra in process at a quality ("draft", "label", "fine"), CalculiX ("ccx"), or "auto", which tries
"draft", "label" and "ccx" until one states an error within `tolerance`.
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
from gelforge.geometry.gel import Gel, gel_shape, load_gel
from gelforge.mechanics.ccx.program import need_ccx
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.mesh.basemesh import base_of
from gelforge.mechanics.path.transfer import LoadPath
from gelforge.mechanics.result import Result, Solve
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.ccx import CELLS_ERROR, ERROR, CcxSettings, CcxSolver, mesh_of
from gelforge.mechanics.solvers.ccxcontact import CELLS_ERROR as CONTACT_CELLS
from gelforge.mechanics.solvers.ccxcontact import ERROR as CONTACT_ERROR
from gelforge.mechanics.solvers.ccxcontact import INCREMENTS, ContactSettings, solve_contact
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.status import Status

# Quality of the hexahedra that give the load path of `ccx`, and that solve a press if `ccx` finds no valid state.
GUIDE = "label"
# Fields of CcxSettings that do not change a result. A press that ran out of time is solved again once the limit is
# raised (stages/fea.py).
NO_RESULT = {"timeout_s"}
OVERDUE = {"stopped_after_s"}  # evidence that a press ran out of time
FINER = 4  # times as many load steps where a press on hexahedra failed


class Solvers:
    """Solvers, kept between scenes. workdir: folder for CalculiX' files, of this process alone. settings: [fea]."""

    def __init__(self, workdir: Path | str, settings: FeaTable) -> None:
        self.workdir, self.settings = Path(workdir), settings
        self.ccx = CcxSettings.of(settings)
        self.contact = ContactSettings.of(settings)
        self.guide = HexSolver(quality(GUIDE))
        self._hex: dict[tuple[str, int], HexSolver] = {}

    def solve(self, scene: Scene, method: str) -> Result:
        """Solve by a method, one of METHODS.

        Forces (n, 3) N on the gel and displacement (n, 3) mm belong to the mesh named by evidence["mesh"];
        evidence["method"] is the method that solved it. A failed solve is a status with its reason in the evidence.
        An unknown method or gel and a missing CalculiX raise BadInput, a full disk raises OSError.
        """
        return self.solve_frames([scene], method)[0]

    def solve_frames(self, scenes: Sequence[Scene], method: str) -> list[Result]:
        """Solve the frames of one press, scenes in order of time along one path; one result each, as from `solve`.

        The path is followed once for all of them, on coarse hexahedra ("fine": on its own).
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
            if load_gel(gel.name) != gel:  # the mesh could not be rebuilt from its name
                raise BadInput(
                    f"the scene's gel {gel.name!r} differs from the known gel of that name; give it another name"
                )
        return [
            self._first_valid(scene, tries) for scene, tries in zip(scenes, self._tries(scenes, method), strict=True)
        ]

    def _within_tolerance(self, scenes: Sequence[Scene]) -> list[Result]:
        """Results of the first method of TAKEN whose stated error is within `tolerance`, else of the least error.

        The error at the end of the press counts. CalculiX states the same relative error for every press, so it is
        skipped if hexahedra state a smaller one.
        """
        tried: list[tuple[float, list[Result]]] = []
        for method in TAKEN:
            if method == "ccx" and min(share for share, _ in tried) <= self.ccx.coarser(ERROR):
                continue
            found = self.solve_frames(scenes, method)
            tried.append((found[-1].error_share, found))
            if tried[-1][0] <= self.settings.tolerance:
                return found
        return min(tried, key=lambda one: one[0])[1]

    def _tries(self, scenes: Sequence[Scene], method: str) -> list[list[tuple[str, Solve]]]:
        """For each scene, the requested method and its fallbacks, by name; the common path is followed here.

        Fallbacks are smaller load steps, more contact iterations, and hexahedra in place of CalculiX.
        """
        if method == "ccx-contact":
            tried = ("ccx-contact", INCREMENTS[0]), ("ccx-contact, smaller increments", INCREMENTS[1])
            return [
                [*((name, partial(self._solve_contact, increment=first)) for name, first in tried),
                 (GUIDE, lambda scene: self._solve_hex([scene], GUIDE)[0])]
                for _ in scenes
            ]  # fmt: skip
        if method in IN_PROCESS:
            smaller: Solve = lambda scene: self._solve_hex([scene], method, FINER)[0]  # noqa: E731
            found = self._solve_hex(scenes, method)
            return [[(method, _answer(each)), (f"{method}, smaller load steps", smaller)] for each in found]
        tries: list[list[tuple[str, Solve]]] = []
        for frame in self.guide.coarse_path(scenes):
            shown = frame.path if frame else None
            solve = partial(self._solve_ccx, shown=shown)
            tries.append([
                ("ccx", partial(solve, coarse_path=shown)), ("ccx, smaller load steps", partial(solve, steps=3)),
                ("ccx, more contact rounds", partial(solve, steps=3, rounds=3)),
                (GUIDE, lambda scene: self._solve_hex([scene], GUIDE)[0]),
            ])  # fmt: skip
        return tries

    def _first_valid(self, scene: Scene, tries: list[tuple[str, Solve]]) -> Result:
        """The first valid result of the tries, else the last one; its evidence lists the failed tries.

        After a try that the time limit stopped, the others of the same method are passed over: they take longer.
        """
        failed: list[str] = []
        overdue: dict[str, Any] = {}
        for name, attempt in tries:
            if overdue and name.startswith(tries[0][0]):
                continue
            result = attempt(scene)
            result.evidence["attempt"] = name
            # if CalculiX disagrees with the solver in process, no fallback makes its answer right
            if result.status.valid or result.status is Status.DISAGREES:
                break
            overdue |= {key: result.evidence[key] for key in OVERDUE & set(result.evidence)}
            failed.append(f"{name}: {result.status.name}, {result.evidence.get('reason') or result.status.value}")
        if result.evidence["method"] != tries[0][0]:
            result.evidence |= overdue  # CalculiX may solve it with a higher time limit
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
        """Solve by CalculiX on a mesh refined for the contact found by `shown`, a path on hexahedra."""
        base = self.ccx
        mesh = mesh_of(scene, shown, base.edge_mm, base.inside_mm)
        solver = CcxSolver(mesh.mesh(), self.workdir, replace(base, rounds=rounds * base.rounds))
        result = solver.solve(scene, coarse_path=coarse_path, finer=steps)
        force = float(np.linalg.norm(result.total))
        result.evidence |= {
            "mesh": mesh.name,
            "method": "ccx",
            "error_n": self.ccx.coarser(ERROR) * force,
            "cells_error_n": self.ccx.coarser(CELLS_ERROR) * force,
        }
        return result

    def _solve_contact(self, scene: Scene, increment: float) -> Result:
        """Solve by CalculiX' own contact on a mesh with even edges under the indenter."""
        size = self.contact.contact_mm
        mesh = mesh_of(scene, None, size, size, np.inf)
        result = solve_contact(scene, mesh.mesh(), self.workdir, self.contact, increment)
        force = float(np.linalg.norm(result.total))
        result.evidence |= {
            "mesh": mesh.name, "method": "ccx-contact", "error_n": CONTACT_ERROR * force, "cells_error_n": CONTACT_CELLS * force,
        }  # fmt: skip
        return result

    def _solve_hex(self, scenes: Sequence[Scene], method: str, finer: int = 1) -> list[Result]:
        """Solve on hexahedra refined under the press; evidence["mesh"] is the name of the mesh."""
        if (method, finer) not in self._hex:
            self._hex[method, finer] = HexSolver(quality(method).with_steps(finer))
        results = self._hex[method, finer].solve_frames(scenes)
        for result in results:
            result.evidence |= {"mesh": result.mesh_name.name if result.mesh_name else "", "method": method}
        return list(results)


def _answer(found: Result) -> Solve:
    """A result that was found already, as a solving function."""
    return lambda scene: found


# -- keys


def solve_key(frames: Sequence[Scene], shape: Any, how: Any, version: int, at: int = -1) -> str:
    """Key of frame `at` of a press, whose frames share one path: a digest of exactly what changes its result.

    It covers content and numbers, no names. shape: the indenter's surface, as a digest or as the numbers that it is
    built from. how: settings of the solver, see `settings_of` and `hexahedra_key`. version: of the solver's results.
    """
    scenes = [frames[0].direct] if len(frames) == 1 else list(frames)
    scene = scenes[at]
    law = [scene.interface.law, scene.interface.contact.coefficient]
    path = [asdict(each.press) for each in scenes] if len(scenes) > 1 else []
    return digest_of_value(
        [version, asdict(scene.press), path, gel_shape(scene.gel), asdict(scene.material), law, shape, how]
    )


def hexahedra_key(settings: HexSettings) -> list:
    """Settings that change the result of a solve on hexahedra."""
    return ["hex", asdict(settings)]


def settings_of(method: str, fea: FeaTable, gel: Gel) -> list:
    """Settings of [fea] that change the result of a method, with the digest of the gel's base mesh if it needs one."""
    if method in IN_PROCESS:
        return hexahedra_key(quality(method))
    if method == "auto":
        return [method, fea.tolerance, *(settings_of(one, fea, gel) for one in TAKEN)]
    if method == "ccx-contact":
        own = {f.name: getattr(fea, f.name) for f in fields(ContactSettings) if f.name not in NO_RESULT}
        return [method, base_of(gel).digest, own, asdict(quality(GUIDE))]
    ccx = {key: value for key, value in asdict(CcxSettings.of(fea)).items() if key not in NO_RESULT}
    return [method, base_of(gel).digest, ccx, asdict(quality(GUIDE))]
