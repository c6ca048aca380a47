"""Calibration: four real points, recovery of synthetic truths, the demo's hidden C10, the emulator's error, and time.

Parts `points`, `demo`, `emulator` and `coverage` are stored beside the figures and made again only if code,
parameters or data changed: `--only PART` makes one of them; without it all are made and the figures are written. The
synthetic calibrations of `coverage` are stored one by one, so that a stopped run resumes.
"""

import hashlib
import json
import resource
import shutil
import subprocess
import sys
import time
from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.optimize import minimize_scalar
from tqdm import tqdm

from gelforge.calibration.emulator import Emulator
from gelforge.calibration.parameters import make_model
from gelforge.calibration.posterior import ERROR, SIDEWAYS_ERROR, SIDEWAYS_ERROR_OF_NORMAL, Posterior, tare_of
from gelforge.calibration.readings import Readings, choose_presses, read_readings
from gelforge.calibration.sampling import sample
from gelforge.calibration.solves import SolveCache, build_emulator, make_plan, refine, solve_all
from gelforge.calibration.summary import describe
from gelforge.errors import GelforgeError, SolveFailed
from gelforge.flow import params as config
from gelforge.flow.cli import command, option
from gelforge.flow.files import read_json, write_json, write_text
from gelforge.flow.layout import CALIBRATE, Layout
from gelforge.flow.tables import CalibrateTable
from gelforge.geometry.gel import USUAL_GEL
from gelforge.geometry.indenters import load_catalogue
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.stages import calibrate as stage
from gelforge.stages.fea import VERSION as SOLVER_VERSION
from tests.support.calibration_law import one_mounting
from tests.support.figures import Figure, publish_figures, table
from tests.support.sandbox import make

NU = 0.475
# Synthetic chains are shorter than those of the stage: with a few hundred independent draws, the sampling error of an
# interval's ends is a tenth of a standard deviation.
TAUS, RHAT = 20, 1.1
PARTS = ("points", "demo", "emulator", "coverage")
# Friction coefficients at which the synthetic benches are solved, besides no slip: they span the truths drawn from
# the prior, and all of them serve every press.
RIG_MUS = (0.12, 0.2, 0.3, 0.45, 0.8)
LAW = "coulomb"
# Friction coefficients, between the emulator's own, and touch offsets, mm, of the solves that it is compared with, and
# compliance of the frame, mm/N: both make the emulated depths others than the commanded ones.
HELD, HELD_COMPLIANCE = ((0.35, -0.05), (0.7, 0.05)), 0.006
# Indenter, place, turn, sideways travel, depths: round and flat, straight, with shear, and sliding, as in a first
# session at a new bench that follows the guide.
DESIGN = (
    ("sphere_15", (0.0, 0.0), 0.0, (0.0, 0.0), (0.4, 0.7, 1.0, 1.3, 1.6, 1.9)),
    ("cuboid_10", (1.0, 1.5), 20.0, (0.0, 0.0), (0.3, 0.5, 0.7, 0.9, 1.1)),
    ("sphere_10", (-1.5, 2.0), 0.0, (0.3, 0.1), (1.2,)),
    ("sphere_15", (1.0, -1.0), 0.0, (-0.1, 0.2), (1.0,)),
    ("cuboid_10", (0.0, -1.5), 70.0, (0.15, -0.25), (0.8,)),
    ("sphere_15", (0.5, 1.5), 0.0, (0.9, 0.4), (0.5,)),
    ("cuboid_10", (-1.0, 0.5), 45.0, (-0.5, 0.8), (0.4,)),
)


def design() -> Readings:
    """The presses of a synthetic session, with forces nan."""
    rows = [(name, [*at, 0.0, *slide, -d, turn]) for name, at, turn, slide, depths in DESIGN for d in depths]
    n = len(rows)
    names, poses = np.array([name for name, _ in rows]), np.array([pose for _, pose in rows])
    ids = np.array([f"synthetic-{i:02d}" for i in range(n)])
    force, gels = np.full((n, 3), np.nan), np.array([USUAL_GEL] * n)
    return Readings("synthetic", np.arange(2, n + 2), ids, names, poses, force, gels, *one_mounting(n))


