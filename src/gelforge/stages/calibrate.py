"""Branch calibrate: posterior of the gel's C10 and of what the rig does to the measurement."""

import os
import sys
from argparse import Namespace
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gelforge.calibration import scores, summary
from gelforge.calibration.floor import least_error
from gelforge.calibration.parameters import Model, compared_models, held_nu, make_model, prior_of, with_nu
from gelforge.calibration.posterior import LeaveOneOut, Posterior
from gelforge.calibration.readings import Readings, check_enough, check_readings, choose_presses, read_readings
from gelforge.calibration.sampling import Chain, Rules, sample
from gelforge.errors import BadInput
from gelforge.flow.files import write_json
from gelforge.flow.layout import planned_shards, surfaces_beside
from gelforge.flow.main import command, option, positive
from gelforge.flow.params import DatasetFile, read_dataset_file, read_indenter_tables
from gelforge.flow.params.stages import ForCalibrate, read_parameters
from gelforge.flow.params.tables import CalibrateSolverTable, CalibrateTable
from gelforge.flow.progress import progress
from gelforge.flow.slots import in_slots
from gelforge.geometry.gel import use_gels_of
from gelforge.labelling.sensor import Sensor, load_sensors
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.records.log import rejected_rows
from gelforge.reporting import cornerplots as plots

VERSION = 8
MOST_BANDS = 6  # indenters in the plot of predictive bands, the first by name: more hide each other
LARGEST_NU = 0.4995  # that is solved, below the 1/2 of a gel that keeps its volume


@dataclass(frozen=True)
class Calibration:
    """A finished calibration: readings used, headline posterior and chain.

    compared: (posterior, chain, score) of every model.
    """

    readings: Readings
    posterior: Posterior
    chain: Chain
    compared: list


def sampling_rules(params: CalibrateTable) -> Rules:
    """Rules from the table [calibrate]."""
    low, high = params.acceptance
    return Rules(
        params.walkers, params.seed, params.autocorrelation_times, (low, high), params.split_rhat,
        params.max_steps,
    )  # fmt: skip


def friction_nodes(params: CalibrateTable) -> list[float]:
    """Friction coefficients that are solved: frictionless, those of the table, no slip."""
    return [0.0, *sorted(float(mu) for mu in params.friction_nodes), np.inf]


def poisson_nodes(params: CalibrateTable, nu: float) -> list[float]:
    """Poisson's ratios that are solved: the one that it is held at, or three over the prior where it is free.

    Fewer where the prior goes beyond what can be solved: no two are alike.
    """
    if params.priors.nu.free is False:
        return [held_nu(params, nu)]
    prior = prior_of("nu", params.priors.nu)
    values = prior.value(prior.quantile(np.array([0.01, 0.5, 0.99])))
    return np.unique(np.minimum(values, LARGEST_NU)).tolist()


def served(readings: Readings, params: CalibrateTable) -> np.ndarray:
    """Force components that serve, (n, 3) N: sideways ones of sheared presses only where asked for, else nan."""
    observed = readings.force.copy()
    if not params.shear:
        observed[:, :2] = np.nan
    else:
        observed[~readings.sheared, :2] = np.nan
    return observed


def models_of(readings: Readings, params: CalibrateTable) -> list[Model]:
    """The chosen model, then those that are compared with it; too few readings for the chosen one raise BadInput."""
    observed = served(readings, params)
    indenters = np.unique(readings.indenters).tolist()
    # without sideways forces that serve, nothing shows how the bench yields sideways
    held = () if np.isfinite(observed[:, :2]).any() else ("shear_compliance",)
    chosen = make_model(params, params.law, held, indenters)
    check_enough(int(np.isfinite(observed).sum()), chosen)
    compared = compared_models(params, indenters, held) if params.compare else []
    return [chosen, *(model for model in compared if model.name != chosen.name)]


def score_model(posterior: Posterior, chain: Chain, rules: Rules) -> scores.Score:
    """Leave-one-out score; from a chain of its own where importance sampling would lean on few draws."""
    score = scores.loo(posterior.pointwise(chain.flat(summary.DRAWS)))
    if score.reliable:
        return score
    mixture = LeaveOneOut(posterior.emulator, posterior.model, posterior.depth, posterior.observed, posterior.tail)
    return scores.loo_from_mixture(posterior.pointwise(sample(mixture, rules).flat(4 * summary.DRAWS)))


