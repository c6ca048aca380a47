"""One interface to every way of solving a scene, with the ladder that a failing solve climbs down."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.params.tables import FIDELITIES, IN_PROCESS, FeaTable
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.ccx.program import need_ccx
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.mesh.family import MeshFamily, choose_mesh, unplaced
from gelforge.mechanics.path.transfer import Trail
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.auto import Way, way_of
from gelforge.mechanics.solvers.ccx import CcxSettings, CcxSolver
from gelforge.mechanics.solvers.hex import HexSolver

GUIDE = "label"  # quality of the hexahedra on which the load path of `ccx` is found


class Solvers:
    """Solvers of one family of tetrahedral meshes, kept between scenes; files of a solve lie in `workdir`, settings: [fea].

    family: of meshes of the gel that all scenes sit on; bricks follow the gel of each scene. workdir: of this process alone.
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
        """Solve moments of one press, scenes in order of time along one path; one result each, as `solve` gives it.

        Without slip their path is walked once, on coarse bricks, for all of them.
        """
        if fidelity not in FIDELITIES:
            raise BadInput(f"fidelity {fidelity!r} is unknown; choose one of {', '.join(FIDELITIES)}")
        if len(scenes) == 1:
            scenes = [scenes[0].direct]
        way = way_of(scenes[-1], fidelity, self.settings)
        if way.fidelity not in IN_PROCESS:
            need_ccx()
        first = self._first_rung(scenes, way)
        results = [self._climb(scene, way, attempt) for scene, attempt in zip(scenes, first, strict=True)]
        for result in results:
            result.evidence |= way.why
        return results

    def _first_rung(self, scenes: Sequence[Scene], way: Way) -> list[Callable[[Scene], Result]]:
        """How each scene is solved as asked; where a path serves several of them it is walked here."""
        if way.fidelity == "hex":
            return [_answer(found) for found in self._solve_hex(scenes, way.hexahedra)]
        if way.fidelity == "ccx":
            walks = self.guide.walk(scenes)
            return [partial(self._solve_ccx, trail=walk.trail if walk else None) for walk in walks]
        # a reference owes nothing to the bricks
        alone = self._solve_native if way.fidelity == "ccx-native" else self._solve_ccx
        return [alone] * len(scenes)

    def _climb(self, scene: Scene, way: Way, first: Callable[[Scene], Result]) -> Result:
        """The first valid result of the ladder, else the last one, with what failed before it."""
        climbed = []
        for rung, attempt in [(way.fidelity, first), *self._lower_rungs(way.fidelity, way.hexahedra)]:
            result = attempt(scene)
            result.evidence["rung"] = rung
            if result.status.valid:
                break
            climbed.append(f"{rung}: {result.status.name}, {result.evidence.get('reason') or result.status.value}")
        result.evidence["ladder"] = climbed + result.evidence.get("ladder", [])
        result.evidence.setdefault("fidelity", way.fidelity)
        return result

    def _lower_rungs(self, fidelity: str, bricks: str) -> list[tuple[str, Callable[[Scene], Result]]]:
        """What is tried where solving as asked fails: smaller load steps, more contact rounds, another fidelity."""
        if fidelity == "hex":
            return [("hex, smaller load steps", lambda scene: self._solve_hex([scene], bricks, 4)[0])]
        if fidelity == "ccx-native":
            return []
        rungs: list[tuple[str, Callable[[Scene], Result]]] = [
            (f"{fidelity}, smaller load steps", partial(self._solve_ccx, steps=3)),
            (f"{fidelity}, more contact rounds", partial(self._solve_ccx, steps=3, rounds=3)),
        ]
        # a reference is CalculiX' or none
        return (
            rungs if fidelity == "ccx-fine" else [*rungs, ("hex", lambda scene: self._solve_hex([scene], bricks)[0])]
        )

    def _solve_ccx(self, scene: Scene, steps: int = 1, rounds: int = 1, trail: Trail | None = None) -> Result:
        mesh, base = choose_mesh(scene, self.family), self.ccx
        finer = replace(base, press_steps=steps * base.press_steps, shear_steps=steps * base.shear_steps,
                        step_mm=base.step_mm / steps, rounds=rounds * base.rounds)  # fmt: skip
        result = self._ccx_on(mesh).solve(scene, settings=finer, trail=trail)
        result.evidence |= {"mesh": mesh}
        return result

    def _ccx_on(self, mesh: str) -> CcxSolver:
        """The solver of a mesh; one whose fine part is moved shares all that it can with the one it is made from."""
        own, _ = unplaced(mesh)
        if own not in self._ccx:
            self._ccx[own] = CcxSolver(self.family.load(own), self.workdir / own, self.ccx)
        solver = self._ccx[own]
        return solver if mesh == own else solver.on(self.family.load(mesh), self.workdir / mesh)

    def _solve_hex(self, scenes: Sequence[Scene], bricks: str, steps: int = 1) -> list[Result]:
        """Solve on bricks that follow the press; a result's mesh is a name that holds all numbers of it."""
        for gel in {scene.gel for scene in scenes}:
            if load_gel(gel.name) != gel:
                raise BadInput(f"gel {gel.name!r} of the scene is not the one of that name; give it one of its own")
        if (bricks, steps) not in self._hex:
            s = quality(bricks)
            finer = replace(s, press_steps=steps * s.press_steps, shear_steps=steps * s.shear_steps)
            self._hex[bricks, steps] = HexSolver(finer)
        results = self._hex[bricks, steps].solve_frames(scenes)
        for result in results:
            result.evidence |= {"mesh": result.bricks.name if result.bricks else "", "fidelity": "hex"}
        return list(results)

    def _solve_native(self, scene: Scene) -> Result:
        from gelforge.mechanics.solvers.ccx_native import solve_native

        mesh = choose_mesh(scene, self.family)
        result = solve_native(scene, self.family.load(mesh), self.workdir / "native", self.settings.timeout_s)
        result.evidence |= {"mesh": mesh}
        return result


def _answer(found: Result) -> Callable[[Scene], Result]:
    """What was solved already, as a way of solving it."""
    return lambda scene: found
