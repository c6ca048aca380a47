"""What calibration promises: four real points, truth recovered, the demo's hidden C10, and time."""

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge import calibrate as stage
from gelforge import config
from gelforge.benchmarks.figures import Figure, publish_figures
from gelforge.calibration.emulator import Emulator
from gelforge.calibration.parameters import LAWS, make_model
from gelforge.calibration.posterior import Posterior
from gelforge.calibration.readings import Readings
from gelforge.calibration.sampling import sample
from gelforge.calibration.solves import SolveCache, build_emulator, make_plan, solve_all
from gelforge.calibration.summary import describe
from gelforge.errors import SolveFailed
from gelforge.files import read_json, write_json
from gelforge.geometry.indenters import load_catalogue
from gelforge.progress import progress

NU = 0.475
RIG_MUS = (0.0, 0.3, 0.8, np.inf)
# Indenter, place, turn, sideways travel, depths: round and flat, straight, and one with shear three times, as a first
# session at a new bench would have it.
DESIGN = (
    ("sphere_15", (0.0, 0.0), 0.0, (0.0, 0.0), (0.4, 0.7, 1.0, 1.3, 1.6, 1.9)),
    ("cuboid_10", (1.0, 1.5), 20.0, (0.0, 0.0), (0.3, 0.5, 0.7, 0.9, 1.1)),
    ("sphere_10", (-1.5, 2.0), 0.0, (0.3, 0.1), (1.2, 1.2, 1.2)),
)


def design() -> Readings:
    """The presses of a synthetic session, forces still unknown."""
    rows = [(name, [*at, 0.0, *slide, -d, turn]) for name, at, turn, slide, depths in DESIGN for d in depths]
    n = len(rows)
    names, poses = np.array([name for name, _ in rows]), np.array([pose for _, pose in rows])
    ids = np.array([f"synthetic-{i:02d}" for i in range(n)])
    return Readings("synthetic", np.arange(2, n + 2), ids, names, poses, np.full((n, 3), np.nan))


def rig_emulator(readings: Readings, catalogue, params: dict, folder: Path, jobs: int) -> Emulator:
    """The rig's forces on the rig's own mesh, at four friction coefficients."""
    from gelforge.virtualrig.bench import SETTINGS

    cache = SolveCache(folder, catalogue, replace(SETTINGS, press_steps=10))
    plan = make_plan(readings, params["reach_mm"], (1.0, 0.7))
    failed = solve_all(plan, cache, RIG_MUS, [NU], jobs)
    if failed:
        raise SolveFailed(f"the rig's own solves failed: {failed}")
    return build_emulator(plan, cache, RIG_MUS, [NU])


def draw_truths(model, count: int, rng: np.random.Generator) -> np.ndarray:
    """Coordinates (count, free) over the priors, Latin hypercube: every parameter's range is covered evenly.

    What stands for the emulator's own error is not drawn: the difference of the meshes is real.
    """
    columns = []
    for name, prior in model.free.items():
        u = (rng.permutation(count) + rng.random(count)) / count
        if name == "discretisation" or name.startswith("scale of"):
            u[:] = 0.5
        columns.append(prior.quantile(u))
    return np.stack(columns, axis=1)


def read_forces(rig: Emulator, readings: Readings, model, truth, rng) -> np.ndarray:
    """One reading of every press (n, 3) N: each touches with its own scatter, the load cell adds noise."""
    values = model.values(truth)
    depth = readings.depth + values["scatter"][0] * rng.standard_normal(len(readings))
    forces = rig.forces(depth, values)[0][0]
    return forces + values["noise"][0] * rng.standard_normal(forces.shape)


def recover(task) -> dict:
    """One synthetic calibration; task: (posterior, rules, true C10)."""
    posterior, rules, truth = task
    chain = sample(posterior, rules)
    return {"truth": truth, **describe(posterior.model.values(chain.flat())["c10"])}


def both_emulators(params: dict, folder: Path, jobs: int) -> tuple[Readings, Emulator, Emulator]:
    """The design's readings with the emulator of the stage and that of the rig."""
    readings = design()
    catalogue = load_catalogue("workflow/indenters.toml", sorted(set(readings.indenters.tolist())))
    readings, own, _ = stage.emulate(readings, catalogue, params, NU, folder / "solves", jobs)
    return readings, own, rig_emulator(readings, catalogue, params, folder / "rig", jobs)


def coverage(params: dict, folder: Path, jobs: int, count: int) -> list[dict]:
    """Synthetic calibrations of truths drawn from the priors."""
    readings, own, rig = both_emulators(params, folder, jobs)
    priors = {**params["priors"], "nu": {"fixed": NU, **params["priors"]["nu"]}}
    model = make_model({**params, "priors": priors}, "coulomb", (), np.unique(readings.indenters).tolist())
    rng = np.random.default_rng(2026)
    tasks = []
    for k, truth in enumerate(draw_truths(model, count, rng)):
        force = read_forces(rig, readings, model, truth, rng)
        observed = stage.served(replace(readings, force=force), params)
        rules = replace(stage.sampling_rules(params), seed=k)
        c10 = float(model.values(truth)["c10"][0])
        tasks.append((Posterior(own, model, readings.depth, observed, params["tail"]), rules, c10))
    with ProcessPoolExecutor(jobs) as pool:
        return list(progress(pool.map(recover, tasks), "synthetic calibrations", count))


