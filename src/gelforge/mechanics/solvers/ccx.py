"""Method `ccx`: CalculiX on second-order tetrahedra, contact found in process.

The deck has no contact. The final state of a hyperelastic body depends on its boundary data only, so the part of the
surface that touches has the displacement that contact gave it; CalculiX finds the equilibrium of the gel and the forces that hold it
so. What pulls or penetrates in its state makes no valid result. Contact is integrated at twelve points of each face,
because at nodes a footprint's edge falls between them.
"""

import copy
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.flow.tables import FeaTable
from gelforge.mechanics.ccx.dat import DatError, Unfinished, last_table, read_dat, without_set
from gelforge.mechanics.ccx.deck import DIRECT, INCLUDES, ITERATIVE, press_deck, write_include
from gelforge.mechanics.ccx.program import OVERDUE, run_ccx
from gelforge.mechanics.contact.penalty import FREE
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.path.equilibrium import System
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.path.pathsettings import PathSettings
from gelforge.mechanics.path.scenepath import ScenePath, Verdict
from gelforge.mechanics.path.transfer import LoadPath
from gelforge.mechanics.result import BALANCE, Result
from gelforge.mechanics.scene import Scene
from gelforge.records.status import Status

NEAR_MM = 0.5  # from the indenter: points that may come to touch within a load step
# Residual at which the end of a path on hexahedra shows what pulls and what presses on tetrahedra: nine scenes end within
# 0.07 % of what 1e-3 gives, in three quarters of the time; at 0.2 they end up to 1.2 % off.
ROUGH = 0.03
FRICTION = 0.1  # stiffness of the springs along the indenter over that along its normal, for laws with friction
INCREMENT = 0.25  # of the load, the first where a start from the kinematics fails


@dataclass(frozen=True)
class CcxSettings:
    """How `ccx` works: the numbers of [fea] that concern it, with the reasons for them in workflow/params.toml.

    press_steps, shear_steps: load steps of the kinematics, at least. step_mm: none of the press is longer.
    stiffness: contact penalty, multiples of C10 per mm. rounds: in which the contact at the path's end may change.
    pull_tolerance: share of the normal force that may pull in a valid state. penetration_mm: depth that counts as touching. residual:
    largest nodal residual over the mean nodal force. timeout_s: seconds after which a run of CalculiX is stopped.
    """

    press_steps: int
    shear_steps: int
    step_mm: float
    stiffness: float
    rounds: int
    pull_tolerance: float
    penetration_mm: float
    residual: float
    timeout_s: float

    @classmethod
    def of(cls, table: FeaTable) -> "CcxSettings":
        """What [fea] says."""
        return cls(**{field.name: getattr(table, field.name) for field in fields(cls)})

    def path(self, scene: Scene, touch_at: float) -> PathSettings:
        """How the path of a scene is followed on tetrahedra from the path parameter `touch_at` on."""
        travel = max(1.0 - touch_at, 0.0) * abs(scene.press.dz)
        penalty = self.stiffness * NEAR_MM
        return PathSettings(
            NEAR_MM, penalty, FRICTION * penalty, press_steps=max(self.press_steps, int(np.ceil(travel / self.step_mm))),
            shear_steps=self.shear_steps, tolerance=1e-3, final_tolerance=1e-8, rough=ROUGH, max_iterations=20, most_in_all=300,
            settle_rounds=self.rounds,
        )  # fmt: skip


@dataclass
class CcxResult(Result):
    """A Result with CalculiX' deck, .dat text and the mesh that the deck includes (None where nothing was run)."""

    deck: str | None = None
    dat: str | None = None
    include: Path | None = None


