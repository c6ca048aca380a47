"""Stage 30: speed and error against FEATS' deck, errors over all scenes, validity, force balance.

All costly results are kept below --work, so that a stopped run resumes and parts can run one by one: first
`--only deck`, with whose times `--only scenes` compares. Times are processor times of one thread, so that other work
on the machine does not affect the ratios.
"""

import hashlib
import shutil
from argparse import Namespace
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.flow import params as config
from gelforge.flow.cli import command, option
from gelforge.flow.files import canonical, read_json, write_json
from gelforge.flow.params import StageParameters
from gelforge.flow.schema import altered, plain
from gelforge.flow.tables import FeaTable
from gelforge.geometry.gel import USUAL_GEL, Gel, load_gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import assemble
from gelforge.labelling.sensor import Sensor, load_sensors
from gelforge.mechanics.ccx.program import need_ccx, run_ccx
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solve import Solvers, settings_of
from gelforge.records.press import Press
from gelforge.records.status import VALID
from gelforge.stages import pareto as branch
from gelforge.sweeps.deviation import errors
from gelforge.sweeps.isolate import Clock, isolated, peak_mib
from gelforge.sweeps.keptreferences import elements_doubled
from gelforge.sweeps.methods import LARGE_REFERENCE, REFERENCE, Method, method_of, prepare
from gelforge.sweeps.scenes import NamedScene, parse_scene, read_tables
from gelforge.sweeps.trial import (
    ChartBench,
    kept,
    load_bench,
    measure,
    solve_isolated,
)
from tests.benchmarks.parts import fea_cost as cost
from tests.support.figures import PUBLISHED_DATA, Figure, publish_figures

# By depth of FEATS' deck: scene, and required speed-up of `ccx` and `label` over the deck.
SPEED = {1.0: ("sphere_1mm", 15.0, 100.0), 2.0: ("sphere_2mm", 30.0, 100.0)}
# Largest median and worst errors over the scenes in %, of total force and of cells.
GOALS = {"ccx": ((None, None), (3.8, 7.0)), "label": ((0.3, 1.5), (4.5, 8.0)), "draft": ((None, None), (None, None))}
METHODS = (*map(method_of, GOALS), LARGE_REFERENCE)
NATIVE = "FEATS' contact"  # name of `ccx-contact` in the figures
# Presses by CalculiX' own contact, hard and without friction: body and depth, mm; their place, mm
# and degrees; largest difference from `label` without friction in total force, %.
CHECKED = {
    "sphere_15": 0.8,
    "cuboid_10": 0.4,
    "cylinder_8": 0.5,
    "triangle_10": 0.6,
    "sphere_10": 0.5,
    "pyramid_10": 0.6,
}
CHECKED_AT, CHECKED_GOAL = (0.5, -1.0, 10.0), 2.0
HARD, HARD_MM = 1000.0, 0.7  # contact penalty, multiples of C10 per mm, and edges of its tetrahedra
ENVELOPE = 200
# Round, flat, sharp and sheared scenes.
FRAMED = ("sphere_1mm", "cuboid_round", "cuboid_shear", "pyramid", "punch", "cylinder")
Goals = tuple[float | None, float | None]
# %, largest difference from a reference of a solve with elements and load steps of twice the size
DOUBLED_GOALS = {"total": 0.3, "cells": 1.5}
PARTS = ("deck", "scenes", "native", "checked", "envelope", "cost")


# -- FEATS' own deck


def deck_folder(reference: Path, folder: Path, depth: float) -> str:
    """Write FEATS' deck into `folder` for one depth (mm); return the job's name."""
    source = reference / "feats" / "deck"
    if not (source / "sim.inp").exists():
        raise BadInput(f"{source}: FEATS' deck is not there; set GELFORGE_REFERENCE to the reference data's folder")
    shutil.copytree(source, folder / "template", dirs_exist_ok=True)
    shutil.copy(source / "materials.inp", folder)
    text = (source / "sim.inp").read_text()
    push = "NindenterFixed,3,,-2."
    if text.count(push) != 1:
        raise BadInput(f"{source}/sim.inp: the line {push} that sets its depth is not there once")
    (folder / "sim.inp").write_text(text.replace(push, f"NindenterFixed,3,,-{depth:g}"))
    return "sim"


def deck_force(text: str) -> float:
    """Normal force on the gel's base, N, from the totals of the deck's .dat."""
    totals = [lines for lines in text.split("total force")[1:] if "NGELSIGHT_MINIFIXED" in lines[:200].upper()]
    if not totals:
        raise BadInput("FEATS' deck printed no total force on the gel's base; look at its log")
    numbers = [line.split() for line in totals[-1].splitlines()[1:] if len(line.split()) == 3]
    return float(numbers[0][2])


