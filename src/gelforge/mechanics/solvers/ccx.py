"""Method `ccx`: CalculiX on second-order tetrahedra, with contact solved in process.

The deck has no contact. The final state of a hyperelastic body depends only on its boundary data, so the touching
part of the surface is given the displacement found in process, and CalculiX solves for the equilibrium of the gel and
the forces that hold it. A result is invalid if points pull or penetrate in it, or if its force differs from the one
found in process. Contact is integrated at twelve points per face, because the edge of contact falls between nodes.
"""

import time
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import binary_closing

from gelforge.flow.tables import FeaTable
from gelforge.geometry import touch
from gelforge.mechanics.ccx.dat import DatError, Unfinished, last_table, read_dat
from gelforge.mechanics.ccx.deck import ATTEMPTS, press_deck
from gelforge.mechanics.ccx.program import OVERDUE, run_ccx
from gelforge.mechanics.contact.penalty import FREE
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.mesh.basemesh import base_of
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexmesh import around, fine_box
from gelforge.mechanics.mesh.names import SMALLEST_MM, Contact, TetMeshName
from gelforge.mechanics.path.equilibrium import System
from gelforge.mechanics.path.loadpath import first_touch, fitted
from gelforge.mechanics.path.pathsettings import PathSettings
from gelforge.mechanics.path.scenepath import ScenePath, Verdict
from gelforge.mechanics.path.transfer import LoadPath, touches
from gelforge.mechanics.result import BALANCE, BEYOND_CONE, Result
from gelforge.mechanics.scene import Scene
from gelforge.records.status import Status

AROUND = quality("label")  # its fine box bounds the area in which contact is looked for
PIXELS = 64  # across the longer side of that box
# 90 % bounds on the error over the force, of the total and summed over cells, with edges of EDGE_MM where the contact
# ends, and the power of these edges with which they grow: from presses of known force and the benchmark scenes.
ERROR, CELLS_ERROR, EDGE_MM, ORDER = 0.024, 0.048, 0.45, 1.5
# Shortest and longest edges where the contact ends, mm, and longest edges inside it: those of the gel's base mesh.
SHORTEST_MM, WIDEST_MM, INSIDE_MM = 0.3, 1.0, 2.8
# Longest edges at the edge of contact, in sides of these hexahedra, which are smaller under a narrow contact, for
# edges of EDGE_MM. Longer ones are shortened under narrower contacts, in the same proportion.
LONGEST = 1.5
# Gap, in widths of a coarse hexahedron, up to which points between its contact points count as touching, too; and
# width in pixels of holes in the contact that are closed.
PORES, CLOSED = 0.02, 1
NEAR_MM = 0.5  # gap below which a free point may come to touch within a load step
# Residual of the contact iterations on tetrahedra after a path on hexahedra. On nine scenes it changes the force by
# at most 0.07 % against 1e-3 and takes three quarters of the time; 0.2 changes it by up to 1.2 %.
ROUGH = 0.03
FRICTION = 0.1  # tangential over normal penalty stiffness, for laws with friction
# Largest relative difference of CalculiX' force to that of the same equilibrium in process (normally about 1e-8).
MOST_DIFFERENT = 1e-5


@dataclass(frozen=True)
class CcxSettings:
    """Settings of `ccx`: its keys of [fea]; workflow/params.toml gives the reasons for their values.

    edge_mm, inside_mm: longest edges of tetrahedra at the edge of contact, and inside it. The force depends mostly on
    edge_mm, which follows from the error that [fea] tolerates.
    press_steps, shear_steps: least load steps of the in-process path. step_mm: longest press step.
    stiffness: contact penalty, multiples of C10 per mm. rounds: most contact iterations at the end of the path.
    pull_tolerance, penetration_mm: limits of a valid state: tension over normal force, and penetration.
    residual: largest nodal residual over the mean nodal force. timeout_s: time limit of a run of CalculiX, s.
    """

    edge_mm: float
    inside_mm: float
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
        """The settings of a table [fea]."""
        edge = EDGE_MM * (table.tolerance / ERROR) ** (1.0 / ORDER)
        edge = round(float(np.clip(edge, SHORTEST_MM, WIDEST_MM)), 2)
        own = {field.name for field in fields(cls)} - {"edge_mm", "inside_mm"}
        return cls(edge_mm=edge, inside_mm=INSIDE_MM, **{name: getattr(table, name) for name in own})

    def coarser(self, bound: float) -> float:
        """A bound on an error with edges of EDGE_MM, for these edges."""
        return bound * (self.edge_mm / EDGE_MM) ** ORDER

    def path(self, scene: Scene, touch_at: float, finer: int = 1) -> PathSettings:
        """Settings of the path of a scene on tetrahedra; touch_at: path parameter of the first touch.

        finer: how many times as many load steps are made.
        """
        travel = max(1.0 - touch_at, 0.0) * abs(scene.press.dz)
        penalty = self.stiffness * NEAR_MM
        settings = PathSettings(
            NEAR_MM, penalty, FRICTION * penalty, press_steps=max(self.press_steps, int(np.ceil(travel / self.step_mm))),
            shear_steps=self.shear_steps, tolerance=1e-3, final_tolerance=1e-8, rough=ROUGH,
            max_iterations=20, most_in_all=300 * finer, settle_rounds=self.rounds,
        )  # fmt: skip
        fit = fitted(settings, scene, touch_at)
        return replace(fit, press_steps=finer * fit.press_steps, shear_steps=finer * fit.shear_steps)