def rig_meshes() -> list[tuple[HexSettings, str]]:
    """Meshes of the synthetic benches, finer than the emulator's, each with the quality that corrects its forces.

    A mesh's error is the same in all readings made with it. The posterior allows for the percent by which accurate
    meshes differ, so truths must come from several meshes: with one alone, the coverage of intervals is too high or
    too low.
    """
    middle = HexSettings(size=0.6, layers=5, press_steps=10, shear_steps=8)
    return [(middle, "label"), (replace(middle, size=0.5), "fine")]


def rig_emulator(
    readings: Readings, catalogue, params: CalibrateTable, mesh: HexSettings, better: str, folder: Path, jobs: int
) -> Emulator:
    """The rig's forces on `mesh`, corrected by quality `better`, at other friction coefficients than the stage's."""
    cache = SolveCache(folder, catalogue, mesh, SOLVER_VERSION)
    plan = make_plan(readings, params.reach_mm, LAW, RIG_MUS, NU)
    plan = replace(plan, nodes=[[*RIG_MUS, np.inf]] * len(readings))
    failed = solve_all(plan, cache, jobs)
    if failed:
        raise SolveFailed(f"the rig's own solves failed: {failed}")
    fine = SolveCache(folder, catalogue, quality(better), SOLVER_VERSION)
    return refine(build_emulator(plan, cache), plan, cache, fine, jobs)


def draw_truths(model, count: int, rng: np.random.Generator) -> np.ndarray:
    """Coordinates (count, free) over the priors, by Latin hypercube sampling, which covers every parameter evenly.

    The factor for the emulator's mesh error is not drawn, because the meshes really differ. An indenter's own factor
    is drawn, because it also stands for errors of the printed shape, which no mesh has.
    """
    columns = []
    for name in model.free:
        u = (rng.permutation(count) + rng.random(count)) / count
        # without the tails of the offset's prior: a touch that was missed altogether is reported, not calibrated
        columns.append(np.full(count, 0.5) if name == "discretisation" else 0.1 + 0.8 * u if name == "offset" else u)
    return model.coordinates(np.stack(columns, axis=1))


def read_forces(rig: Emulator, readings: Readings, model, truth, rng) -> np.ndarray:
    """One reading of every press (n, 3) N, with scatter of the touch depth and noise of the load cell."""
    values = model.values(truth)
    depth = readings.depth + values["scatter"][0] * rng.standard_normal(len(readings))
    forces = rig.forces(depth, values)[0][0] + tare_of(values)
    return forces + values["noise"][0] * rng.standard_normal(forces.shape)


def recover(task) -> dict:
    """C10 and friction of one synthetic calibration. task: (posterior, rules, the truth's coordinates)."""
    posterior, rules, truth = task
    true, found = (posterior.model.values(at) for at in (truth, sample(posterior, rules).flat()))
    return {name: {"truth": float(true[name][0]), **describe(found[name])} for name in ("c10", "mu")}


def all_emulators(params: CalibrateTable, folder: Path, jobs: int) -> tuple[Readings, Emulator, list[Emulator]]:
    """The design's readings with the emulator of the stage and those of the rig."""
    readings = design()
    catalogue = load_catalogue("workflow/indenters.toml", sorted(set(readings.indenters.tolist())))
    readings, own, _ = stage.emulate(readings, catalogue, params, LAW, NU, folder / "solves", jobs)
    rigs = [rig_emulator(readings, catalogue, params, *mesh, folder / "solves", jobs) for mesh in rig_meshes()]
    return readings, own, rigs


def synthetic_tasks(params: CalibrateTable, folder: Path, jobs: int, count: int) -> list:
    """Tasks of `recover` for truths drawn from the priors."""
    readings, own, rigs = all_emulators(params, folder, jobs)
    model = make_model(params, LAW, np.unique(readings.indenters).tolist())
    rng = np.random.default_rng(2026)
    tasks = []
    for k, truth in enumerate(draw_truths(model, count, rng)):
        force = read_forces(rigs[k % len(rigs)], readings, model, truth, rng)
        observed = stage.served(replace(readings, force=force))
        rules = replace(stage.sampling_rules(params), taus=TAUS, rhat=RHAT, seed=k)
        tasks.append((Posterior(own, model, readings.depth, observed, params.tail), rules, truth))
    return tasks


