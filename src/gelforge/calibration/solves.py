"""Finite element solves behind the emulator, each cached in a file named by a digest of its inputs.

One solve follows the whole path in load steps, and each converged step is a point of the curve of
force against depth. So a press needs one solve per friction coefficient on coarse hexahedra, and one on fine
hexahedra, at the largest coefficient of its law, which corrects them.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.calibration import emulator as em
from gelforge.calibration.parameters import FRICTION
from gelforge.calibration.readings import Readings, slides
from gelforge.calibration.tilts import ROUNDED_MM, Tilts, nodes_of, response, rounded, solved_presses
from gelforge.errors import BadInput, SolveFailed, nearest
from gelforge.flow.files import record_of, write_json
from gelforge.flow.jobs import in_slots
from gelforge.geometry.gel import load_gel
from gelforge.geometry.solids import Indenter, feels_tilt, surface_digest
from gelforge.mechanics.hexsettings import HexSettings
from gelforge.mechanics.material import Material
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solve import hexahedra_key, solve_key
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.press import Press
from gelforge.records.status import Status


@dataclass(frozen=True)
class SolveJob:
    """One solve: press path, indenter (its name in the catalogue), friction coefficient, Poisson's ratio, the gel's name."""

    press: Press
    indenter: str
    mu: float
    nu: float
    gel: str


@dataclass(frozen=True)
class SolvePlan:
    """What the emulator of n presses needs.

    top: (n,) deepest depth, mm. leader: (n,) index of the press whose curve each one uses, its own if not shared.
    nodes: for each press, the friction coefficients of its solves, rising. nu: Poisson's ratio.
    """

    readings: Readings
    top: np.ndarray
    leader: np.ndarray
    nodes: list[list[float]]
    nu: float

    def job(self, i: int, press: Press, mu: float) -> SolveJob:
        """The solve of a path of press i."""
        # without friction the force does not depend on the path to a pose
        path = press if mu > 0.0 else press.straight_there
        return SolveJob(path, str(self.readings.indenters[i]), mu, self.nu, str(self.readings.gels[i]))

    def jobs(self, i: int) -> list[SolveJob]:
        """The solves that predict press i, one at each of its nodes."""
        lead = self.leader[i]
        return [self.job(i, self.readings.press(lead, float(self.top[lead])), mu) for mu in self.nodes[i]]

    def compared(self, i: int) -> SolveJob:
        """Fine solve of press i at its last node: as commanded, or straight down to its end pose if it slides."""
        press = self.readings.press(i, float(self.compared_depth[i]))
        return self.job(i, press.straight_there if self.slides[i] else press, self.nodes[i][-1])

    @property
    def compared_depth(self) -> np.ndarray:
        """Depth of the fine solve of each press, (n,) mm: as commanded, rounded for a straight one."""
        depth = self.readings.depth
        return np.where(self.readings.sheared, depth, rounded(depth))

    @property
    def slides(self) -> np.ndarray:
        """Whether a press slides and is solved under Coulomb's law, (n,) bool."""
        return slides(self.readings) & [len(nodes) > 1 for nodes in self.nodes]


def make_plan(readings: Readings, reach: float, law: str, friction_nodes, nu: float) -> SolvePlan:
    """Plan for readings; straight presses of one indenter at one place share one curve to the deepest.

    reach: how far beyond the commanded depth the emulator goes, mm. friction_nodes: coefficients, rising, that
    Coulomb's law needs besides no slip; presses that do not slide use the first alone.
    """
    # ploughing depends on depth, so a press that slides is solved closer to its commanded depth
    sliding = slides(readings) & (law not in FRICTION)
    top = np.round(readings.depth + np.where(sliding, reach / 3, reach), 4)
    # depths of straight presses are rounded up, so that sessions of the same presses share their solves
    top = np.where(readings.sheared, top, np.round(np.ceil(top / ROUNDED_MM - 1e-6) * ROUNDED_MM, 4))
    leader = np.arange(len(readings))
    groups: dict[tuple, int] = {}
    for i in np.argsort(-top, kind="stable"):
        if not readings.sheared[i]:
            # Rounding z0 to 0.1 um is finer than the play of a CNC (0.25 um in the virtual rig's plans); 5 um sideways
            # change the force by less than a sensor resolves.
            place = *np.round(readings.pose[i, [0, 1, 6, 7, 8]], 2), round(readings.pose[i, 2], 4)
            key = (readings.indenters[i], readings.gels[i], *place)
            leader[i] = groups.setdefault(key, int(i))
    few, many = ([*friction_nodes[:count], np.inf] for count in (1, None))
    implied = FRICTION.get(law)
    nodes = [[implied] if implied is not None else many if far else few for far in sliding]
    return SolvePlan(readings, top[leader], leader, nodes, nu)