def mesh_of(
    scene: Scene, path: LoadPath | None, edge_mm: float, inside_mm: float, longest: float = LONGEST
) -> TetMeshName:
    """The mesh of a press: the gel's base mesh, bisected at the edge of contact and inside it.

    path: on hexahedra, to find the contact; None: contact is where the undeformed gel lies inside the indenter.
    edge_mm, inside_mm: longest edges there; shorter if the contact is narrow, see LONGEST (longest = inf: never).
    """
    box = fine_box(scene, AROUND.size, AROUND.across)
    rim = around(box.size)
    low, size = (
        (_digits(box.x_min - rim, 6), _digits(box.y_min - rim, 6)),
        np.array([box.x_max - box.x_min, box.y_max - box.y_min]) + 2.0 * rim,
    )
    pixel = _digits(size.max() / PIXELS, 3)
    x, y = (
        start + pixel * (np.arange(max(1, round(side / pixel))) + 0.5) for start, side in zip(low, size, strict=True)
    )
    x, y = np.meshgrid(x, y, indexing="ij")
    places = np.stack([x.ravel(), y.ravel(), np.asarray(scene.gel.top(x, y), float).ravel()], axis=1)
    if path:
        met, _ = touches(path, places, PORES)
        padded = np.pad(met.reshape(x.shape), CLOSED)
        mask = binary_closing(padded, iterations=CLOSED)[CLOSED:-CLOSED, CLOSED:-CLOSED]
    else:
        mask = touch.touched(scene.indenter, scene.press, places).reshape(x.shape)
    mask &= scene.gel.inside(x, y)
    if not mask.any():  # the contact lies between the pixels: take the nearest ones
        near = touch.gap(scene.indenter, scene.press, places, scene.press.end).reshape(x.shape)
        mask = near <= near.min()
    most = longest * box.size * max(1.0, edge_mm / EDGE_MM)
    edge, inside = (_digits(max(SMALLEST_MM, size * min(1.0, most / edge_mm)), 3) for size in (edge_mm, inside_mm))
    return TetMeshName(scene.gel.name, base_of(scene.gel).digest, edge, inside, Contact.of(mask, pixel, low))


def _digits(number: float, count: int) -> float:
    """Round to `count` significant digits, so that a mesh's name holds the number exactly."""
    return float(f"{number:.{count}g}")


@dataclass
class CcxResult(Result):
    """A Result with the data of CalculiX' deck (None if CalculiX was not run).

    start: (n, 3) float32 mm, displacements from which Newton's method starts. prescribed: (k,) nodes that are moved
    to theirs. deck: the other arguments of `ccx.deck.press_deck`.
    """

    start: np.ndarray | None = None
    prescribed: np.ndarray | None = None
    deck: dict[str, float] = field(default_factory=dict)


class CcxSolver:
    """Solves scenes on one tetrahedral mesh; decks and output of CalculiX are written to `folder`."""

    def __init__(self, mesh: GelMesh, folder: Path | str, settings: CcxSettings) -> None:
        self.mesh, self.folder, self.settings = mesh, Path(folder), settings
        self.system = System(mesh)
        self.folder.mkdir(parents=True, exist_ok=True)

    def solve(
        self,
        scene: Scene,
        name: str = "press",
        settings: CcxSettings | None = None,
        coarse_path: LoadPath | None = None,
        finer: int = 1,
    ) -> CcxResult:
        """State at the end of the scene's path. Failure is a status, not an exception.

        coarse_path: the path on hexahedra; then only its end is solved on the tetrahedra. If it is None, or its end does
        not converge, the path is followed on the tetrahedra, in `finer` times as many load steps.
        """
        began = time.perf_counter()
        s = settings or self.settings
        touch_at = first_touch(scene)
        if touch_at is None:
            return self._empty(Status.NO_CONTACT, "", began)
        path = s.path(scene, touch_at, finer)
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
        return CcxResult(status, zero, zero.copy(), evidence, self.mesh)

    def _state(self, found: ScenePath, name: str, s: CcxSettings) -> CcxResult:
        """CalculiX' equilibrium with the touching surface displaced as at the end of the path."""
        prescribed = np.unique(found.nodes[found.state.status != FREE])
        run = _Run(self, found.scene, name, s)
        # single precision as stored, so that stored presses reproduce the deck to the last digit
        start = found.u.astype(np.float32)
        answer = run.solve(prescribed, start)
        if isinstance(answer, CcxResult):
            return answer
        result = run.result(answer, prescribed, start, found.judge(answer.displacement))
        result.evidence |= found.friction()
        if result.status.valid and result.evidence.get("beyond_cone", 0.0) > BEYOND_CONE:
            result.status = Status.UNSETTLED
        _compare(result, found.contact_forces().sum(axis=0))
        return result