class CcxSolver:
    """Solves scenes on one tetrahedral mesh; decks and output live in `folder`/run, the mesh as text beside it."""

    def __init__(self, mesh: GelMesh, folder: Path | str, settings: CcxSettings) -> None:
        self.mesh, self.folder, self.settings = mesh, Path(folder), settings
        self.system = System(mesh)
        self._write()

    def _write(self) -> None:
        self.run = self.folder / "run"
        self.run.mkdir(parents=True, exist_ok=True)
        self.include = write_include(self.mesh, self.folder / INCLUDES)

    def on(self, mesh: GelMesh, folder: Path | str) -> "CcxSolver":
        """A solver of the same elements whose nodes lie elsewhere; both share matrix and factorisation, so one works at a time."""
        other = copy.copy(self)
        other.mesh, other.folder = mesh, Path(folder)
        other._write()
        return other

    def solve(
        self,
        scene: Scene,
        name: str = "press",
        settings: CcxSettings | None = None,
        coarse_path: LoadPath | None = None,
    ) -> CcxResult:
        """State at the end of the scene's path. Failure is a status, not an exception.

        coarse_path: the path as followed on hexahedra, of a law without slip or without friction; only its end is then
        solved on the tetrahedra. None, or an end that does not converge: the path is followed on the tetrahedra.
        """
        began = time.perf_counter()
        s = settings or self.settings
        touch_at = first_touch(scene)
        if touch_at is None:
            return self._empty(Status.NO_CONTACT, "", began)
        path = s.path(scene, touch_at)
        status = Status.DIVERGED
        if coarse_path:
            found = ScenePath(scene, path, self.mesh, self.system)
            status = found.arrive(coarse_path)
            steps = len(coarse_path.times) - 1
        if status is not Status.OK:
            found = ScenePath(scene, path, self.mesh, self.system)
            status = found.follow(touch_at)
            steps = found.steps
        kinematics_s = time.perf_counter() - began
        if status is Status.OK:
            result = self._state(found, name, s)
            result.evidence["engine_difference"] = _difference(result.total, found.contact_forces().sum(axis=0))
        else:
            result = self._empty(Status.DIVERGED, found.reason or status.value, began)
        result.evidence |= {
            "kinematics_seconds": kinematics_s, "seconds": time.perf_counter() - began, "load_steps": steps,
            "kinematics_iterations": found.iterations, "rounds": found.rounds,
        }  # fmt: skip
        return result

    def _empty(self, status: Status, reason: str, began: float) -> CcxResult:
        zero = np.zeros_like(self.mesh.nodes)
        evidence: dict[str, Any] = dict.fromkeys(
            ("equilibrium_residual", "penetration_mm", "pulling_fraction", "base_mismatch"), 0.0
        )
        evidence |= dict.fromkeys(("newton_iterations", "rounds", "load_steps"), 0)
        evidence |= {"reason": reason, "seconds": time.perf_counter() - began, "peak_mib": 0.0}
        return CcxResult(status, zero, zero.copy(), evidence)

    def _state(self, found: ScenePath, name: str, s: CcxSettings) -> CcxResult:
        """CalculiX' equilibrium with the displacement of the touching surface as the path left it."""
        touching = found.state.status != FREE
        prescribed = np.unique(found.nodes[touching])
        run = _Run(self, found.scene, name, s)
        answer = run.solve(prescribed, found.u)
        if isinstance(answer, CcxResult):
            return answer
        result = run.result(answer, prescribed, found.judge(answer.displacement))
        result.evidence["touching_points"] = int(touching.sum())
        return result


@dataclass(frozen=True)
class Answer:
    """A solved deck: displacement (n, 3), reactions at the top (t, 3) and base (b, 3), texts."""

    displacement: np.ndarray
    top: np.ndarray
    base: np.ndarray
    deck: str
    dat: str