def scene_of(job: SolveJob, indenter) -> Scene:
    """The scene of a job."""
    return Scene(load_gel(job.gel), Material(job.nu), indenter, job.press, Interface.of_friction(job.mu))


def path_curve(result, press: Press, touch: float) -> dict:
    """Converged load steps of a result: depth and force before shear, from first touch on, and the force at the end.

    touch: path parameter of the first touch, below 0 where the path starts inside the gel.
    Without nested settings, points that come into contact during a step have no friction until its end, and contact is
    iterated once more at the end of the path. So forces of steps are a steady 0.5 to 1.5 % below converged ones; those
    of a straight press are scaled to its converged end.
    """
    steps = np.array(result.evidence["path"], float).reshape(-1, 4)
    down = steps[steps[:, 0] <= 1.0 + 1e-9]
    end = result.total if result.status.valid else steps[-1, 1:]
    if not (press.dx or press.dy):
        down[:, 1:] *= end[2] / down[-1, 3]
    # a press that touches the gel only while it moves sideways has no curve of force against depth
    met = [touch] if len(down) else []
    return {
        "depth": (-press.dz * np.array([*met, *down[:, 0]])).tolist(),
        "force": [*[[0.0] * 3] * len(met), *down[:, 1:].tolist()],
        "end": end.tolist(),
        "centre": centre_of(result).tolist(),
        "status": result.status.name,
        "seconds": float(result.evidence["seconds"]),
    }


def centre_of(result) -> np.ndarray:
    """Where the normal force acts on the deformed gel, (2,) mm along gel x and y: its moments over the force."""
    moment, normal = result.moment, result.total[2]
    return np.array([-moment[1], moment[0]]) / normal if normal else np.zeros(2)


def touch_of(scene: Scene) -> float:
    """Path parameter of the first touch of a press that is known to touch."""
    found = first_touch(scene)
    assert found is not None, "a press without contact has no curve"
    return found


def usable(result, scene: Scene) -> bool:
    """Whether a result is valid, or missed only the final tolerance, at the end of the path.

    Other failures may also reach the end, such as OUT_OF_RANGE and TOO_COARSE, but are not usable.
    """
    path = result.evidence.get("path") or [[0.0]]
    ended = path[-1][0] >= scene.press.end - 1e-9
    return result.status.valid or (result.status in (Status.DIVERGED, Status.UNSETTLED) and ended)


@cache
def solver(settings: HexSettings) -> HexSolver:
    """The solver of this process, so that all friction coefficients of a press share its meshes."""
    return HexSolver(settings)


def solve_job(job: SolveJob, indenter, settings: HexSettings) -> dict:
    """Solve one job, with finer load steps if the first try fails; raise SolveFailed if both fail.

    A solve that completed its path but missed the final tolerance is used with its last load step,
    which is in equilibrium to the tolerance of the path: 1e-4 of the force.
    """
    scene = scene_of(job, indenter)
    result = solver(settings).solve(scene)
    if not usable(result, scene):
        finer = replace(settings, press_steps=2 * settings.press_steps, shear_steps=2 * settings.shear_steps)
        result = HexSolver(finer).solve(scene)
    if not usable(result, scene):
        raise SolveFailed(f"{job.indenter} at {job.press}, mu {job.mu:g}: {result.status.value}", result.evidence)
    if result.status is Status.NO_CONTACT:
        return {
            "depth": [],
            "force": [],
            "end": [0.0] * 3,
            "centre": [0.0] * 2,
            "status": "NO_CONTACT",
            "seconds": 0.0,
        }
    return path_curve(result, job.press, touch_of(scene))


def _solve_task(path, job, indenter, settings):
    """Worker: solve one job and publish it, or the reason why it cannot be solved."""
    try:
        found = solve_job(job, indenter, settings)
    except SolveFailed as error:
        found = {"failed": str(error)}
    write_json(path, found)


