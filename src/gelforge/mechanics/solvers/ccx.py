"""Fidelity `ccx`: CalculiX on second-order tetrahedra, contact found in process.

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

from gelforge.flow.params.tables import FeaTable
from gelforge.mechanics.ccx.dat import DatError, Unfinished, last_table, read_dat, without_set
from gelforge.mechanics.ccx.deck import DIRECT, INCLUDES, ITERATIVE, press_deck, write_include
from gelforge.mechanics.ccx.program import OVERDUE, run_ccx
from gelforge.mechanics.contact.facecontact import Verdict, contact_forces, judge
from gelforge.mechanics.contact.facepoints import FacePoints, face_points
from gelforge.mechanics.contact.reach import reachable
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.path.tetpath import Kinematics, PathSettings
from gelforge.mechanics.path.tetsolid import TetSolid
from gelforge.mechanics.path.transfer import LoadPath
from gelforge.mechanics.result import BALANCE, Result
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.tet import arrive, follow
from gelforge.records.status import Status

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
        self.points, self.solid = face_points(mesh), TetSolid(mesh)
        self._write()

    def _write(self) -> None:
        self.run = self.folder / "run"
        self.run.mkdir(parents=True, exist_ok=True)
        self.include = write_include(self.mesh, self.folder / INCLUDES)

    def on(self, mesh: GelMesh, folder: Path | str) -> "CcxSolver":
        """A solver of the same elements whose nodes lie elsewhere; both share what their matrices have in common."""
        other = copy.copy(self)
        other.mesh, other.folder = mesh, Path(folder)
        other.points, other.solid = face_points(mesh), self.solid.on(mesh)
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

        coarse_path: the path as followed on hexahedra, without slip; only its end is then solved on the tetrahedra. None, or an end
        that does not converge: the path is followed on the tetrahedra.
        """
        began = time.perf_counter()
        s = settings or self.settings
        touch_at = first_touch(scene)
        if touch_at is None:
            return self._empty(Status.NO_CONTACT, "", began)
        path = PathSettings(
            s.press_steps, s.shear_steps, s.step_mm, s.stiffness * REFERENCE_C10,
            pull_tolerance=s.pull_tolerance / 2, penetration_mm=s.penetration_mm / 2, contact_iterations=s.rounds,
        )  # fmt: skip
        points = self.points.only(reachable(scene, self.points.position))
        found = self._arrived(scene, points, coarse_path, path) or follow(scene, self.solid, points, touch_at, path)
        kinematics_s = time.perf_counter() - began
        if found.converged:
            result = self._state(scene, found, points, name, s)
            own = contact_forces(found.contact, points, found.displacement, path.stiffness).sum(axis=0)
            result.evidence["engine_difference"] = _difference(result.total, own)
        else:
            result = self._empty(Status.DIVERGED, found.reason, began)
        result.evidence |= {
            "kinematics_seconds": kinematics_s, "seconds": time.perf_counter() - began, "load_steps": found.steps,
            "kinematics_iterations": found.iterations, "rounds": found.rounds,
        }  # fmt: skip
        return result

    def _arrived(
        self, scene: Scene, points: FacePoints, coarse_path: LoadPath | None, path: PathSettings
    ) -> Kinematics | None:
        """The end of a path that was followed on hexahedra; None where there is none or its end does not converge."""
        if coarse_path is None or scene.interface.contact.slips:
            return None
        found = arrive(scene, self.solid, points, self.mesh.nodes, coarse_path, path)
        return found if found.converged else None

    def _empty(self, status: Status, reason: str, began: float) -> CcxResult:
        zero = np.zeros_like(self.mesh.nodes)
        evidence: dict[str, Any] = dict.fromkeys(
            ("equilibrium_residual", "penetration_mm", "pulling_fraction", "base_mismatch"), 0.0
        )
        evidence |= dict.fromkeys(("newton_iterations", "rounds", "load_steps"), 0)
        evidence |= {"reason": reason, "seconds": time.perf_counter() - began, "peak_mib": 0.0}
        return CcxResult(status, zero, zero.copy(), evidence)

    def _state(self, scene: Scene, found: Kinematics, points: FacePoints, name: str, s: CcxSettings) -> CcxResult:
        """CalculiX' equilibrium with the displacement of the touching surface as the kinematics left it."""
        prescribed = np.unique(points.faces[found.contact.touching.any(axis=1)])
        run = _Run(self, scene, name, s)
        answer = run.solve(prescribed, found.displacement)
        if isinstance(answer, CcxResult):
            return answer
        verdict = judge(scene, found.contact, points, answer.displacement, s.stiffness * REFERENCE_C10)
        result = run.result(answer, prescribed, verdict)
        result.evidence["touching_points"] = int(found.contact.touching.sum())
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
