"""Branch calibrate: posterior of the gel's C10 and of the rig's errors."""

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.calibration import summary
from gelforge.calibration.emulator import Emulator
from gelforge.calibration.parameters import TARE, BenchModel, label_of, make_model, prior_name
from gelforge.calibration.posterior import Posterior
from gelforge.calibration.readings import Readings, check_enough, check_readings, choose_presses, readings_of
from gelforge.calibration.sampling import Chain, Figures, NotConverged, Rules, sample
from gelforge.calibration.tilts import centre_fault, mountings_of, tilted_mountings
from gelforge.errors import BadInput, SolveFailed
from gelforge.evidence import forces as evidence
from gelforge.flow.cli import JOBS, stage
from gelforge.flow.files import publish, read_json, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import StageParameters, altered, read_parameters
from gelforge.flow.tables import CalibrateSolverTable, CalibrateTable
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.records.log import read_shard
from gelforge.stages.poses import Bodies, judge_rows

VERSION = 20
DRAWN, TRACED = 20000, 300  # draws of the corner plot, steps of the trace
MOST_BANDS = 6  # indenters in the plot of predictive bands, the first by name: more would hide each other


@dataclass(frozen=True)
class Calibration:
    """A finished calibration: the readings used, their posterior and its chain."""

    readings: Readings
    posterior: Posterior
    chain: Chain


def sampling_rules(params: CalibrateTable) -> Rules:
    """Rules from the table [calibrate]."""
    return Rules(params.autocorrelation_times, params.max_steps, params.seed)


def served(readings: Readings) -> np.ndarray:
    """Force components that calibration uses, (n, 3) N: tangential ones of sheared presses only, else nan."""
    observed = readings.force.copy()
    observed[~readings.sheared, :2] = np.nan
    return observed


def model_of(readings: Readings, params: CalibrateTable, law: str, tilted: Sequence[str] = ()) -> BenchModel:
    """The model of the readings under a contact law; too few readings raise BadInput.

    tilted: the mountings whose tilt is a parameter.
    """
    observed = served(readings)
    check_enough(int(np.isfinite(observed).sum()))
    sideways = bool(np.isfinite(observed[:, :2]).any())
    return make_model(params, law, np.unique(readings.indenters).tolist(), sideways, mountings_of(readings), tilted)


def calibrate(
    readings: Readings,
    emulator: Emulator,
    params: CalibrateTable,
    law: str,
    logged: Readings,
    usual: float,
    tilted: Sequence[str] = (),
) -> tuple[Calibration, list[str]]:
    """Sample the posterior under a contact law; return it with what the readings say about force sensor and log.

    logged: all readings. usual: C10 of such gels, MPa. tilted: the mountings whose tilt is a parameter. The chain's progress goes to the log. If it does not converge,
    NotConverged also says what the readings say, because that is the likelier cause.
    """

    def say(figures: Figures) -> None:
        print(
            f"{figures.steps} steps, {figures.taus:.0f} autocorrelation times kept, acceptance {figures.acceptance:.2f}, "
            f"R-hat {figures.rhat:.4f}",
            file=sys.stderr, flush=True,
        )  # fmt: skip

    model, centre = model_of(readings, params, law, tilted), readings.centre if tilted else None
    posterior = Posterior(emulator, model, readings.depth, served(readings), params.tail, centre)
    try:
        done = Calibration(readings, posterior, sample(posterior, sampling_rules(params), say))
    except NotConverged as error:
        seen = evidence_of(Calibration(readings, posterior, error.chain), logged, usual)
        raise NotConverged(" ".join([*seen, str(error)]), error.chain) from None
    return done, evidence_of(done, logged, usual)


def refuse_beyond(posterior: Posterior, chain: Chain, reach: float, seen: Sequence[str] = ()) -> None:
    """Refuse a posterior if over 2 % of its depths are beyond the solves and over `reach` mm below the commanded ones.

    The limit is `reach` for presses that slide, too, although they are solved only to a third of it (`make_plan`).
    Beyond that their forces continue along the last slopes. The ratio of sideways to normal force, from which friction
    is found, then hardly changes; the normal force of a ball, at the limit of a reach of 0.15 mm, is 2 % too small at
    a depth of 0.5 mm and 4 % at 0.3 mm.
    seen: what the readings say about sensor and log, which is then the likelier cause.
    """
    values = posterior.model.values(chain.flat(1000))
    depth = posterior.emulator.forces(posterior.depth, values)[2]
    beyond = float((depth > np.maximum(posterior.emulator.top, posterior.depth + reach)).mean())
    if beyond > 0.02:
        cause = " ".join(seen) or "raise [calibrate] reach_mm or narrow the prior of the touch offset"
        raise BadInput(
            f"{100 * beyond:.0f} % of the posterior's depths are beyond the emulator's solves and more than {reach:g} mm"
            f" below the commanded ones; {cause}"
        )