class SolveCache:
    """Folder of cached solves; `failed` collects {path: reason}.

    Failures are cached as well, because they would fail again with the same settings and solver.
    version: the solver's, as in stage fea, raised when its results change; solves of an older one are not used.
    """

    def __init__(self, folder, catalogue: dict, settings: HexSettings, version: int):
        self.folder, self.catalogue, self.settings, self.version = Path(folder), catalogue, settings, version
        self.failed: dict[Path, str] = {}
        self._made: set[Path] = set()
        self._shapes: dict[str, str] = {}
        self._used: dict = {}
        self._kept: dict = {}

    def path(self, job: SolveJob) -> Path:
        if job.indenter not in self.catalogue:
            raise BadInput(
                f"indenter {job.indenter!r} is not in the catalogue{nearest(job.indenter, self.catalogue)}"
            )
        if job.indenter not in self._shapes:
            self._shapes[job.indenter] = surface_digest(self.catalogue[job.indenter])
        scene, how = scene_of(job, self.catalogue[job.indenter]), hexahedra_key(self.settings)
        return self.folder / f"{solve_key([scene], self._shapes[job.indenter], how, self.version)}.path.json"

    def fill(self, jobs: list[SolveJob], workers: int = 1) -> None:
        """Solve the jobs that have no file yet, on `workers` processes."""
        required = {self.path(job): job for job in jobs}
        tasks = [
            (path, job, self.catalogue[job.indenter], self.settings)
            for path, job in required.items()
            if self._read(path) is None
        ]
        self._made |= {task[0] for task in tasks}
        # the first one runs alone: it compiles kernels that the processes of the others would each compile
        done = chain(in_slots(_solve_task, tasks[:1], 1), in_slots(_solve_task, tasks[1:], workers))
        for _ in tqdm(done, "calibration solves", len(tasks)):
            pass
        for path in required:
            if reason := (self._read(path) or {}).get("failed"):
                self.failed[path] = reason

    def _read(self, path: Path) -> dict | None:
        if not self._kept.get(path):
            self._kept[path] = record_of(path)
        return self._kept[path]

    def get(self, job: SolveJob) -> dict:
        """The solve of a job that `fill` made."""
        path = self.path(job)
        solve = self._read(path)
        assert solve is not None, "a job that `fill` did not make"
        if "failed" in solve:
            raise SolveFailed(solve["failed"])
        self._used[path] = job
        return solve

    @property
    def spent(self) -> dict:
        """Number of solves that a result uses: total, per interface law, and `new`, those made by this process.

        `in_vain`: made by this process for presses that are left out.
        """
        laws = [Interface.of_friction(job.mu).law for job in self._used.values()]
        new = len(self._made & set(self._used))
        counts = {law: laws.count(law) for law in sorted(set(laws))}
        return {"total": len(laws), **counts, "new": new, "in_vain": len(self._made) - new}


def solve_all(plan: SolvePlan, cache: SolveCache, workers: int = 1) -> dict[int, str]:
    """Solve what the planned presses need; return {press: reason} of those that could not be solved."""
    needs = {i: plan.jobs(i) + [plan.compared(i)] * bool(plan.slides[i]) for i in range(len(plan.top))}
    cache.fill([job for jobs in needs.values() for job in jobs], workers)
    reasons = {i: [cache.failed[p] for p in map(cache.path, jobs) if p in cache.failed] for i, jobs in needs.items()}
    return {i: found[0] for i, found in reasons.items() if found}


def build_emulator(plan: SolvePlan, cache: SolveCache) -> em.Emulator:
    """Emulator of the planned presses, whose solves must be in the cache; BadInput for a press without contact."""
    table = np.array([press_table(plan, cache, i) for i in range(len(plan.top))])
    refuse_no_contact(plan.readings, table)
    group = np.unique(plan.readings.indenters, return_inverse=True)[1]
    mounting = np.unique(plan.readings.mountings, return_inverse=True)[1]
    return em.Emulator(table, plan.top, group, plan.readings.travel, mounting)


def press_table(plan: SolvePlan, cache: SolveCache, i: int) -> np.ndarray:
    """Forces (FRICTIONS, DEPTHS, 3) of press i, after its shear."""
    solves, top = [cache.get(job) for job in plan.jobs(i)], float(plan.top[i])
    table = em.friction_table(plan.nodes[i], [press_curve(solve, top) for solve in solves])
    if not plan.readings.sheared[i] or not table.any():
        return table
    return em.sheared_table(table, top, plan.nodes[i], [solve["end"] for solve in solves])