def _compare(result: CcxResult, in_process: np.ndarray) -> None:
    """Record the relative difference of CalculiX' force and `in_process` (3,) N; DISAGREES if it is too large."""
    off = float(np.linalg.norm(result.total - in_process)) / max(float(np.linalg.norm(in_process)), 1e-12)
    result.evidence["engine_difference"] = off
    if result.status.valid and off > MOST_DIFFERENT:
        result.status = Status.DISAGREES
        force, own = (" ".join(f"{value:.6g}" for value in total) for total in (result.total, in_process))
        result.evidence["reason"] = (
            f"CalculiX {result.evidence['ccx_version']} gives {force} N, the solver in process {own} N for the same"
            f" equilibrium: relative difference {off:.2g}, at most {MOST_DIFFERENT:g} is allowed; {Status.DISAGREES.value}"
        )


@dataclass(frozen=True)
class Answer:
    """A solved deck: displacement (n, 3), reactions at the top (t, 3) and base (b, 3)."""

    displacement: np.ndarray
    top: np.ndarray
    base: np.ndarray


class _Run:
    """CalculiX on one scene, with its cost."""

    def __init__(self, solver: CcxSolver, scene: Scene, name: str, settings: CcxSettings):
        self.solver, self.scene, self.name, self.settings = solver, scene, name, settings
        self.iterations = 0
        self.peak = 0.0
        self.failed_attempts: list[str] = []
        self.overdue: dict[str, float] = {}
        self.version = ""
        self.deck: dict[str, Any] = {}

    def solve(self, prescribed: np.ndarray, start: np.ndarray) -> "Answer | CcxResult":
        """Equilibrium with the nodes `prescribed` (k,) displaced as in `start` (n, 3) mm, or a failed CcxResult.

        Newton's method starts there; if that fails, the displacements are increased from zero in increments. What the
        time limit stopped is not tried again, because increments take longer.
        """
        mesh, s, folder = self.solver.mesh, self.settings, self.solver.folder
        problem = Status.DIVERGED, "no point touches"
        for attempt, (_, increment, method) in enumerate(ATTEMPTS if len(prescribed) else ()):
            self.deck = {"nu": self.scene.material.nu, "attempt": attempt, "residual": s.residual}
            deck = press_deck(mesh, prescribed, start, **self.deck)
            (folder / f"{self.name}.inp").write_text(deck)
            job = run_ccx(self.name, folder, s.timeout_s)
            self.iterations += job.iterations
            self.peak, self.version = max(self.peak, job.peak_mib), job.version
            if job.returncode == OVERDUE:
                self.overdue = {"stopped_after_s": s.timeout_s}
            try:
                return read_answer(folder / f"{self.name}.dat", mesh)
            except DatError as error:
                problem = status_of(error), f"{error}; {job.reason()}"
                self.failed_attempts.append(f"{method}, first increment {increment:g}: {problem[1]}")
            if self.overdue:
                break
        zero = np.zeros_like(mesh.nodes)
        return CcxResult(problem[0], zero, zero.copy(), self._evidence() | {"reason": problem[1]}, mesh)

    def result(self, answer: Answer, prescribed: np.ndarray, start: np.ndarray, verdict: Verdict) -> CcxResult:
        """The result of an answer: forces act on the nodes `prescribed`; valid if contact and force balance are."""
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
        return CcxResult(status, forces, answer.displacement, evidence, mesh, start, prescribed, self.deck)

    def _evidence(self) -> dict:
        return {
            "newton_iterations": self.iterations, "peak_mib": self.peak,
            "failed_attempts": self.failed_attempts, "ccx_version": self.version, **self.overdue,
        }  # fmt: skip


def read_answer(path: Path, mesh: GelMesh) -> Answer:
    """Parse and check the .dat of a press deck; raises DatError."""
    text = path.read_text(errors="replace") if path.exists() else ""
    tables = read_dat(text)
    top, base, every = mesh.surface_nodes + 1, mesh.base + 1, np.arange(len(mesh.nodes)) + 1
    return Answer(
        last_table(tables, "displacements", "NALL", every), last_table(tables, "forces", "NTOP", top),
        last_table(tables, "forces", "NBASE", base),
    )  # fmt: skip


def status_of(error: DatError) -> Status:
    """Status of a solve with an unusable .dat: the job ended before its full load, or the file is unreadable."""
    return Status.DIVERGED if isinstance(error, Unfinished) else Status.UNREADABLE
