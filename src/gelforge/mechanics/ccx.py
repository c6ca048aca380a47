"""Fidelity `ccx`: CalculiX on second-order tetrahedra, contact found by `hex` and corrected in rounds.

The deck has no contact. The final state of a hyperelastic body depends on its boundary data only,
so the points that touch are held where they ended and CalculiX finds the equilibrium; points that
pull are let go, points that penetrate are held, and the rounds go on until neither remains. Contact
is integrated at twelve points of each face, because at nodes a footprint's edge falls between them.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelforge.mechanics import ccx_contact as touch
from gelforge.mechanics.ccx_deck import press_deck, write_include
from gelforge.mechanics.ccx_run import run_ccx
from gelforge.mechanics.dat import DatError, last_table, read_dat, without_set
from gelforge.mechanics.hex import HexResult, HexSettings, HexSolver
from gelforge.mechanics.mesh import GelMesh
from gelforge.mechanics.scene import REFERENCE_C10, Result, Scene, Status
from gelforge.mechanics.tetface import FacePoints, face_points

KINEMATICS = HexSettings(size=0.9, layers=4, press_steps=6, shear_steps=3, tolerance=1e-3, final_tolerance=1e-6)


@dataclass(frozen=True)
class CcxSettings:
    """How `ccx` works.

    stiffness: contact springs, multiples of C10 per mm.
    rounds: at most so many solves. pull_tolerance: share of the normal force that may pull in a valid
    state. penetration_mm: depth that counts as touching. residual: largest nodal residual over the
    mean nodal force. increments: first load increment when the start from hex fails.
    """

    stiffness: float = 2000.0
    rounds: int = 8
    pull_tolerance: float = 2e-3
    penetration_mm: float = 2e-3
    residual: float = 1e-5
    increment: float = 0.25
    timeout_s: float = 1800.0


@dataclass
class CcxResult(Result):
    """A Result with the deck and the .dat text of its last round (None where nothing was run)."""

    deck: str | None = None
    dat: str | None = None


class CcxSolver:
    """Solves scenes on one tetrahedral mesh; decks and output live in `folder`."""

    def __init__(self, mesh: GelMesh, folder, settings: CcxSettings = CcxSettings(), kinematics: HexSolver | None = None):
        self.mesh, self.folder, self.settings = mesh, Path(folder), settings
        self.kinematics = kinematics or HexSolver(KINEMATICS)
        self.points = face_points(mesh)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.include = write_include(mesh, self.folder / "mesh.inp").name

    def solve(self, scene: Scene, name: str = "press") -> CcxResult:
        """State at the end of the scene's path. Failure is a status, not an exception."""
        started = time.perf_counter()
        hexa = self.kinematics.solve(scene)
        kinematics_s = time.perf_counter() - started
        if hexa.status is not Status.OK:
            result = self._empty(hexa)
        else:
            result = self._rounds(scene, hexa, name)
            result.evidence["hex_force_difference"] = _difference(result.total, hexa.total)
        result.evidence |= {
            "kinematics_seconds": kinematics_s, "seconds": time.perf_counter() - started,
            "load_steps": hexa.evidence["load_steps"],
        }  # fmt: skip
        return result

    def _empty(self, hexa: HexResult) -> CcxResult:
        zero = np.zeros_like(self.mesh.nodes)
        return CcxResult(hexa.status, zero, zero.copy(), dict(hexa.evidence))

    def _rounds(self, scene, hexa, name) -> CcxResult:
        s = self.settings
        stiffness = s.stiffness * REFERENCE_C10
        contact = touch.predict(scene, self.points, hexa)
        run = _Run(self, scene, name, stiffness)
        start = start_from_hex(self.mesh, hexa)
        for number in range(1, s.rounds + 1):
            answer = run.solve(contact, start)
            if isinstance(answer, CcxResult):
                return answer
            verdict = touch.judge(scene, contact, self.points, answer.displacement, stiffness)
            run.history.append([verdict.pulling_fraction, verdict.penetration, float(-answer.top.sum(axis=0)[2])])
            settled = verdict.pulling_fraction <= s.pull_tolerance and verdict.penetration <= s.penetration_mm
            if scene.interface.law == "coulomb" and number == 1:
                settled = False  # the drag still follows hex' pressure
            if settled or number == s.rounds:
                return run.result(Status.OK if settled else Status.UNSETTLED, answer, contact, verdict)
            contact, start = touch.correct(scene, contact, verdict, s.penetration_mm / 4), answer.displacement
        raise AssertionError("unreachable")


@dataclass(frozen=True)
class Answer:
    """One solved round: displacement (n, 3), reactions at the top (t, 3) and base (b, 3), texts."""

    displacement: np.ndarray
    top: np.ndarray
    base: np.ndarray
    deck: str
    dat: str