def refine(
    emulator: em.Emulator, plan: SolvePlan, coarse: SolveCache, fine: SolveCache, workers: int = 1
) -> em.Emulator:
    """Emulator whose forces are scaled to finer hexahedra, by one fine solve of each press (`SolvePlan.compared`).

    The error of coarse hexahedra depends on the shape and place of the contact and hardly on friction: under a block
    and balls it is smaller than without slip by 1 to 2 % of the force at mu = 0.2, by 0.3 % at 0.5. So it is measured
    at the last node of the law, where fine hexahedra solve only the end of the path, in a quarter of the time that
    Coulomb's law takes. The sideways force has its own ratio of fine to coarse while the contact sticks. In full slip
    it is friction times the normal force and takes the normal ratio, which for a press that slides is that of the
    straight press. A fine solve that fails raises SolveFailed.
    """
    jobs = [plan.compared(i) for i in range(len(plan.top))]
    fine.fill(jobs, workers)
    if fine.failed:
        raise SolveFailed(
            f'a refining solve failed ({next(iter(fine.failed.values()))}); set [calibrate] refine = "none"'
        )
    table = emulator.table.copy()
    for i, job in enumerate(jobs):
        grid = np.linspace(0.0, plan.top[i], em.DEPTHS)
        before = np.array([np.interp(plan.compared_depth[i], grid, force) for force in table[i, -1].T])
        if plan.slides[i]:
            before = np.array(coarse.get(job)["end"])
        end = np.array(fine.get(job)["end"])
        if before[2] < 0 and end[2] < 0:
            normal, aside = end[2] / before[2], np.hypot(*before[:2])
            # the ratio of a small sideways force is noise, and that of a sliding one is the normal force's
            own = np.hypot(*end[:2]) / aside / normal if aside > -0.01 * before[2] and not plan.slides[i] else 1.0
            table[i] *= normal
            table[i, ..., :2] *= own ** em.sticking(table[i])[..., None]
    return replace(emulator, table=table)


def with_tilts(
    emulator: em.Emulator,
    plan: SolvePlan,
    catalogue: Mapping[str, Indenter],
    tilted: Collection[str],
    cache: SolveCache,
    workers: int = 1,
) -> em.Emulator:
    """Emulator that also knows what tilt does to the presses of the mountings `tilted` (`calibration.tilts`).

    Solved without slip, or under the plan's law if that has no coefficient to find. A solve that fails raises SolveFailed.
    """
    readings = plan.readings
    flat = np.array([feels_tilt(catalogue[name]) for name in readings.indenters], bool)
    asked = {}
    for name in tilted:
        mine = np.flatnonzero(readings.mountings == name)
        for i in mine[solved_presses(readings.take(mine), flat[mine])]:
            asked[i] = [plan.job(i, press, plan.nodes[i][-1]) for press in nodes_of(readings, i)]
    cache.fill([job for jobs in asked.values() for job in jobs], workers)
    n, depth = len(readings), readings.depth.copy()
    force, centre, moved = np.zeros((n, 2)), np.full((n, 2), np.nan), np.zeros((n, 2, 2))
    for i, jobs in asked.items():
        force[i], centre[i], moved[i] = response([cache.get(job) for job in jobs])
        depth[i] = -jobs[0].press.dz
    force[~flat] = 0.0
    # presses that were not solved are changed as the solved ones of their indenter are
    for name in np.unique(readings.indenters[list(asked)]):
        of = readings.indenters == name
        solved = of & np.isin(np.arange(n), list(asked))
        force[of & ~solved] = force[solved].mean(axis=0)
        depth[of & ~solved] = depth[solved].mean()
    return replace(emulator, tilts=Tilts(depth, flat, force, centre, moved))


def press_curve(solve: dict, top: float) -> np.ndarray:
    """Force (DEPTHS, 3) of the press of one solve, before any shear."""
    if not solve["depth"]:
        return np.zeros((em.DEPTHS, 3))
    return em.curve_table(em.Curve(np.array(solve["depth"]), np.array(solve["force"])), float(top))


def refuse_no_contact(readings, table) -> None:
    """Refuse presses whose path, by geometry, never meets the gel although a force was logged."""
    silent = np.flatnonzero(np.abs(table[..., 2]).max(axis=(1, 2)) == 0.0)
    if len(silent):
        raise BadInput(
            f"{readings.source}: {readings.name(silent)}: depth without contact: by its position and depth the "
            "indenter never touches the gel; check x0, y0, z0 and dz, or remove the row"
        )