def compare_one(posterior: Posterior, chain: Chain | None, rules: Rules) -> tuple[Posterior, Chain, scores.Score]:
    """Sample (where that is not done yet) and score one model."""
    chain = chain or sample(posterior, rules)
    return posterior, chain, score_model(posterior, chain, rules)


def compare(tasks: list, jobs: int) -> list:
    """Run compare_one over tasks on `jobs` processes."""
    return list(progress(in_slots(compare_one, tasks, jobs), "models compared", len(tasks)))


def calibrate(
    readings: Readings, emulator, params: CalibrateTable, nu: float, chain_path=None, say=None, jobs=1
) -> Calibration:
    """Sample the chosen model, then all compared ones on the same readings."""
    params = with_nu(params, nu)
    rules, observed = sampling_rules(params), served(readings, params)

    def posterior_of(model: Model) -> Posterior:
        return Posterior(emulator, model, readings.depth, observed, params.tail)

    first, *others = models_of(readings, params)
    headline = posterior_of(first)
    chain = sample(headline, rules, chain_path, say)
    refuse_beyond(headline, chain)
    tasks: list[tuple[Posterior, Chain | None, Rules]] = [(headline, chain, rules)]
    tasks += [(posterior_of(model), None, rules) for model in others]
    return Calibration(readings, headline, chain, compare(tasks, jobs))


def refuse_beyond(posterior: Posterior, chain: Chain) -> None:
    """Refuse a posterior that presses deeper than the emulator was solved."""
    values = posterior.model.values(chain.flat(1000))
    depth = posterior.emulator.forces(posterior.depth, values)[2]
    beyond = float((depth > posterior.emulator.top).mean())
    if beyond > 0.02:
        raise BadInput(
            f"{100 * beyond:.0f} % of the posterior presses deeper than the emulator's solves go; raise [calibrate] "
            "reach_mm or narrow the prior of the touch offset"
        )


def summarise(done: Calibration, params: CalibrateTable, usual: float = REFERENCE_C10) -> dict:
    """Everything that summary.json holds but the solves and the plots. usual: C10 of such gels, MPa."""
    posterior, chain = done.posterior, done.chain
    parameters = summary.parameter_table(chain, posterior.model)
    correlation = summary.correlations(chain, posterior.model)
    mean, scale = summary.predictions(chain, posterior)
    models = summary.score_models(done.compared)
    for name, row in parameters.items():
        prior = getattr(params.priors, "indenter" if name.startswith("scale of ") else name)
        row["reason"] = prior.reason or ""
    repeated = summary.predictive_error(mean, posterior.observed)
    own = summary.predictive_error(summary.own_forces(chain, posterior), posterior.observed)
    # Several indenters have scales of their own, and shear a mean over components: there it says little.
    plain = len(posterior.model.indenters) < 2 and not done.readings.sheared.any()
    least = least_error(posterior).error if plain else None
    said = summary.sentences(parameters, correlation, models, posterior.model.name)
    said.append(summary.predictive_sentence(repeated, own, least))
    said[1:1] = summary.units_sentence(parameters["c10"]["median"], usual)
    return {
        "bench": summary.bench(parameters, posterior.model.fixed),
        "used": done.readings.ids.tolist(),
        "c10": summary.describe(posterior.model.values(chain.flat())["c10"]),
        "unit": "MPa",
        "model": posterior.model.name,
        "parameters": parameters,
        "correlations": correlation,
        "diagnostics": {"model": posterior.model.name, **asdict(chain.figures)},
        "models": models,
        "presses": len(done.readings),
        "readings": int(np.isfinite(posterior.observed).sum()),
        "predictive_mae_n": repeated,
        "own_touch_mae_n": own,
        "least_mae_n": least,
        "outliers": summary.find_outliers(done.readings, mean, scale, posterior.observed, params.outlier_scales),
        "sentences": said,
        "sentence": said[0],
        "comparison": " ".join(said[1:]),
    }