class _Run:
    """The rounds of one scene, with what they cost."""

    def __init__(self, solver: CcxSolver, scene: Scene, name: str, stiffness: float):
        self.solver, self.scene, self.name, self.stiffness = solver, scene, name, stiffness
        self.iterations = self.rounds = 0
        self.seconds = self.peak = 0.0
        self.ladder, self.history = [], []

    def solve(self, contact, start):
        """One round: from the start, else in increments from rest; an Answer, or a failed CcxResult."""
        mesh, s = self.solver.mesh, self.solver.settings
        rows = touch.spring_rows(contact, self.solver.points, self.stiffness)
        loads = touch.drag_loads(contact, self.solver.points, len(mesh.nodes))
        problem = Status.DIVERGED, "no point touches"
        attempts = [(start, 1.0), (None, s.increment), (None, s.increment / 10)] if len(rows.target) else []
        for begin, increment in attempts:
            deck = press_deck(
                mesh, self.solver.include, self.scene.material, rows, loads, begin, increment, s.residual
            )  # fmt: skip
            (self.solver.folder / f"{self.name}.inp").write_text(deck)
            job = run_ccx(self.name, self.solver.folder, s.timeout_s)
            self.iterations += job.iterations
            self.seconds += job.seconds
            self.peak = max(self.peak, job.peak_mib)
            try:
                answer = read_answer(self.solver.folder / f"{self.name}.dat", mesh, deck)
                self.rounds += 1
                return answer
            except DatError as error:
                status = Status.DIVERGED if "stopped early" in str(error) or "nothing" in str(error) else Status.UNREADABLE
                problem = status, f"{error}; {job.reason()}"
                self.ladder.append(f"round {self.rounds + 1}, first increment {increment:g}: {problem[1]}")
        zero = np.zeros_like(mesh.nodes)
        return CcxResult(problem[0], zero, zero.copy(), self._evidence() | {"reason": problem[1]}, deck=None)

    def result(self, status, answer, contact, verdict) -> CcxResult:
        mesh = self.solver.mesh
        forces = np.zeros_like(mesh.nodes)
        touched = np.unique(mesh.faces[contact.held.any(axis=1)])
        top = mesh.surface_nodes
        forces[top] = np.where(np.isin(top, touched)[:, None], answer.top, 0.0)
        total = forces.sum(axis=0)
        mismatch = np.linalg.norm(total + answer.base.sum(axis=0)) / max(np.linalg.norm(total), 1e-12)
        if status is Status.OK and mismatch > 1e-6:
            status = Status.UNBALANCED
        free = np.abs(answer.top[~np.isin(top, touched)]).max(initial=0.0)
        evidence = self._evidence() | {
            "equilibrium_residual": float(free / max(np.abs(forces).max(), 1e-12)),
            "penetration_mm": verdict.penetration, "pulling_fraction": verdict.pulling_fraction,
            "base_mismatch": float(mismatch), "touching_points": int(contact.held.sum()),
        }  # fmt: skip
        return CcxResult(status, forces, answer.displacement, evidence, answer.deck, without_set(answer.dat, "NALL"))

    def _evidence(self) -> dict:
        return {
            "newton_iterations": self.iterations, "rounds": self.rounds, "peak_mib": self.peak,
            "solver_seconds": self.seconds, "ladder": self.ladder, "history": self.history,
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


def _difference(one, other) -> float:
    return float(np.linalg.norm(one - other) / max(np.linalg.norm(one), 1e-12))


def start_from_hex(mesh: GelMesh, hexa: HexResult) -> np.ndarray:
    """Displacement (n, 3) of a brick mesh at the nodes of another mesh of the same gel: Newton's start."""
    from gelforge.mechanics.hex import interpolate_surface

    bricks = hexa.mesh
    planes = bricks.nodes.reshape(bricks.layers + 1, -1, 3)
    fields = hexa.displacement.reshape(bricks.layers + 1, -1, 3)
    middle = planes.shape[1] // 2
    levels = planes[:, middle, 2]
    levels = (levels - levels[0]) / (levels[-1] - levels[0])
    xy = mesh.nodes[:, :2]
    bottom = bricks.nodes[0, 2]
    roof = interpolate_surface(bricks, bricks.nodes[:, 2:], xy)[:, 0]
    height = np.clip((mesh.nodes[:, 2] - bottom) / (roof - bottom), 0.0, 1.0)
    first = len(bricks.nodes) - planes.shape[1]
    spread = np.zeros((len(bricks.nodes), 3))
    at = []
    for field in fields:
        spread[first:] = field
        at.append(interpolate_surface(bricks, spread, xy))
    at = np.array(at)
    low = np.clip(np.searchsorted(levels, height, "right") - 1, 0, len(levels) - 2)
    share = ((height - levels[low]) / (levels[low + 1] - levels[low]))[:, None]
    node = np.arange(len(xy))
    start = (1 - share) * at[low, node] + share * at[low + 1, node]
    start[mesh.base] = 0.0
    return start