def _deck(reference: Path, folder: Path, depth: float, limit_s: float) -> dict:
    name = deck_folder(reference, folder, depth)
    with Clock() as clock:
        job = run_ccx(name, folder, limit_s)
    if job.returncode:
        raise BadInput(f"FEATS' deck at {depth:g} mm: {job.reason()}")
    force = deck_force((folder / f"{name}.dat").read_text(errors="replace"))
    return {"status": "OK", "seconds": clock.seconds, "cpu_seconds": clock.cpu_seconds, "fz": force,
            "iterations": job.iterations, "peak_mib": peak_mib()}  # fmt: skip


def run_deck(reference: Path, work: Path, depth: float, limit_s: float = 36000.0) -> dict:
    """Seconds and force of FEATS' deck at one depth, stored or new."""
    path, key = work / f"deck-{depth:g}.json", hashlib.sha256(f"1 {depth}".encode()).hexdigest()
    record = kept(path, key, limit_s)
    if record is None:
        folder = work / f"deck-{depth:g}"
        folder.mkdir(parents=True, exist_ok=True)
        record = {"key": key, "depth": depth} | isolated(partial(_deck, reference, folder, depth, limit_s), limit_s)
        shutil.rmtree(folder, ignore_errors=True)
        if record["status"] != "OK":
            raise BadInput(f"FEATS' deck at {depth:g} mm did not finish: {record['reason']}")
        write_json(path, record)
        print(f"FEATS' deck at {depth:g} mm: {record}", flush=True)
    return record


def kept_decks(folder: Path) -> dict[float, dict]:
    """Stored records of FEATS' deck, by depth."""
    records = [read_json(path) for path in folder.glob("deck-*.json")]
    return {record["depth"]: record for record in records}


# -- the named scenes


def solve_scenes(bench: ChartBench, scenes: dict[str, NamedScene]) -> dict[str, dict]:
    """Records by scene and method, with errors against the reference under "errors"."""
    found = {}
    for name, scene in tqdm(scenes.items(), "scenes", len(scenes)):
        records = {method.name: measure(bench, scene, method) for method in METHODS}
        for record in records.values():
            record["errors"] = errors(record, records[REFERENCE])
        found[name] = records
    return found


def scene_figures(found: dict, decks: dict) -> list[Figure]:
    """Speed at the deck's depths, errors over all scenes, symmetry."""
    figures = []
    for depth, (name, *goals) in SPEED.items():
        for method, goal in zip(("ccx", "label"), goals, strict=True):
            record, deck = found[name][method], decks.get(depth)
            if deck:
                figures.append(_faster(f"{method} against FEATS' deck, {depth:g} mm", deck, record, goal))
    for method, goals in GOALS.items():
        figures += error_figures(f"{method}, 16 scenes", [records[method] for records in found.values()], *goals)
    return [*figures, *stated_figures(found), _symmetry(found), _balance(found), _engines(found)]


def error_figures(
    of: str, records: list[dict], total: Goals = (None, None), cells: Goals = (None, None)
) -> list[Figure]:
    """Number of scenes that a method fails on; its median time, and median and worst errors, %, over the others."""
    solved = [record for record in records if record["errors"]]
    failed = ", ".join(record.get("scene", "") for record in records if not record["errors"])
    compare = "" if of == NATIVE else "<="
    found = [Figure(f"{of}, without a result", len(records) - len(solved), compare, 0.0, "scenes", failed)]
    if not solved:
        return found
    seconds = float(np.median([record["cpu_seconds"] for record in solved]))
    found.append(Figure(f"{of}, median processor time", seconds, "", 0.0, "s"))
    for kind, label, goals in (("total", "total force", total), ("cells", "cells", cells)):
        errors_of = [100 * record["errors"][kind] for record in solved]
        worst = solved[int(np.argmax(errors_of))].get("scene", "")
        for what, value, goal, note in (
            ("median", float(np.median(errors_of)), goals[0], ""), ("worst", max(errors_of), goals[1], worst),
        ):  # fmt: skip
            name = f"{of}, {label}, {what}"
            found.append(Figure(name, value, "<=" if goal else "", goal or 0.0, "%", note))
    return found