def coverage_figures(runs: list[dict]) -> list[Figure]:
    """How often the intervals hold the truth, as the four bounds that were asked for."""
    held = {n: sum(r[n][0] <= r["truth"] <= r[n][1] for r in runs) for n in ("interval68", "interval95")}
    error = np.array([abs(r["median"] / r["truth"] - 1) for r in runs])
    width = np.array([(r["interval68"][1] - r["interval68"][0]) / 2 / r["median"] for r in runs])
    note = (
        f"{len(runs)} truths; half width {100 * np.median(width):.1f} %, median error {100 * np.median(error):.1f} %"
    )
    return [
        Figure("68 % interval holds the truth, at least", held["interval68"], ">=", 60, "of 100", note),
        Figure("68 % interval holds the truth, at most", held["interval68"], "<=", 76, "of 100"),
        Figure("95 % interval holds the truth, at least", held["interval95"], ">=", 89, "of 100"),
        Figure("95 % interval holds the truth, at most", held["interval95"], "<=", 99, "of 100"),
    ]


def processor_seconds() -> float:
    """Processor time of this process and its finished children; what a loaded machine does not lengthen."""
    return sum(os.times()[:4])


def run_stage(dataset: str, folder: Path, jobs: int) -> tuple[dict, float, str]:
    """Calibrate a dataset as make would; return the summary, the seconds of a run on cached solves and a note.

    Solves are those of make calibrate, found or made; chain, plots and summary stay in `folder`.
    """
    work = folder / dataset
    params = config.load_params("workflow", Path("data") / dataset / "dataset.toml")
    write_json(work / "params.json", config.cut_slice(params, "calibrate", stage.VERSION))
    places = {
        "--data": Path("data") / dataset,
        "--poses": Path("results") / dataset / "10_poses",
        "--params": work / "params.json",
        "--work": work,
        "--solves": Path("results") / dataset / "calibrate" / "solves",
        "--out": work / "summary.json",
    }
    args = [str(part) for pair in places.items() for part in pair] + ["--jobs", str(jobs)]
    stage.main(args)
    (work / "chain.npz").unlink()
    start, spent = time.perf_counter(), processor_seconds()
    stage.main(args)
    seconds, spent = time.perf_counter() - start, processor_seconds() - spent
    return read_json(work / "summary.json"), seconds, f"{jobs} processes, {spent:.0f} s of processor time together"


def four_point_figures(folder: Path, jobs: int) -> list[Figure]:
    """The real sphere."""
    found, seconds, note = run_stage("feats_sphere15", folder, jobs)
    c10, laws = found["c10"], {k: v for k, v in found["solves_spent"].items() if k in LAWS}
    best = min(m["predictive_mae_n"]["fz"] for m in found["models"])
    low, high = c10["interval95"]
    return [
        Figure("four real points, predictive mean", found["predictive_mae_n"]["fz"], "<=", 0.05, "N",
               f"of a press repeated; best of all models {best:.3f}; the paper: 0.5166"),
        Figure("four real points, each with its own touch", found["own_touch_mae_n"]["fz"], "<=", 0.05, "N",
               "posterior mean at these very presses, touch scatter of micrometres inferred"),
        Figure("solves per interface law, most", max(laws.values()), "<=", 12, "", str(laws)),
        Figure("C10 from the four points, stated without a goal", c10["median"], ">=", 0.0, "MPa",
               f"95 %: {low:.4f} to {high:.4f}"),
        Figure("four points, calibration on cached solves", seconds, "<=", 60, "s", note),
    ]  # fmt: skip


def demo_figures(folder: Path, jobs: int) -> list[Figure]:
    """The rig's hidden C10."""
    truth = read_json("data/demo/truth/truth.json")["truth"]["c10_mpa"]
    found, seconds, note = run_stage("demo", folder, jobs)
    c10 = found["c10"]
    low, high = c10["interval95"]
    return [
        Figure("demo, hidden C10 inside the 95 % interval", float(low <= truth <= high), "==", 1, "",
               f"{low:.4f} to {high:.4f}, truth {truth:.4f} MPa"),
        Figure("demo, median off the hidden C10", 100 * abs(c10["median"] / truth - 1), "<=", 3, "%",
               f"median {c10['median']:.4f} MPa"),
        Figure("demo, calibration on cached solves", seconds, "<=", 60, "s",
               f"{found['presses']} presses, {found['solves_spent']['total']} solves, {note}"),
    ]  # fmt: skip


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(prog="gelforge.benchmarks.calibration", description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--count", type=int, default=100, help="synthetic calibrations; fewer only to try it out")
    args = parser.parse_args(argv)
    folder = args.out.parent / "calibration"
    figures = four_point_figures(folder, args.jobs) + demo_figures(folder, args.jobs)
    runs = coverage(config.load_params("workflow")["calibrate"], folder, args.jobs, args.count)
    write_json(folder / "runs.json", runs)
    publish_figures(args.out, figures + coverage_figures(runs))
    return 0


if __name__ == "__main__":
    from gelforge.cli import exit_with

    exit_with(main)