def draw_bands(done: Calibration) -> list:
    """Predictive bands of the normal force for the deepest press of each of MOST_BANDS indenters; see plots.predictive_plot."""
    readings, posterior = done.readings, done.posterior
    rng = np.random.default_rng(0)
    coordinates = done.chain.flat(600)
    values = posterior.model.values(coordinates)
    bands = []
    for name in np.unique(readings.indenters)[:MOST_BANDS]:
        members = np.flatnonzero(readings.indenters == name)
        deepest = members[np.argmax(readings.depth[members])]
        grid = np.linspace(0.0, readings.depth[deepest], 60)
        one = posterior.emulator.take(np.full(len(grid), deepest))
        forces, slopes, _ = one.forces(grid, values)
        scale = posterior.scale(slopes, values)[:, :, 2]
        fresh = -forces[:, :, 2] + scale * rng.standard_t(posterior.tail, scale.shape)
        same = members[
            np.abs(readings.pose[members][:, [0, 1, 6]] - readings.pose[deepest, [0, 1, 6]]).max(axis=1) < 0.01
        ]
        quantiles = np.quantile(fresh, [0.025, 0.16, 0.5, 0.84, 0.975], axis=0)
        bands.append((str(name), grid, quantiles, readings.depth[same], -readings.force[same, 2]))
    return bands


def draw_plots(done: Calibration, folder: Path, chain_path) -> None:
    """Corner plot, predictive bands, trace and autocorrelation, as PNG in `folder`."""
    posterior, chain = done.posterior, done.chain
    mean, scale = summary.predictions(chain, posterior)
    plots.corner_plot(folder / "corner.png", chain, posterior.model)
    with np.load(chain_path, allow_pickle=False) as file:
        plots.trace_plot(folder / "trace.png", file["coordinates"], chain.figures.burn, posterior.model)
    plots.autocorrelation_plot(folder / "autocorrelation.png", chain, posterior.model)
    plots.predictive_plot(
        folder / "predictive.png", draw_bands(done), posterior.observed, mean, scale, done.readings.ids,
    )  # fmt: skip


def say_figures(figures) -> None:
    """One line on how far a chain has come."""
    print(
        f"chain: {figures.steps} steps, {figures.taus:.0f} autocorrelation times kept, acceptance "
        f"{figures.acceptance:.2f}, split R-hat {figures.rhat:.4f}",
        file=sys.stderr, flush=True,
    )  # fmt: skip


def hex_settings(table: CalibrateSolverTable):
    """Settings of the solver behind the emulator, from [calibrate.solver]."""
    from gelforge.mechanics.hexsettings import HexSettings

    return HexSettings(**vars(table))