def stated_figures(found: dict) -> list[Figure]:
    """For each method, the fraction of its solved scenes whose error is within the one that it states."""
    figures = []
    for method in GOALS:
        solved = [
            (one[method], np.linalg.norm(one[REFERENCE]["total"])) for one in found.values() if one[method]["errors"]
        ]
        for kind, key in (("total", "error_n"), ("cells", "cells_error_n")):
            share = [record["errors"][kind] * force <= record["evidence"][key] for record, force in solved]
            name = f"{method}, 16 scenes, {kind} within what is stated"
            figures.append(Figure(name, 100 * float(np.mean(share)), ">=", 90.0, "%"))
    return figures


def solve_native(bench: ChartBench, scenes: dict[str, NamedScene]) -> list[Figure]:
    """Errors of CalculiX' own contact with FEATS' penalty on meshes of FEATS' size, as [fea] has them."""
    records = []
    for scene in tqdm(scenes.values(), "native", len(scenes)):
        record = measure(bench, scene, method_of("ccx-contact"))
        records.append(
            record | {"errors": errors(record, measure(bench, scene, LARGE_REFERENCE)), "scene": scene.name}
        )
    return error_figures(NATIVE, records)


def solve_checked(params: StageParameters, sensor: Sensor, catalogue: dict, folder: Path) -> list[Figure]:
    """Differences of CalculiX' own contact from `label`, both without friction, for the presses CHECKED."""
    fea = altered(params.fea, method="ccx-contact", contact_stiffness=HARD, contact_mm=HARD_MM)
    records = []
    for name, depth in tqdm(CHECKED.items(), "checked", len(CHECKED)):
        x, y, turn = CHECKED_AT
        scene = Scene(
            load_gel(USUAL_GEL),
            Material(params.material.nu),
            catalogue[name],
            Press(x, y, 0, 0, 0, -depth, turn),
            Interface("frictionless"),
        ).direct
        path = folder / f"{name}.json"
        key = hashlib.sha256(canonical([params.version, depth, *CHECKED_AT, plain(fea)]).encode()).hexdigest()
        record = read_json(path) if path.exists() else {"key": ""}
        if record["key"] != key:
            record = {"key": key, "scene": name} | _checked(scene, fea, sensor, folder / "work")
            write_json(path, record)
        records.append(record)
    return error_figures("CalculiX' own contact, hard, without friction", records, (None, CHECKED_GOAL))


def _checked(scene: Scene, fea: FeaTable, sensor: Sensor, work: Path) -> dict:
    """Processor seconds of a solve by CalculiX' own contact, and its differences from `label`; None if it failed."""
    label = Solvers(work, fea).solve(scene, "label")
    with Clock() as clock:
        found = Solvers(work, fea).solve(scene, fea.method)
    evidence = found.evidence
    made = {"cpu_seconds": clock.cpu_seconds, "status": found.status.name, "iterations": evidence["newton_iterations"],
            "nodes": len(found.mesh.nodes), "penetration_mm": evidence["penetration_mm"],
            "failed": evidence["failed_attempts"], "errors": None}  # fmt: skip
    if found.status.valid and evidence["method"] == fea.method:
        one, other = ({"total": each.total, "cells": _cells(each, sensor)}
                      for each in (found, label))  # fmt: skip
        made["errors"] = errors(one, other)
    return made


def _cells(result: Result, sensor: Sensor) -> np.ndarray:
    """Force per cell (3, 24, 32) N of a solve."""
    mesh, nodes = result.mesh, result.mesh.surface_nodes
    return assemble(mesh, sensor, Grid(24, 32)).apply(np.array([0, len(nodes)]), nodes, result.forces[nodes])[0][0]


def _faster(what: str, deck: dict, record: dict, goal: float) -> Figure:
    """Processor time of FEATS' deck over that of a record."""
    note = (f"{deck['cpu_seconds']:.0f} s and {abs(deck['fz']):.3f} N against {record['cpu_seconds']:.1f} s and"
            f" {-record['total'][2]:.3f} N")  # fmt: skip
    return Figure(what, deck["cpu_seconds"] / record["cpu_seconds"], ">=", goal, "times faster", note)


def _symmetry(found: dict) -> Figure:
    """Largest sideways force of a sphere pressed straight at the centre."""
    sideways = {}
    for name in ("sphere_shallow", "sphere_1mm", "sphere_2mm"):
        for method, record in found[name].items():
            fx, fy, fz = record["total"]
            sideways[f"{name}, {method}"] = 100 * max(abs(fx), abs(fy)) / max(abs(fz), 1e-12)
    worst = max(sideways, key=sideways.get)
    return Figure("sphere at the centre, sideways force", sideways[worst], "<=", 0.1, "% of f_z", worst)