class _Run:
    """CalculiX on one scene, with what it cost."""

    def __init__(self, solver: CcxSolver, scene: Scene, name: str, settings: CcxSettings):
        self.solver, self.scene, self.name, self.settings = solver, scene, name, settings
        self.iterations = 0
        self.seconds = self.peak = 0.0
        self.failed_attempts: list[str] = []
        self.overdue: dict[str, float] = {}

    def solve(self, prescribed: np.ndarray, start: np.ndarray) -> "Answer | CcxResult":
        """Equilibrium in which the nodes `prescribed` (k,) are displaced as in `start` (n, 3) mm; or a failed CcxResult.

        Newton's method begins there; where that fails the displacements grow from rest in increments.
        """
        mesh, s = self.solver.mesh, self.settings
        problem = Status.DIVERGED, "no point touches"
        attempts: list[tuple[np.ndarray | None, float, str]] = [(start, 1.0, ITERATIVE), (start, 1.0, DIRECT)]
        attempts += [(None, INCREMENT, DIRECT), (None, INCREMENT / 10, DIRECT)]
        run, include = self.solver.run, f"../{INCLUDES}/{self.solver.include.name}"
        for begin, increment, method in attempts if len(prescribed) else []:
            deck = press_deck(
                include, self.scene.material, prescribed, start[prescribed], begin, increment, s.residual, method
            )
            (run / f"{self.name}.inp").write_text(deck)
            job = run_ccx(self.name, run, s.timeout_s)
            self.iterations += job.iterations
            self.seconds += job.seconds
            self.peak = max(self.peak, job.peak_mib)
            if job.returncode == OVERDUE:
                self.overdue = {"stopped_after_s": s.timeout_s}
            try:
                return read_answer(run / f"{self.name}.dat", mesh, deck)
            except DatError as error:
                problem = status_of(error), f"{error}; {job.reason()}"
                self.failed_attempts.append(f"{method}, first increment {increment:g}: {problem[1]}")
        zero = np.zeros_like(mesh.nodes)
        return CcxResult(problem[0], zero, zero.copy(), self._evidence() | {"reason": problem[1]}, deck=None)

    def result(self, answer: Answer, prescribed: np.ndarray, verdict: Verdict) -> CcxResult:
        """The answer as a result: forces are those on the nodes `prescribed`, and valid where contact and balance are."""
        mesh, s = self.solver.mesh, self.settings
        forces = np.zeros_like(mesh.nodes)
        touched = np.isin(mesh.surface_nodes, prescribed)
        forces[mesh.surface_nodes] = np.where(touched[:, None], answer.top, 0.0)
        total = forces.sum(axis=0)
        mismatch = float(np.linalg.norm(total + answer.base.sum(axis=0))) / max(float(np.linalg.norm(total)), 1e-12)
        status = Status.OK if mismatch <= BALANCE else Status.UNBALANCED
        if verdict.pulling_fraction > s.pull_tolerance or verdict.penetration > s.penetration_mm:
            status = Status.UNSETTLED
        free = np.abs(answer.top[~touched]).max(initial=0.0)
        evidence = self._evidence() | {
            "equilibrium_residual": float(free / max(np.abs(forces).max(), 1e-12)),
            "penetration_mm": verdict.penetration, "pulling_fraction": verdict.pulling_fraction,
            "base_mismatch": mismatch,
        }  # fmt: skip
        dat = without_set(answer.dat, "NALL")
        return CcxResult(status, forces, answer.displacement, evidence, answer.deck, dat, self.solver.include)

    def _evidence(self) -> dict:
        return {
            "newton_iterations": self.iterations, "peak_mib": self.peak, "solver_seconds": self.seconds,
            "failed_attempts": self.failed_attempts, **self.overdue,
        }  # fmt: skip


def read_answer(path: Path, mesh: GelMesh, deck: str) -> Answer:
    """Parse and check the .dat of a press deck; raises DatError."""
    text = path.read_text(errors="replace") if path.exists() else ""
    tables = read_dat(text)
    top, base, every = mesh.surface_nodes + 1, mesh.base + 1, np.arange(len(mesh.nodes)) + 1
    return Answer(
        last_table(tables, "displacements", "NALL", every), last_table(tables, "forces", "NTOP", top),
        last_table(tables, "forces", "NBASE", base), deck, text,
    )  # fmt: skip


def status_of(error: DatError) -> Status:
    """Status of a solve whose .dat cannot be used: it ended before its load was on, or it is no table of ours."""
    return Status.DIVERGED if isinstance(error, Unfinished) else Status.UNREADABLE


def _difference(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other)) / max(float(np.linalg.norm(one)), 1e-12)
