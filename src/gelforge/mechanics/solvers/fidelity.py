"""One interface to every method of solving a scene, with the fallbacks where an attempt fails."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.params.tables import FIDELITIES, IN_PROCESS, FeaTable
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.ccx.program import need_ccx
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.mesh.family import MeshFamily, choose_mesh, unplaced
from gelforge.mechanics.path.transfer import LoadPath
from gelforge.mechanics.result import Result, Solve
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.auto import SolveMethod, method_of
from gelforge.mechanics.solvers.ccx import CcxSettings, CcxSolver
from gelforge.mechanics.solvers.hex import HexSolver

GUIDE = "label"  # quality of the hexahedra on which the load path of `ccx` is found


class Solvers:
    """Solvers of one family of tetrahedral meshes, kept between scenes; files of a solve lie in `workdir`, settings: [fea].

    family: of meshes of the gel that all scenes sit on; hexahedra follow the gel of each scene. workdir: of this process alone.
    """

    def __init__(self, family: MeshFamily, workdir: Path | str, settings: FeaTable) -> None:
        self.family, self.workdir, self.settings = family, Path(workdir), settings
        self.ccx = CcxSettings.of(settings)
        quality(settings.hex_quality)  # a name that is none is refused before anything is solved
        self.guide = HexSolver(quality(GUIDE))
        self._ccx: dict[str, CcxSolver] = {}
        self._hex: dict[tuple[str, int], HexSolver] = {}

    def solve(self, scene: Scene, fidelity: str) -> Result:
        """Solve at one fidelity, or the cheapest that is good enough for "auto".

        Forces (n, 3) N on the gel and displacement (n, 3) mm are those of the mesh named by evidence["mesh"]. A failed
        solve is a status with its reason in the evidence; a missing CalculiX or a full disk raises BadInput.
        """
        return self.solve_frames([scene], fidelity)[0]

    def solve_frames(self, scenes: Sequence[Scene], fidelity: str) -> list[Result]:
        """Solve frames of one press, scenes in order of time along one path; one result each, as `solve` gives it.

        Without slip their path is followed once, on coarse hexahedra, for all of them.
        """
        if fidelity not in FIDELITIES:
            raise BadInput(f"fidelity {fidelity!r} is unknown; choose one of {', '.join(FIDELITIES)}")
        if len(scenes) == 1:
            scenes = [scenes[0].direct]
        method = method_of(scenes[-1], fidelity, self.settings)
        if method.fidelity not in IN_PROCESS:
            need_ccx()
        first = self._as_asked(scenes, method)
        results = [self._with_fallbacks(scene, method, attempt) for scene, attempt in zip(scenes, first, strict=True)]
        for result in results:
            result.evidence |= method.why
        return results

    def _as_asked(self, scenes: Sequence[Scene], method: SolveMethod) -> list[Solve]:
        """How each scene is solved as asked; where a path serves several of them it is followed here."""
        if method.fidelity == "hex":
            return [_answer(found) for found in self._solve_hex(scenes, method.hexahedra)]
        if method.fidelity == "ccx":
            frames = self.guide.coarse_path(scenes)
            return [partial(self._solve_ccx, coarse_path=frame.path if frame else None) for frame in frames]
        # a reference owes nothing to the hexahedra
        alone = self._solve_native if method.fidelity == "ccx-native" else self._solve_ccx
        return [alone] * len(scenes)

    def _with_fallbacks(self, scene: Scene, method: SolveMethod, first: Solve) -> Result:
        """The first valid result of the attempts, else the last one, with what failed before it."""
        failed = []
        for name, attempt in [(method.fidelity, first), *self._fallbacks(method.fidelity, method.hexahedra)]:
            result = attempt(scene)
            result.evidence["attempt"] = name
            if result.status.valid:
                break
            failed.append(f"{name}: {result.status.name}, {result.evidence.get('reason') or result.status.value}")
        result.evidence["failed_attempts"] = failed + result.evidence.get("failed_attempts", [])
        result.evidence.setdefault("fidelity", method.fidelity)
        return result

    def _fallbacks(self, fidelity: str, hexahedra: str) -> list[tuple[str, Solve]]:
        """What is tried where solving as asked fails: smaller load steps, more contact iterations, another fidelity."""
        if fidelity == "hex":
            return [("hex, smaller load steps", lambda scene: self._solve_hex([scene], hexahedra, 4)[0])]
        if fidelity == "ccx-native":
            return []
        finer: list[tuple[str, Solve]] = [
            (f"{fidelity}, smaller load steps", partial(self._solve_ccx, steps=3)),
            (f"{fidelity}, more contact rounds", partial(self._solve_ccx, steps=3, rounds=3)),
        ]
        # a reference is CalculiX' or none
        return (
            finer
            if fidelity == "ccx-fine"
            else [*finer, ("hex", lambda scene: self._solve_hex([scene], hexahedra)[0])]
        )

    def _solve_ccx(
        self, scene: Scene, steps: int = 1, rounds: int = 1, coarse_path: LoadPath | None = None
    ) -> Result:
        mesh, base = choose_mesh(scene, self.family), self.ccx
        finer = replace(base, press_steps=steps * base.press_steps, shear_steps=steps * base.shear_steps,
                        step_mm=base.step_mm / steps, rounds=rounds * base.rounds)  # fmt: skip
        result = self._ccx_on(mesh).solve(scene, settings=finer, coarse_path=coarse_path)
        result.evidence |= {"mesh": mesh}
        return result

    def _ccx_on(self, mesh: str) -> CcxSolver:
        """The solver of a mesh; one whose fine part is moved shares all that it can with the one it is made from."""
        own, _ = unplaced(mesh)
        if own not in self._ccx:
            self._ccx[own] = CcxSolver(self.family.load(own), self.workdir / own, self.ccx)
        solver = self._ccx[own]
        return solver if mesh == own else solver.on(self.family.load(mesh), self.workdir / mesh)

    def _solve_hex(self, scenes: Sequence[Scene], hexahedra: str, steps: int = 1) -> list[Result]:
        """Solve on hexahedra that follow the press; a result's mesh is a name that holds all numbers of it."""
        for gel in {scene.gel for scene in scenes}:
            if load_gel(gel.name) != gel:
                raise BadInput(f"gel {gel.name!r} of the scene is not the one of that name; give it one of its own")
        if (hexahedra, steps) not in self._hex:
            s = quality(hexahedra)
            finer = replace(s, press_steps=steps * s.press_steps, shear_steps=steps * s.shear_steps)
            self._hex[hexahedra, steps] = HexSolver(finer)
        results = self._hex[hexahedra, steps].solve_frames(scenes)
        for result in results:
            result.evidence |= {"mesh": result.mesh_name.name if result.mesh_name else "", "fidelity": "hex"}
        return list(results)

    def _solve_native(self, scene: Scene) -> Result:
        from gelforge.mechanics.solvers.ccx_native import solve_native

        mesh = choose_mesh(scene, self.family)
        result = solve_native(scene, self.family.load(mesh), self.workdir / "native", self.settings.timeout_s)
        result.evidence |= {"mesh": mesh}
        return result


def _answer(found: Result) -> Solve:
    """What was solved already, as a method of solving it."""
    return lambda scene: found