def _balance(found: dict) -> Figure:
    """Largest difference between base reaction and sum of contact forces over all valid results solved here."""
    gaps = {f"{name}, {method}": record["evidence"]["base_mismatch"] for name, records in found.items()
            for method, record in records.items() if record["status"] == "OK" and "evidence" in record}  # fmt: skip
    worst = max(gaps, key=gaps.get)
    return Figure("base reaction against contact sum", gaps[worst], "<=", 1e-6, "of the force", worst)


def _engines(found: dict) -> Figure:
    """Largest difference between CalculiX and the in-process solver on one mesh, over presses solved here by both."""
    differences = {f"{name}, {method}": record["evidence"]["engine_difference"] for name, records in found.items()
             for method, record in records.items() if "engine_difference" in record.get("evidence", {})}  # fmt: skip
    worst = max(differences, key=lambda name: differences[name], default="none was solved here")
    return Figure(
        "CalculiX against the in-process solver on one mesh",
        differences.get(worst, np.inf),
        "<=",
        1e-6,
        "of the force",
        worst,
    )


# -- the paper's envelope


def envelope_scene(number: int, catalogue: dict, gel: Gel) -> Scene:
    """Random scene `number` of the paper's envelope, which does not depend on other scenes."""
    rng = np.random.default_rng([8, number])
    bodies = [body for body in catalogue.values() if not body.spare]
    body = bodies[rng.integers(len(bodies))]
    x, y = rng.uniform(-3, 3), rng.uniform(-5, 5)
    depth = rng.uniform(0.1, 2.0)
    size, angle = rng.uniform(0, 0.4) * depth, rng.uniform(0, 2 * np.pi)
    press = Press(x, y, 0.0, size * np.cos(angle), size * np.sin(angle), -depth, float(rng.uniform(0, 360)))
    return Scene(gel, Material(), body, press, Interface())


def solve_envelope(bench: ChartBench, catalogue: dict, folder: Path, count: int, method: Method) -> list[dict]:
    """Records of the envelope's scenes by one method, stored one by one."""
    gel, limit = load_gel(USUAL_GEL), bench.params.pareto.limit_s
    key = hashlib.sha256(canonical(envelope_settings(bench.params, method)).encode()).hexdigest()
    records = []
    for number in tqdm(range(count), f"envelope, {method.name}"):
        path = folder / method.name / f"{number:03d}.json"
        record = kept(path, key, limit)
        if record is None:
            scene = envelope_scene(number, catalogue, gel)

            make = partial(prepare, method, scene, bench.params)
            found = solve_isolated(make, None, limit, folder)
            asked = {"number": number, "indenter": scene.indenter.name, "press": vars(scene.press)}
            record = {"key": key} | asked | found
            write_json(path, record)
        records.append(record)
    return records


def envelope_settings(params: StageParameters, method: Method) -> list:
    """What the records of a method depend on."""
    if method.solver == "hex":
        return [params.version, asdict(quality(method.name))]
    return [params.version, *settings_of("ccx", params.fea, load_gel(USUAL_GEL))]


def envelope_figures(found: dict[str, list[dict]]) -> list[Figure]:
    """Fraction of valid results and of failures with a reason, by method, and differences between both methods."""
    figures = [figure for engine, records in found.items() for figure in _valid_figures(engine, records)]
    both = [(h, c) for h, c in zip(found["label"], found["ccx"], strict=True)
            if h["status"] == c["status"] == "OK" and c["evidence"].get("method") == "ccx"]  # fmt: skip
    differences = {f"{h['number']} {h['indenter']}": 100 * _difference(h["total"], c["total"]) for h, c in both}
    near = [name for name in differences if differences[name] <= 2.0]
    worst = sorted(differences, key=differences.get, reverse=True)[:5]
    note = f"median {np.median(list(differences.values())):.2f} %; worst: " + ", ".join(
        f"{n} {differences[n]:.1f}" for n in worst
    )
    figures.append(Figure("random presses on which label and ccx agree to 2 %", 100 * len(near) / len(both), ">=", 95.0,
                          "%", note))  # fmt: skip
    slow = [r["cpu_seconds"] for r in found["label"] if r["status"] == "OK"]
    figures.append(Figure("slowest random press with label over the median", max(slow) / np.median(slow), "<=", 6.0,
                          "times", f"{max(slow):.1f} of {np.median(slow):.1f} s"))  # fmt: skip
    return figures


def _difference(one, other) -> float:
    return float(np.linalg.norm(np.subtract(one, other)) / max(np.linalg.norm(other), 1e-12))