def coverage(params: CalibrateTable, folder: Path, jobs: int, count: int, key: str) -> list[dict]:
    """Synthetic calibrations of truths drawn from the priors; those stored under `key` are not made again."""
    tasks = synthetic_tasks(params, folder, jobs, count)
    runs = kept(folder / "runs.json", key, [])
    with ProcessPoolExecutor(jobs) as pool:
        done = pool.map(recover, tasks[len(runs) :])
        for run in tqdm(done, "synthetic calibrations", count - len(runs)):
            runs.append(run)
            write_json(folder / "runs.json", {"key": key, "content": runs})
    return runs


def coverage_figures(runs: list[dict]) -> list[Figure]:
    """Coverage of the intervals of C10 and of the friction coefficient, with lower and upper goals."""
    figures = []
    for name, label in (("c10", "C10"), ("mu", "friction")):
        found = [run[name] for run in runs]
        error = np.array([abs(r["median"] / r["truth"] - 1) for r in found])
        width = np.array([(r["interval68"][1] - r["interval68"][0]) / 2 / r["median"] for r in found])
        note = f"{len(runs)} truths; half width {100 * np.median(width):.1f} %, median error {100 * np.median(error):.1f} %"
        for interval, percent, least, most in (("interval68", 68, 60, 76), ("interval95", 95, 89, 99)):
            held = sum(r[interval][0] <= r["truth"] <= r[interval][1] for r in found)
            said = f"{label}: {percent} % interval holds the truth"
            figures += [
                Figure(f"{said}, at least", held, ">=", least, "of 100", note),
                Figure(f"{said}, at most", held, "<=", most, "of 100"),
            ]
    return figures


