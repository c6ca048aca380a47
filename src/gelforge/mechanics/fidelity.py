"""One interface to every way of solving a scene, with the ladder that a failing solve climbs down."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.ccx.program import need_ccx
from gelforge.mechanics.ccx.solver import CcxSettings, CcxSolver
from gelforge.mechanics.family import MeshFamily, choose_mesh
from gelforge.mechanics.hex.solver import HexSolver, quality
from gelforge.mechanics.scene import Result, Scene

FIDELITIES = ("hex", "ccx", "ccx-native", "ccx-fine", "auto")


@dataclass(frozen=True)
class FeaSettings(CcxSettings):
    """The [fea] table: see workflow/params.toml for the reasons of its values."""

    fidelity: str = "ccx"
    tolerance: float = 0.02
    hex_quality: str = "label"
    charted: dict | None = None

    @classmethod
    def from_table(cls, table: dict) -> "FeaSettings":
        """Take what the table holds of these; mesh names are not for the solver."""
        names = {f.name for f in fields(cls)}
        return cls(**{k: v for k, v in table.items() if k in names})

    @property
    def ccx(self) -> CcxSettings:
        return CcxSettings(**{f.name: getattr(self, f.name) for f in fields(CcxSettings)})


class Solvers:
    """Solvers of one family of tetrahedral meshes, kept between scenes; files of a solve lie in `workdir`."""

    def __init__(self, family: MeshFamily, workdir, settings: FeaSettings = FeaSettings()):
        self.family, self.workdir, self.settings = family, Path(workdir), settings
        self.bricks = quality(settings.hex_quality)
        self.guide = HexSolver(quality("label"))
        self._ccx, self._hex = {}, {}

    def solve(self, scene: Scene, fidelity: str) -> Result:
        """Solve at one fidelity, or the cheapest that is good enough for "auto"; see `solve`."""
        if fidelity not in FIDELITIES:
            raise BadInput(f"fidelity {fidelity!r} is unknown; choose one of {', '.join(FIDELITIES)}")
        if fidelity == "auto":
            fidelity = cheapest(self.settings.charted or {}, self.settings.tolerance)
        if fidelity != "hex":
            need_ccx()
        climbed = []
        for rung, attempt in self._ladder(fidelity):
            result = attempt(scene)
            result.evidence["rung"] = rung
            if result.status.valid:
                break
            climbed.append(f"{rung}: {result.status.name}, {result.evidence.get('reason') or result.status.value}")
        result.evidence["ladder"] = climbed + result.evidence.get("ladder", [])
        result.evidence.setdefault("fidelity", fidelity)
        return result

    def solve_frames(self, scenes: Sequence[Scene], fidelity: str) -> list[Result]:
        """Solve moments of one press, scenes in order of time along one path; one result each, as `solve` gives it."""
        return [self.solve(scene, fidelity) for scene in scenes]

    def _ladder(self, fidelity):
        """Attempts in order: as asked, smaller load steps, more contact rounds, another fidelity."""
        if fidelity == "hex":
            return [("hex", self._solve_hex), ("hex, smaller load steps", lambda s: self._solve_hex(s, 4))]
        if fidelity == "ccx-native":
            return [("ccx-native", self._solve_native)]
        rungs = [
            (fidelity, self._solve_ccx),
            (f"{fidelity}, smaller load steps", lambda s: self._solve_ccx(s, steps=3)),
            (f"{fidelity}, more contact rounds", lambda s: self._solve_ccx(s, steps=3, rounds=3)),
        ]
        # a reference is CalculiX' or none
        return rungs if fidelity == "ccx-fine" else [*rungs, ("hex", self._solve_hex)]

    def _solve_ccx(self, scene, steps=1, rounds=1) -> Result:
        mesh = choose_mesh(scene, self.family)
        if mesh not in self._ccx:
            self._ccx[mesh] = CcxSolver(self.family.load(mesh), self.workdir / mesh, self.settings.ccx, self.guide)
        base = self.settings.ccx
        finer = replace(base, press_steps=steps * base.press_steps, shear_steps=steps * base.shear_steps,
                        step_mm=base.step_mm / steps, rounds=rounds * base.rounds)  # fmt: skip
        result = self._ccx[mesh].solve(scene, settings=finer)
        result.evidence |= {"mesh": mesh}
        return result

    def _solve_hex(self, scene, steps=1) -> Result:
        """Solve on bricks that follow the press; the result's mesh is a name that holds all numbers of it."""
        if load_gel(scene.gel.name) != scene.gel:
            raise BadInput(f"gel {scene.gel.name!r} of the scene is not the one of that name; give it one of its own")
        if steps not in self._hex:
            s = self.bricks
            finer = replace(s, press_steps=steps * s.press_steps, shear_steps=steps * s.shear_steps)
            self._hex[steps] = HexSolver(finer)
        result = self._hex[steps].solve(scene)
        result.evidence |= {"mesh": result.bricks.name, "fidelity": "hex"}
        return result

    def _solve_native(self, scene) -> Result:
        from gelforge.mechanics.ccx.native import solve_native

        mesh = choose_mesh(scene, self.family)
        result = solve_native(scene, self.family.load(mesh), self.workdir / "native", self.settings.timeout_s)
        result.evidence |= {"mesh": mesh}
        return result


def cheapest(charted: dict, tolerance: float) -> str:
    """The cheapest fidelity whose charted worst error in total force meets `tolerance`.

    charted: fidelity -> [error, relative seconds], from the speed-accuracy chart.
    """
    meeting = {name: cost for name, (error, cost) in charted.items() if error <= tolerance}
    if not meeting:
        raise BadInput(f"no charted fidelity meets tolerance = {tolerance:g}; raise it or name a fidelity in [fea]")
    return min(meeting, key=meeting.get)


def solve(scene: Scene, fidelity: str, meshes: MeshFamily, workdir, settings: FeaSettings = FeaSettings()) -> Result:
    """Solve one press at a fidelity: "hex", "ccx", "ccx-native", "ccx-fine" or "auto".

    Returns nodal forces (n, 3) N on the gel and displacement (n, 3) mm on the mesh named by
    evidence["mesh"]. A failed solve is a status with its reason in the evidence; a missing CalculiX
    or a full disk raises BadInput. Many scenes: keep a `Solvers`.
    """
    return Solvers(meshes, workdir, settings).solve(scene, fidelity)