def _valid_figures(engine: str, records: list[dict]) -> list[Figure]:
    valid = [r for r in records if r["status"] in VALID]
    own = [r for r in valid if r["evidence"].get("method", engine) == engine]
    mute = [r["number"] for r in records if r not in valid and not r["reason"]]
    seconds = np.median([r["cpu_seconds"] for r in valid]) if valid else np.nan
    note = ", ".join(f"{r['number']} {r['indenter']} {r['status']}" for r in records if r not in own)
    return [
        Figure(f"valid {engine} results in the paper's envelope", 100 * len(own) / len(records), ">=", 99.0, "%",
               f"{len(records)} random scenes, median {seconds:.1f} s{'; not: ' + note if note else ''}"),
        Figure(f"failures of {engine} without a reason", len(mute), "==", 0, "scenes"),
    ]  # fmt: skip


# -- cost of labels


def cost_figures(scenes: dict[str, Scene], sensor: Sensor) -> list[Figure]:
    """Cost in process of the frames of one press, growth with the number of unknowns, and throughput."""
    framed = {name: scene for name, scene in scenes.items() if name in FRAMED}
    return [
        *cost.frame_figures(framed, sensor),
        *cost.growth_figures(scenes["cuboid_round"]),
        *cost.throughput_figures(list(scenes.values())),
    ]


@command(
    option("--workflow", type=Path, default=Path("workflow")),
    option(
        "--pareto",
        type=Path,
        default=Path("results/feats_sphere15/pareto"),
        help="branch pareto's folder of a dataset that overrides no setting of [fea]: its records are used and added to",
    ),
    option(
        "--references",
        type=Path,
        default=Path("data/fea_challenge"),
        help="references that were solved before; those of scenes or settings that changed are solved anew, which takes hours",
    ),
    option("--work", type=Path, default=Path("results/benchmarks/fea"), help="what else is kept"),
    option("--reference", type=Path, default=PUBLISHED_DATA),
    option("--scenes", nargs="+", help="only these of workflow/scenes.toml", default=None),
    option("--envelope", type=int, default=ENVELOPE, help="random scenes"),
    option("--only", choices=PARTS, help="do one part; figures of the others stay as they are", default=None),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    need_ccx()
    params = config.parameters_of(config.load_params(args.workflow), "pareto", branch.VERSION)
    sensors = load_sensors(args.workflow / "sensors.toml")
    bench = load_bench(params, sensors, args.pareto / "scenes", args.references)
    tables = read_tables(args.workflow)
    scenes = {n: parse_scene(n, t, params.material.nu) for n, t in tables.items()
              if not args.scenes or n in args.scenes}  # fmt: skip
    parts = (args.only,) if args.only else PARTS
    figures: list[Figure] = []
    if "deck" in parts:
        for depth in SPEED:
            run_deck(args.reference, args.work, depth)
    if "scenes" in parts:
        figures += scene_figures(solve_scenes(bench, scenes), kept_decks(args.work))
        figures += reference_figures(elements_doubled(args.references))
    if "native" in parts:
        figures += solve_native(bench, scenes)
    if "checked" in parts:
        catalogue = load_catalogue(args.workflow / "indenters.toml")
        figures += solve_checked(params, sensors[params.pareto.sensor], catalogue, args.work / "checked")
    if "envelope" in parts:
        catalogue = load_catalogue(args.workflow / "indenters.toml")
        folder, engines = args.work / "envelope", (method_of("label"), method_of("ccx"))
        figures += envelope_figures(
            {m.name: solve_envelope(bench, catalogue, folder, args.envelope, m) for m in engines}
        )
    if "cost" in parts:
        sensor = sensors[params.pareto.sensor]
        figures += cost_figures({name: scene.scene for name, scene in scenes.items()}, sensor)
    publish_figures(args.out, figures)


def reference_figures(checks: dict) -> list[Figure]:
    """Differences of solves with elements and load steps of twice the size from the references: worst and median.

    checks: the stored differences by scene. The figures keep the name "halved", the key of stored results.
    """
    figures = []
    for kind, goal in DOUBLED_GOALS.items():
        moved = {name: 100 * check[kind] if check else np.inf for name, check in checks.items()}
        note = "; ".join(f"{name} {value:.2f}" for name, value in moved.items())
        figures.append(Figure(f"references, halved: {kind}, worst", max(moved.values()), "<=", goal, "%", note))
        figures.append(Figure(f"references, halved: {kind}, median", float(np.median([*moved.values()])), "", 0, "%"))
    return figures


if __name__ == "__main__":
    main.exit()