def held_out(
    readings: Readings, params: CalibrateTable, folder: Path, jobs: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Emulated and solved forces, each (n, 3) N, of presses as in HELD, and each one's indenter with its mu, (n,) str.

    The solves are by hexahedra of quality `label` with more load steps, and with other friction and depths than those
    of the emulator.
    """
    catalogue = load_catalogue("workflow/indenters.toml", sorted(set(readings.indenters.tolist())))
    readings, emulator, _ = stage.emulate(readings, catalogue, params, LAW, NU, folder / "solves", jobs)
    plan = make_plan(readings, params.reach_mm, LAW, params.friction_nodes, NU)
    # with two shear steps, the sideways force of a block that slides is 16 % smaller than with eight
    settings = replace(quality("label"), press_steps=8, shear_steps=8)
    cache = SolveCache(folder / "solves", catalogue, settings, SOLVER_VERSION)
    model = make_model(params, "no_slip", np.unique(readings.indenters).tolist())
    values = {name: np.zeros(1) for name in model.values(model.coordinates(np.full((1, len(model.free)), 0.5)))}
    values |= {"c10": np.array([REFERENCE_C10]), "indenter": np.zeros((1, len(model.indenters)))}
    values |= {"touch": np.zeros((1, 1)), "tilt": np.zeros((1, 1, 2))}
    without = emulator.forces(readings.depth, values | {"mu": np.array([np.inf])})[0][0]
    yielded = HELD_COMPLIANCE * np.abs(without[:, 2])
    cases = [(mu, np.round(readings.depth - yielded + offset, 2)) for mu, offset in HELD]
    asked = [[plan.job(i, readings.press(i, float(d)), mu) for i, d in enumerate(depth)] for mu, depth in cases]
    cache.fill([job for group in asked for job in group], jobs)
    solved = [[cache.get(job)["end"] for job in group] for group in asked]
    emulated = [emulator.forces(depth, values | {"mu": np.array([mu])})[0][0] for mu, depth in cases]
    groups = [np.char.add(readings.indenters.astype(str), f" {mu}") for mu, _ in cases]
    return np.concatenate(emulated), np.concatenate(solved), np.concatenate(groups)


def emulator_figures(params: CalibrateTable, folder: Path, jobs: int) -> list[Figure]:
    """Error of emulated forces from press to press, as the scale that the likelihood uses.

    Measured on the presses of the demo's calibration and of the synthetic session. The mean error of an indenter's
    presses at one friction coefficient is excluded, because the posterior has a parameter for it.
    """
    demo = read_readings("data/demo/log.csv")
    demo = demo.take(choose_presses(demo, params.max_presses, LAW))
    parts = [held_out(readings, params, folder, jobs) for readings in (demo, design())]
    emulated, solved = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    groups = np.concatenate([np.char.add(f"{session} ", part[2]) for session, part in enumerate(parts)])
    off = np.log(solved[:, 2] / emulated[:, 2])
    names = np.unique(groups)
    mean = {name: off[groups == name].mean() for name in names}
    own = (off - [mean[name] for name in groups]) * np.sqrt(len(off) / (len(off) - len(names)))
    normal = float(stats.t.fit(own, f0=params.tail, floc=0.0)[2])
    sideways = np.hypot(*emulated[:, :2].T)
    error = (solved - emulated)[:, :2]

    def unlikely(fraction: float) -> float:
        scale = np.hypot(SIDEWAYS_ERROR_OF_NORMAL * emulated[:, 2], fraction * sideways)[:, None]
        return -float(stats.t.logpdf(error / scale, params.tail).sum() - 2.0 * np.log(scale).sum())

    fraction = float(minimize_scalar(unlikely, bounds=(1e-4, 0.5), method="bounded").x)
    note = f"{len(off)} solves; all of them {100 * off.mean():.1f} % more than emulated"
    return [
        Figure("emulated normal forces, error from press to press", 100 * normal, "<=", 100 * ERROR, "%", note),
        Figure("emulated sideways forces, the same", 100 * fraction, "<=", 100 * SIDEWAYS_ERROR, "%"),
    ]


def timed_run(args: list[str]) -> tuple[float, float]:
    """Run the stage as a separate process; seconds of wall and of processor time, including its workers."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "gelforge.stages.calibrate", *args]
    asked = subprocess.run(command, check=False, capture_output=True, text=True)
    if asked.returncode:
        raise SolveFailed(f"gelforge.stages.calibrate {' '.join(args)}: {asked.stderr[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - start, spent


def run_stage(dataset: str, folder: Path, jobs: int) -> tuple[dict, list[Figure]]:
    """Calibrate a dataset as make would, with its solves; return summary and cost. All files go to `folder`."""
    made, of = Layout(Path("results") / dataset), Layout(folder / "results" / dataset)
    planned = make(Path(), f"DATASET={dataset}", f"{made.root}/00_plan/plan.mk")
    if planned.returncode:
        raise GelforgeError(planned.stdout)
    shutil.rmtree(of.folder(CALIBRATE) / "solves", ignore_errors=True)
    for name in ("data", "workflow"):
        if not (of.base / name).exists():
            of.root.mkdir(parents=True, exist_ok=True)
            (of.base / name).symlink_to(Path(name).absolute())
    params = config.load_params("workflow", of.data / "dataset.toml")
    write_json(of.parameters("calibrate"), config.plain(config.parameters_of(params, "calibrate", stage.VERSION)))
    write_json(of.parameters("sensors"), read_json(made.parameters("sensors")))
    for name in made.names():
        write_text(of.shard(name), made.shard(name).read_text(encoding="utf-8"))
        if made.rejected(name).exists():
            write_text(of.rejected(name), made.rejected(name).read_text(encoding="utf-8"))
    args = [str(of.root), "--jobs", str(jobs)]
    wall, spent = timed_run(args)
    _, again = timed_run(args)
    found = read_json(of.calibration())
    note = f"{found['presses']} presses, {found['solves_spent']['total']} solves, law {found['law']}"
    return found, [
        Figure(f"{dataset}, processor time, solves included", spent, "<=", 25, "s", f"{wall:.0f} s of wall; {note}"),
        Figure(f"{dataset}, processor time on cached solves", again, "<=", 15, "s"),
    ]


def four_point_figures(folder: Path, jobs: int) -> list[Figure]:
    """The real sphere."""
    found, seconds = run_stage("feats_sphere15", folder, jobs)
    c10 = found["c10"]
    low, high = c10["interval95"]
    return [
        Figure("four real points, error of one that is left out", found["left_out_mae_n"]["fz"], "<=", 0.5, "N",
               "of four points the outer ones are predicted beyond the others; the paper's fit: 0.5166"),
        Figure("C10 from the four points, stated without a goal", c10["median"], ">=", 0.0, "MPa",
               f"95 %: {low:.4f} to {high:.4f}"),
        *seconds,
    ]  # fmt: skip


def demo_figures(folder: Path, jobs: int) -> list[Figure]:
    """The rig's hidden C10 and friction."""
    truth = read_json("data/demo/truth/truth.json")["truth"]
    found, seconds = run_stage("demo", folder, jobs)
    figures = []
    for name, key, percent in (("C10", "c10_mpa", 3), ("friction", "friction", 10)):
        of, true = (found["c10"] if name == "C10" else found["parameters"]["mu"]), truth[key]
        low, high = of["interval95"]
        note = f"{of['median']:.4f}, 95 %: {low:.4f} to {high:.4f}, truth {true:.4f}"
        figures += [
            Figure(f"demo, hidden {name} inside the 95 % interval", float(low <= true <= high), "==", 1, "", note),
            Figure(
                f"demo, {name}, difference from the hidden one",
                100 * abs(of["median"] / true - 1),
                "<=",
                percent,
                "%",
            ),
        ]
    return [*figures, *seconds]


def part_key(part: str, count: int) -> str:
    """Digest of everything that the figures of a part depend on: code, parameters, data."""
    here = Path(stage.__file__).parent.parent
    files = (Path(__file__), here / "stages" / "calibrate.py", *sorted(here.glob("calibration/*.py")))
    code = [file.read_text() for file in files]
    parameters = config.load_params("workflow")
    tables = [config.plain(parameters.calibrate), config.plain(parameters.material)]
    facts: list = [code, tables, SOLVER_VERSION]
    if part == "coverage":
        facts.append(count)
    else:
        data = Path("data") / ("feats_sphere15" if part == "points" else "demo")
        facts += [(data / name).read_text() for name in ("log.csv", "dataset.toml")]
    return hashlib.sha256(json.dumps(facts, default=str).encode()).hexdigest()


def kept(path: Path, key: str, default):
    """Content of the file `path` if it was stored under this key, else `default`."""
    found = read_json(path) if path.exists() else None
    return found["content"] if isinstance(found, dict) and found.get("key") == key else default


def figures_of(part: str, folder: Path, jobs: int, count: int) -> list[Figure]:
    """Figures of a part, stored or newly made."""
    key = part_key(part, count)
    made = kept(folder / f"{part}.json", key, None)
    if made is not None:
        return [Figure(**figure) for figure in made]
    if part == "coverage":
        figures = coverage_figures(coverage(config.load_params("workflow").calibrate, folder, jobs, count, key))
    elif part == "emulator":
        figures = emulator_figures(config.load_params("workflow").calibrate, folder, jobs)
    else:
        figures = {"points": four_point_figures, "demo": demo_figures}[part](folder, jobs)
    content = [{**asdict(figure), "value": float(figure.value)} for figure in figures]
    write_json(folder / f"{part}.json", {"key": key, "content": content})
    return figures


@command(
    option("--out", type=Path),
    option("--jobs", type=int, default=2),
    option("--count", type=int, default=100, help="synthetic calibrations; fewer only to try it out"),
    option("--only", choices=PARTS, help="make one part; no figures are written", default=None),
)
def main(args: Namespace) -> None:
    folder = args.out.parent / "calibration"
    parts = (args.only,) if args.only else PARTS
    figures = [figure for part in parts for figure in figures_of(part, folder, args.jobs, args.count)]
    if args.only:
        print(table(figures))
    else:
        publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