def emulate(readings: Readings, catalogue: dict, params: CalibrateTable, nu: float, folder: Path, jobs: int) -> tuple:
    """Readings that could be solved, their emulator, and the solves it took.

    Counts: total, per interface law, fine, new, in_vain (SolveCache.spent), and the list `unsolved` of presses
    left out with the reason. More than half of them unsolved raises BadInput.
    """
    from gelforge.calibration.solves import SolveCache, build_emulator, make_plan, refine, solve_all
    from gelforge.mechanics.hexsettings import quality
    from gelforge.stages import fea

    cache = SolveCache(folder, catalogue, hex_settings(params.solver), fea.VERSION)
    mus, nus = friction_nodes(params), poisson_nodes(params, nu)
    plan = make_plan(readings, params.reach_mm, params.shear_depths)
    failed = solve_all(plan, cache, mus, nus, jobs)
    unsolved = [{"sample_id": str(readings.ids[i]), "reason": reason} for i, reason in failed.items()]
    if len(failed) > len(readings) / 2:
        raise BadInput(
            f"{len(failed)} of {len(readings)} presses could not be solved, the first: {unsolved[0]['reason']}; "
            "raise press_steps or change size in [calibrate.solver]"
        )
    if failed:
        readings = readings.take(np.setdiff1d(np.arange(len(readings)), list(failed)))
        plan = make_plan(readings, params.reach_mm, params.shear_depths)  # of solves that are there already
    emulator = build_emulator(plan, cache, mus, nus)
    spent = cache.spent
    if params.refine != "none":
        fine = SolveCache(folder, catalogue, quality(params.refine), fea.VERSION)
        # with the most slip of the higher friction coefficients, and without slip
        emulator = refine(emulator, plan, cache, fine, mus[1:][-2:], nus[len(nus) // 2], jobs)
        more = {key: spent[key] + fine.spent[key] for key in ("total", "new", "in_vain")}
        spent = {**spent, **more, "fine": fine.spent["total"]}
    return readings, emulator, {**spent, "unsolved": unsolved}


def say_spent(spent: dict) -> str:
    """One line on the solves behind a result."""
    text = f"{spent['total']} finite element solves, {spent['new']} of them new"
    if spent["in_vain"]:
        text += f"; {spent['in_vain']} more new ones for presses left out"
    return text + "."


def load_rejected(poses: Path, shards: list[str]) -> set:
    """Lines of the log that stage 10 rejected for anything but their image, which does not matter here."""
    tables = [path for name in shards if (path := poses / f"{name}.rejected.csv").exists()]
    return {row for path in tables for row in rejected_rows(path, but="image")}


def gels_of(sensors: dict[str, Sensor], of: DatasetFile) -> dict[str, str]:
    """Names of the gels by sensor; that of rows which name no sensor stands under ""."""
    gels = {name: sensor.gel for name, sensor in sensors.items()}
    return gels | ({"": gels[of.sensor]} if of.sensor in gels else {})


def own_cores() -> int:
    """Cores that this process has for solves: what Slurm gave it, or two of this computer."""
    return int(os.environ.get("SLURM_CPUS_PER_TASK", min(2, os.cpu_count() or 1)))


@command(
    option("--data", type=Path, help="data/DATASET, with log.csv and dataset.toml"),
    option("--workflow", type=Path, default=Path("workflow")),
    option("--poses", type=Path, help="results/DATASET/10_poses; rows rejected there are not used", default=None),
    option("--shards", type=Path, help="results/DATASET/00_plan/shards, with --poses", default=None),
    option("--sensors", type=Path, help="parameters of the sensors, .json, with the gel of each"),
    option("--params", type=Path, help="stage parameters, .json, with tables calibrate and material"),
    option("--work", type=Path, help="folder for chain and plots"),
    option("--solves", type=Path, help="folder of cached solves; WORK/solves by default", default=None),
    option("--jobs", type=positive, default=own_cores(), help="solves at a time"),
    option("--out", type=Path, help="summary.json"),
)
def main(args: Namespace) -> None:
    use_gels_of(args.workflow)
    from gelforge.geometry.indenters import build_all

    if (args.poses is None) != (args.shards is None):
        raise BadInput(
            "--poses and --shards go together: the plan names the tables of --poses that are of today's log"
        )
    tables = read_parameters(args.params, ForCalibrate)
    params, nu = tables.calibrate, float(tables.material.nu)

    rejected = load_rejected(args.poses, planned_shards(args.shards)) if args.poses else set()
    of = read_dataset_file(args.data / "dataset.toml")
    logged = read_readings(args.data / "log.csv", rejected, gels_of(load_sensors(args.sensors), of))
    check_readings(logged)
    readings = logged.take(choose_presses(logged, params.max_presses))
    models_of(readings, with_nu(params, nu))  # refuses too few readings before anything is solved
    known, named = read_indenter_tables(args.workflow, args.data, of.catalogue), set(readings.indenters.tolist())
    kept = surfaces_beside(args.params)
    catalogue = build_all(known, args.workflow / of.catalogue, sorted(named), args.workflow, kept)
    solves = args.solves or args.work / "solves"
    readings, emulator, spent = emulate(readings, catalogue, params, nu, solves, args.jobs)
    done = calibrate(readings, emulator, params, nu, args.work / "chain.npz", say_figures, args.jobs)
    draw_plots(done, args.work, args.work / "chain.npz")
    own = of.params.get("material", {}).get("c10")
    usual = own if isinstance(own, int | float) else REFERENCE_C10
    result = summarise(done, params, usual)
    result["solves_spent"] = spent
    result["presses_logged"] = len(logged)
    write_json(args.out, result)
    notes = summary.units_sentence(result["c10"]["median"], usual)
    said = [f"note: {line}" if line in notes else line for line in result["sentences"]]
    print("\n".join([*said, say_spent(spent)]))
    for row in spent["unsolved"]:
        print(f"left out: {row['sample_id']}: {row['reason']}")
    for row in result["outliers"]:
        print(f"outlier: {row}")


if __name__ == "__main__":
    main.exit()