def summarise(done: Calibration, params: CalibrateTable, seen: list[str]) -> dict:
    """Contents of summary.json except the solves. seen: what the readings say about sensor and log."""
    posterior, chain = done.posterior, done.chain
    parameters = summary.parameter_table(chain, posterior.model)
    correlation = summary.correlations(chain, posterior.model)
    mean, scale = summary.predictions(chain, posterior)
    for name, row in parameters.items():
        row["reason"] = getattr(params.priors, prior_name(name)).reason or ""
    without, shape = summary.left_out(chain, posterior)
    error = summary.predictive_error(without, posterior.observed)
    said = summary.sentences(parameters, correlation, posterior.model)
    return {
        "bench": summary.bench(parameters, posterior.model),
        "used": done.readings.ids.tolist(),
        "c10": summary.describe(posterior.model.values(chain.flat())["c10"]),
        "unit": "MPa",
        "law": posterior.model.law,
        "parameters": parameters,
        "correlations": correlation,
        "diagnostics": asdict(chain.figures),
        "presses": len(done.readings),
        "readings": int(np.isfinite(posterior.observed).sum()),
        "left_out_mae_n": error,
        "outliers": summary.find_outliers(done.readings, mean, scale, posterior.observed, params.outlier_scales),
        "evidence": seen,
        "sentences": [said[0], *seen, *said[1:], summary.predictive_sentence(error, shape)],
    }


def usual_forces(posterior: Posterior, c10: float) -> np.ndarray:
    """Forces (n, 3) N on a gel of that C10 on a rigid bench, with friction at the median of its prior."""
    model = posterior.model
    nothing = {name: np.zeros(1) for name in (*model.fixed, *model.free)}
    mu = model.fixed["mu"] if "mu" in model.fixed else model.free["mu"].law.median()
    values = {**nothing, "c10": np.array([c10]), "mu": np.array([mu])}
    values["indenter"] = np.zeros((1, max(1, len(model.indenters))))
    values["touch"], values["tilt"] = np.zeros((1, len(model.mountings))), np.zeros((1, len(model.mountings), 2))
    return posterior.emulator.forces(posterior.depth, values)[0][0]


def evidence_of(done: Calibration, logged: Readings, usual: float) -> list[str]:
    """What the readings say about force sensor and log. logged: all readings. usual: C10 of such gels, MPa."""
    readings, posterior, chain = done.readings, done.posterior, done.chain
    parameters = summary.parameter_table(chain, posterior.model)
    mean, _ = summary.predictions(chain, posterior)
    # tangential forces of presses without shear are not used in the fit, but they show a constant offset
    constant = evidence.mean_forces((readings.force - mean)[~readings.sheared, :2])
    for name in [name for name in TARE if name in parameters]:
        low, high = parameters[name]["interval68"]
        constant[name[-1]] = parameters[name]["median"], (high - low) / 2
    noise = parameters.get("noise")
    fitted = evidence.Fitted(
        rows=np.flatnonzero(np.isin(logged.ids, readings.ids)),
        usual=-usual_forces(posterior, usual)[:, 2],
        residual=posterior.observed - mean,
        constant=constant,
        noise=noise["median"] if noise else 0.0,
        largest_noise=noise["prior_interval95"][1] if noise else 0.0,
    )
    log = evidence.LogForces(logged.pose[:, 3:5], logged.depth, logged.pose[:, 6], logged.force)
    return evidence.of_log(log, fitted)


def bands_of(done: Calibration) -> dict[str, np.ndarray]:
    """Predictive bands of normal force for the deepest press of MOST_BANDS indenters, as `cornerplots.predictive_plot` takes them."""
    readings, posterior = done.readings, done.posterior
    rng = np.random.default_rng(0)
    values = posterior.model.values(done.chain.flat(600))
    found: dict[str, np.ndarray] = {}
    for number, name in enumerate(np.unique(readings.indenters)[:MOST_BANDS]):
        members = np.flatnonzero(readings.indenters == name)
        deepest = members[np.argmax(readings.depth[members])]
        grid = np.linspace(0.0, readings.depth[deepest], 60)
        one = posterior.emulator.take(np.full(len(grid), deepest))
        forces, slopes, _ = one.forces(grid, values)
        scale = posterior.scale(forces, slopes, values)[:, :, 2]
        fresh = -forces[:, :, 2] + scale * rng.standard_t(posterior.tail, scale.shape)
        same = members[
            np.abs(readings.pose[members][:, [0, 1, 6]] - readings.pose[deepest, [0, 1, 6]]).max(axis=1) < 0.01
        ]
        quantiles = np.quantile(fresh, [0.025, 0.16, 0.5, 0.84, 0.975], axis=0)
        measured = np.stack([readings.depth[same], -readings.force[same, 2]])
        found |= {f"band{number}": np.vstack([grid, quantiles]), f"measured{number}": measured}
    return found | {"bands": np.unique(readings.indenters)[:MOST_BANDS]}


def draws_of(done: Calibration) -> dict[str, Any]:
    """What stage `plots` draws of a posterior: parameters of draws and of the thinned chain, and predictions of the readings."""
    posterior, chain = done.posterior, done.chain
    mean, scale = summary.predictions(chain, posterior)
    steps = np.arange(0, len(chain.coordinates), max(1, len(chain.coordinates) // TRACED))
    names, shown = posterior.model.names, chain.coordinates[steps]

    def values(coordinates: np.ndarray) -> np.ndarray:
        of = posterior.model.values(coordinates)
        return np.stack([of[name] for name in names], axis=1).astype(np.float32)

    return {
        "labels": np.array([label_of(name) for name in names]), "draws": values(chain.flat(DRAWN)), "steps": steps,
        "trace": values(shown.reshape(-1, shown.shape[-1])).reshape(*shown.shape[:2], -1),
        "burn": np.array(chain.figures.burn), "observed": posterior.observed, "mean": mean, "scale": scale,
        "ids": done.readings.ids.astype(str), **bands_of(done),
    }  # fmt: skip


def solver_settings(table: CalibrateSolverTable):
    """Settings of the solver behind the emulator, from [calibrate.solver]."""
    from gelforge.mechanics.hexsettings import HexSettings

    return HexSettings(**vars(table), press_mm=table.press_mm)


def emulate(
    readings: Readings,
    catalogue: dict,
    params: CalibrateTable,
    law: str,
    nu: float,
    folder: Path,
    jobs: int,
    tilted: Sequence[str] = (),
) -> tuple:
    """Readings whose presses could be solved, their emulator, and the counts of solves.

    tilted: the mountings whose tilt is a parameter. Counts: total, per interface law, fine, new, in_vain
    (SolveCache.spent), and the list `unsolved` of presses left out, with the reason. BadInput is raised if more than half of the presses could not be solved.
    """
    from gelforge.calibration.solves import SolveCache, build_emulator, make_plan, refine, solve_all, with_tilts
    from gelforge.mechanics.hexsettings import quality
    from gelforge.stages import fea

    def planned(readings: Readings):
        return make_plan(readings, params.reach_mm, law, params.friction_nodes, nu)

    cache = SolveCache(folder, catalogue, solver_settings(params.solver), fea.VERSION)
    failed = solve_all(planned(readings), cache, jobs)
    unsolved = [{"sample_id": str(readings.ids[i]), "reason": reason} for i, reason in failed.items()]
    if len(failed) > len(readings) / 2:
        raise BadInput(
            f"{len(failed)} of {len(readings)} presses could not be solved, the first: {unsolved[0]['reason']}; "
            "raise press_steps or change size in [calibrate.solver]"
        )
    readings = readings.take(np.setdiff1d(np.arange(len(readings)), list(failed)))
    plan = planned(readings)  # its solves exist already
    emulator = build_emulator(plan, cache)
    spent, fine = cache.spent, cache
    if params.refine != "none":
        fine = SolveCache(folder, catalogue, quality(params.refine), fea.VERSION)
        emulator = refine(emulator, plan, cache, fine, jobs)
    if tilted:
        emulator = with_tilts(emulator, plan, catalogue, tilted, fine, jobs)
    if fine is not cache:
        more = {key: spent[key] + fine.spent[key] for key in ("total", "new", "in_vain")}
        spent = {**spent, **more, "fine": fine.spent["total"]}
    return readings, emulator, {**spent, "unsolved": unsolved}


def by_tilt(done: Calibration) -> dict[str, float]:
    """Change of force per square degree of tilt, relative, of the indenters whose presses were solved at tilts."""
    tilts, names = done.posterior.emulator.tilts, done.readings.indenters
    if tilts is None:
        return {}
    return {str(name): float(np.abs(tilts.force[names == name]).max()) for name in np.unique(names)}


def say_spent(spent: dict) -> str:
    """One line on the solves behind a result."""
    text = f"{spent['total']} finite element solves, {spent['new']} of them new"
    if spent["in_vain"]:
        text += f"; {spent['in_vain']} more new ones for presses left out"
    return text + "."


def logged_readings(of: Layout, read: StageParameters, bodies: Bodies) -> Readings:
    """Readings of the log's rows that stage 10 would take without a calibration, by their commanded paths.

    A row is judged as stage 10 judges it, but for its image and what a calibration may move. Readings that no force
    sensor and press can have produced raise BadInput.
    """
    log, sensors = str(of.log), read_json(of.parameters("sensors"))
    rows = [row for shard in of.names() for row in read_shard(of.shard(shard))]
    rows.sort(key=lambda row: row.row)
    nothing = dict.fromkeys(("touch_offset_mm", "compliance_mm_per_n", "shear_compliance_mm_per_n"), 0.0)
    checks = altered(read.poses, **nothing, mounting_touch_offset_mm={}, images=False)
    tables = {"sensors": sensors, "indenters": bodies.catalogue}
    _, rejected = judge_rows(rows, log, of.data, tables, checks, bodies)
    gels = {name: sensor.gel for name, sensor in load_sensors(of.parameters("sensors")).items()}
    # a whole log with inverted signs is refused by that name, so rows that pull are taken out afterwards
    bad = {one.row for one in rejected if one.column != "fz_n"}
    if rejected and not {row.row for row in rows if row.cells.get("fz_n")} - bad:
        raise BadInput(f"{log}: every row with a normal force (fz_n) is rejected, the first: {rejected[0].text}")
    readings = readings_of(rows, log, bad, gels, read.poses.tilt_deg, read.poses.mounting_tilt_deg)
    check_readings(readings)
    pulling = {one.row for one in rejected} - bad
    return readings.take(~np.isin(readings.rows, sorted(pulling)))


def calibrated_log(of: Layout, read: StageParameters, folder: Path, jobs: int) -> tuple[dict, list[str]]:
    """Contents of summary.json for a dataset, and what to print besides; what plots show goes to `folder`.

    Raises GelforgeError if the log's readings give no posterior.
    """
    params, law, nu = read.calibrate, read.interface.law, float(read.material.nu)
    bodies = Bodies(read_json(of.parameters("indenters")), of.workflow, of.surfaces)
    logged = logged_readings(of, read, bodies)
    catalogue = {name: bodies[name] for name in sorted(set(logged.indenters.tolist()))}
    readings = logged.take(choose_presses(logged, params.max_presses, law, catalogue))
    model_of(readings, params, law)  # refuses too few readings before anything is solved
    tilted, lacking = tilted_mountings(readings, catalogue)
    if fault := centre_fault(readings) if tilted else "":
        tilted, lacking = (), [*lacking, fault]
    readings, emulator, spent = emulate(readings, catalogue, params, law, nu, of.solves, jobs, tilted)
    usual = REFERENCE_C10 if isinstance(read.material.c10, str) else float(read.material.c10)
    done, seen = calibrate(readings, emulator, params, law, logged, usual, tilted)
    seen += lacking
    refuse_beyond(done.posterior, done.chain, params.reach_mm, seen)
    with publish(folder / "summary.draws.npz") as part:
        np.savez_compressed(part, **draws_of(done))
    result = summarise(done, params, seen)
    stated = {name: list(tilt) for name, tilt in read.poses.mounting_tilt_deg.items()}
    result["bench"] |= {"stated_tilt_deg": stated, "by_tilt": by_tilt(done)}
    result["solves_spent"] = spent
    result["presses_logged"] = len(logged)
    said = [f"note: {line}" if line in seen else line for line in result["sentences"]]
    said += [say_spent(spent), *(f"left out: {row['sample_id']}: {row['reason']}" for row in spent["unsolved"])]
    return result, [*said, *(f"outlier: {row}" for row in result["outliers"])]


@stage(Layout.calibration, JOBS)
def main(args: Namespace) -> None:
    of = args.of
    read = read_parameters(of.parameters("calibrate"))
    try:
        result, said = calibrated_log(of, read, args.out.parent, args.jobs)
    except (BadInput, SolveFailed, NotConverged) as error:
        # what the log does not tell is a result: the report shows it, and nothing runs again until something changes
        result, said = {"failed": str(error)}, [f"note: no calibration: {error}"]
    write_json(args.out, result)
    print("\n".join(said))


if __name__ == "__main__":
    main.exit()
