"""Stage 90: one page that shows presses, solves, labels, networks and failures."""

import json
import subprocess
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.flow.calibration import FROZEN, calibrated, read_values
from gelforge.flow.cli import stage
from gelforge.flow.files import listed, read_csv, read_json, write_text
from gelforge.flow.layout import PARETO, STAGES, TABLES, Layout
from gelforge.flow.params import read_parameters
from gelforge.flow.runs import COST, costs_of, installed, last_runs, stages
from gelforge.flow.tables import ENOUGH_PRESSES, SHIPPED
from gelforge.geometry.gel import load_gel
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.ccx.program import ccx_program
from gelforge.records.forcefile import ERRORS, ForceFile
from gelforge.records.log import read_poses
from gelforge.records.predictionfile import read_predictions
from gelforge.records.press import PosedPress
from gelforge.records.samplefile import read_samples
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import Solved, read_solves
from gelforge.records.status import VALID, Status
from gelforge.reporting import feats_tables, networkchoice
from gelforge.reporting.explorer import Explorer
from gelforge.reporting.forcesensor import (
    CAUSES,
    COMPARED,
    common_sentences,
    compare_forces,
    expected_rows,
    force_rows,
    force_sentences,
    spreads,
)
from gelforge.reporting.page import Explored, Section, render
from gelforge.reporting.parts import PART, forget_parts, in_parts, place_parts
from gelforge.reporting.presses import as_columns, press_rows

VERSION = 8
ABSENT = "not installed"
NO_MODEL = "none"  # of a page of a dataset without images
FOLDED = ("plots.trace.png",)  # plots shown folded, for readers who check a result
PACKAGES = (
    "gelforge", "numpy", "scipy", "torch", "pymeshlab", "pyvista", "emcee", "opencv-contrib-python-headless",
)  # fmt: skip


def read_tables(results: Layout, path_of: Callable[[str], Path]) -> list[dict]:
    """Rows of the existing tables of the planned shards, each with its `shard`."""
    paths = {name: path_of(name) for name in results.names()}
    return [{**row, "shard": name} for name, path in paths.items() if path.exists() for row in read_csv(path)]


def read_presses(results: Path) -> list[tuple[str, PosedPress]]:
    """Presses in the existing pose tables of the planned shards, each with its shard."""
    of = Layout(results)
    paths = {name: of.poses(name) for name in of.names()}
    return [(name, press) for name, path in paths.items() if path.exists() for press in read_poses(path)]


def read_solved(results: Path) -> dict[str, Solved]:
    """Solves in the existing tables of the planned shards, by sample_id, with what they cost by the store of solves.

    If a shard's file of forces exists, status, total and stated errors are those of that file, scaled to the material.
    """
    of = Layout(results)
    store, found = SolveStore(of.solves), dict[str, Solved]()
    for name in of.names():
        solves = read_solves(of.fea(name)) if of.fea(name).exists() else []
        solves = [replace(solve, evidence=solve.evidence | store.cost(solve.key)) for solve in solves]
        found |= {solve.sample_id: solve for solve in with_forces(solves, of.forces(name))}
    return found


def with_forces(solves: list[Solved], path: Path) -> list[Solved]:
    """Solves with status, total and errors from a shard's file of forces; unchanged if that is missing."""
    if not path.exists():
        return solves
    with ForceFile(path) as shard:
        ids, status = shard.sample_id.tolist(), shard.status.tolist()
        total, moment = shard.total.tolist(), shard.moment.tolist()
        errors = {name: shard.numbers[name].tolist() for name in ERRORS}
    known = {
        name: (status[at], total[at], moment[at], {key: of[at] for key, of in errors.items()})
        for at, name in enumerate(ids)
    }
    return [_with_force(solve, *known[solve.sample_id]) if solve.sample_id in known else solve for solve in solves]


def _with_force(
    solve: Solved, status: str, total: list[float], moment: list[float], errors: dict[str, float]
) -> Solved:
    if not solve.status.valid:
        return solve
    lost = "" if status in VALID else Status[status].value
    (x, y, z), (mx, my, mz) = total, moment
    evidence, reason = {**solve.evidence, **errors}, lost or solve.reason
    return replace(
        solve, status=Status[status], reason=reason, total=(x, y, z), moment=(mx, my, mz), evidence=evidence
    )


def calibration_section(results: Path) -> Section:
    """Posterior of C10 and of the bench."""
    section = Section("Calibration")
    path = Layout(results).calibration()
    if not path.exists():
        command = Layout(results).command("calibrate")
        return section.text(f"Not made: {command} (needs force readings in the log).", absent=True)
    summary = read_json(path)
    if "failed" in summary:
        return section.text(f"No posterior: {summary['failed']}", absent=True)
    parameters = {"c10": {"label": "C10 (MPa)", **summary["c10"]}, **summary["parameters"]}
    rows = [[v.get("label", name), v["median"], *v["interval68"], *v["interval95"]] for name, v in parameters.items()]
    section.table(["parameter", "median", "68 % from", "to", "95 % from", "to"], rows)
    for sentence in summary["sentences"]:
        section.text(sentence)
    for press in summary.get("outliers", []):
        section.text(
            f"Outlier: {press['sample_id']} (row {press['row']}), f{press['component']} {press['measured_n']:.3g} N "
            f"read, {press['predicted_n']:.3g} N predicted, {press['scales_away']:+.1f} deviations; it has a "
            "low weight in the fit."
        )
    for press in summary.get("solves_spent", {}).get("unsolved", []):
        section.text(f"Left out: {press['sample_id']}: {press['reason']}")
    plots = Layout(results).plots()
    return add_pictures(section, path.parent, read_json(plots) if plots.exists() else {})


def force_section(results: Path, rows: list[dict], doubts: Sequence[str] = ()) -> tuple[Section, list[str]]:
    """Labels against the force sensor's readings, press by press, and what presses share that labels do not follow.

    doubts: what stage 60 says about the readings.
    """
    of, section = Layout(results), Section("Labels against the force sensor")
    none = "The log has no force readings of presses that were labelled."
    if not any(row.get("measured_fz") for row in rows):  # as where labels came with the dataset
        return section.text(none, absent=True), []
    read, path = read_parameters(of.parameters("forces")), of.calibration()
    found = read_values(of.base / read.calibration) if read.calibration else None
    source = of.data / FROZEN if (of.data / FROZEN).exists() else path
    summary = read_json(path) if path.exists() else {}
    material = calibrated(read, of.base).material
    spread = spreads(material, summary, read_parameters(of.parameters("calibrate")).calibrate, found is not None)
    presses = compare_forces(rows, spread, set(found.presses) if found else set())
    if not presses:
        return section.text(none, absent=True), []
    common = (
        []
        if found or "c10" not in summary
        else common_sentences(rows, presses, summary, assumed(of, float(material.c10)))
    )
    if found is None:
        section.text("Labels follow no calibration: they have the stiffness and the paths of params.toml.")
    else:
        section.text(
            f"Labels follow {source.relative_to(of.base)}: {found.name} ({found.law}), found from {len(found.presses)} presses."
        )
    for sentence in [*common, *doubts, *force_sentences(presses)]:
        section.text(sentence)
    section.table(CAUSES, expected_rows(presses, rows, spread), folded="Why readings and labels differ as a rule")
    return section.table(COMPARED, force_rows(presses), folded="Every press"), [*common, *doubts]


def assumed(of: Layout, c10: float) -> dict[str, float]:
    """Values of labels that follow no calibration, by the names of a posterior's parameters."""
    poses, law = (read_parameters(of.parameters(stage)) for stage in ("poses", "fea"))
    tilt = dict(zip(("tilt_x", "tilt_y"), poses.poses.tilt_deg, strict=True))
    return {
        "c10": c10, "offset": poses.poses.touch_offset_mm, "compliance": poses.poses.compliance_mm_per_n,
        "mu": law.interface.mu, "tare_z": 0.0, **tilt,
    }  # fmt: skip


def add_pictures(section: Section, folder: Path, captions: dict[str, str]) -> Section:
    """Add plots of a folder, given as file to caption, in this order; missing ones are left out."""
    for name, caption in captions.items():
        if (folder / name).exists():
            section.picture((folder / name).read_bytes(), caption, folded=name in FOLDED)
    return section


def failures_section(results: Path, solved: dict[str, Solved]) -> Section:
    """Presses without a label, or labelled by another method than requested, with the reasons."""
    section = Section("Failures")
    rejected = read_tables(Layout(results), Layout(results).rejected)
    failed = [solve for solve in solved.values() if not solve.status.valid]
    replaced = [solve for solve in solved.values() if solve.status.valid and solve.reason]
    path = Layout(results).images()
    images = read_json(path) if path.exists() else {"left_out": {}, "notes": []}
    if not rejected and not failed and not replaced and not any(images[kind] for kind in ("left_out", "notes")):
        return section.text("None: every row of the log became a label.")
    if rejected:
        columns = ["sample_id", "row", "column", "value", "reason", "hint"]
        section.text("Rows of the log that were rejected.").table(
            columns, [[r[c] for c in columns] for r in rejected]
        )
    if images["left_out"]:
        section.text("Presses left out of the dataset because their images do not match them.").table(
            ["sample_id", "reason"], [list(each) for each in images["left_out"].items()]
        )
    for note in images["notes"]:
        section.text(note)
    if replaced:
        section.text("Labels by another method than requested.").table(
            ["sample_id", "method", "reason"], [[s.sample_id, s.method, s.reason] for s in replaced]
        )
    if failed:
        columns = ["sample_id", "status", "reason", "method"]
        section.text("Solves that failed.").table(
            columns, [[s.sample_id, s.status.name, s.reason, s.method] for s in failed]
        )
    return section


def fidelities_section(solved: dict[str, Solved]) -> Section:
    """Seconds of a solve, by method."""
    by_method: dict[str, list[float]] = {}
    for solve in solved.values():
        seconds = solve.number("seconds")
        if seconds > 0:
            by_method.setdefault(solve.method, []).append(seconds)
    rows = [[name, len(s), float(np.median(s)), float(np.max(s))] for name, s in sorted(by_method.items())]
    return Section("Cost of a solve").table(["method", "solves", "median seconds", "slowest"], rows)


def branch_section(results: Path, title: str, folder: str, what: str, shipped: Path) -> Section:
    """Charts of a branch from its folder, or the one that gelforge ships if there are none."""
    section = Section(title)
    charts = {png: png.stem.replace("_", " ") for png in listed(results / folder, "*.png", below=True)}
    if not charts and shipped.exists():
        charts = {shipped: "Presses whose force is known, as gelforge ships it: processor time against error."}
    if not charts:
        return section.text(f"Not made: {Layout(results).command(folder)}.", absent=True)
    section.text(what)
    for png, caption in charts.items():
        section.picture(png.read_bytes(), caption)
    return section


def network_section(results: Path, resolution: str, model: str) -> Section:
    """Errors of the trained network, and its learning curve."""
    section = Section("Network")
    if model == NO_MODEL:
        return section.text("No images in the log, so no network: the flow ends at labels.", absent=True)
    path = Layout(results).evaluation(resolution, model)
    if not path.exists():
        return section.text(f"Not made: {Layout(results).command('evaluate')}.", absent=True)
    metrics, other = read_json(path), Layout(results).evaluation(resolution, SHIPPED)
    if "failed" in metrics:
        return section.text(f"Not evaluated: {metrics['failed']}", absent=True)
    section.text(learnt_from(metrics, model))
    if model != SHIPPED and other.exists():
        shipped = read_json(other)
        if "failed" in shipped:
            section.text(f"The shipped network is not beside it: {shipped['failed']}")
            shipped = {"splits": {}}
        for sentence in networkchoice.choices(metrics, shipped, model):
            section.text(sentence)
        if rows := networkchoice.beside(metrics, shipped):
            section.table(networkchoice.COLUMNS, rows)
    ours = published_here(path, other)
    for table in [*metrics["tables"], *([feats_tables.comparison(ours)] if ours else [])]:
        section.table(table["columns"], table["rows"], folded=table["title"])
    curve, picture = Layout(results).curve(resolution, model), path.with_suffix(".png")
    learning = {curve.name: "Loss, learning rate and validation error while it learnt."}
    predicted = {picture.name: "Predicted against labelled total force, and f_z of some presses."}
    return add_pictures(add_pictures(section, curve.parent, learning), picture.parent, predicted)


def published_here(*evaluations: Path) -> dict[str, dict]:
    """Errors on FEATS' published test sets by network, of the evaluations that exist and are of these sets."""
    found = {path.stem: read_json(path).get("published") for path in evaluations if path.exists()}
    return {name: errors for name, errors in found.items() if errors}


def learnt_from(metrics: dict, model: str) -> str:
    """What the network was trained on, and how to judge it."""
    who = "The shipped network" if model == SHIPPED else f"{model[0].upper()}{model[1:]}"
    images = " and ".join(f"{count} images of dataset {name}" for name, count in metrics["lessons"].items())
    these = "this one among them" if metrics["knows"] else "none of them from this one"
    own = (
        f" A network of this dataset's own pays from about {ENOUGH_PRESSES} presses on (make train evaluate"
        f" MODEL=pair_24_mirrored); from a few dozen on, MODEL=tuned fine-tunes the shipped one."
    )
    return (
        f"{who} learnt from {images}, {these}. A useful network must clearly beat the baselines below, which"
        f" see only the mean colours of an image.{own if model == SHIPPED else ''}"
    )


def calculix_version() -> str:
    """Version that the CalculiX of the solves prints."""
    program = ccx_program()
    if program is None:
        return ABSENT
    said = subprocess.run([program, "-v"], check=False, capture_output=True, text=True).stdout.split()
    return said[-1] if said else "unknown"


def versions_section(results: Path) -> Section:
    """Versions of programs, and parameters."""
    section, found = Section("Versions and parameters"), installed(PACKAGES)
    rows = [*([name, found.get(name, ABSENT)] for name in PACKAGES), ["CalculiX", calculix_version()]]
    section.table(["program", "version"], rows, folded="programs")
    for path in map(Layout(results).parameters, sorted((*STAGES, *TABLES))):
        if path.exists():
            section.code(json.dumps(read_json(path), indent=1), f"parameters of {path.stem}")
    return section


def about(results: Path, dataset: str, resolution: str, model: str, params: Path) -> dict:
    """Data that the page's charts and provenance need beside the presses."""
    path = Layout(results).evaluation(resolution, model)
    splits = read_json(path).get("splits", {}) if path.exists() else {}
    return {
        "dataset": dataset,
        "resolution": resolution,
        "model": model,
        "learnt_here": model != SHIPPED,
        "grid": list(Grid.parse(resolution).shape),
        "force_edges": list(read_parameters(params / "evaluate.json").evaluate.force_edges),
        "controls": {name: {"n": split["n"], "controls": split["controls"]} for name, split in splits.items()},
    }


def open_explorer(
    results: Path, resolution: str, model: str, solved: dict[str, Solved], gels: dict[str, str]
) -> Explorer:
    """The table of presses with the network's predictions. gels: their names by sensor."""
    path = Layout(results).evaluation(resolution, model).with_suffix(".predictions.npz")
    predictions = read_predictions(path) if path.exists() else None
    wrenches = {}
    if predictions:
        values = np.concatenate([predictions["total"], predictions["moment"]], axis=1)
        wrenches = dict(zip(predictions["sample_id"].tolist(), values.tolist(), strict=True))
    table = Layout(results).dataset(resolution) / "samples.csv"
    samples = {each.press.sample_id: each for each in (read_samples(table) if table.exists() else [])}
    rejected = read_tables(Layout(results), Layout(results).rejected)
    rows = press_rows(read_presses(results), rejected, solved, samples, wrenches, gels)
    order = {name: at for at, name in enumerate(samples)}
    gel = load_gel(min(gels.values()))
    return Explorer(results, resolution, rows, order, gel, predictions)


def explorer_data(explorer: Explorer, known: dict) -> dict:
    """All data of the page's explorer except the parts."""
    costs = costs_of(last_runs(explorer.results))
    return {
        "columns": as_columns(explorer.rows),
        "shared": explorer.shared(),
        "costs": {target: [cost[name] for name in COST] for target, cost in costs.items()},
        "stages": stages(explorer.results, costs),
        "about": known,
    }


def sections_of(explorer: Explorer, model: str, solved: dict[str, Solved]) -> tuple[list[Section], list[str]]:
    """Sections of the page below the explorer, and what the readings of many presses say against their labels."""
    results, resolution = explorer.results, explorer.resolution
    table = Layout(results).dataset_table(resolution)
    doubts = [] if model == NO_MODEL else read_json(table).get("doubts_of_forces", [])
    forces, common = force_section(results, explorer.rows, doubts)
    sections = [
        network_section(results, resolution, model),
        forces,
        calibration_section(results),
        branch_section(
            results,
            "Speed against accuracy",
            PARETO,
            "Seconds of a solve against its error.",
            Layout(results).workflow.parent / "results/readme/exact.png",
        ),
        failures_section(results, solved),
        fidelities_section(solved),
        versions_section(results),
    ]
    return sections, common


def lead_of(rows: list[dict], resolution: str, samples: int, common: Sequence[str]) -> str:
    """How many presses were labelled, and what most of them say against their labels.

    samples: size of the dataset, whose labels may be imported. common: sentences, the most important first.
    """
    labelled = sum(row["status"] in VALID for row in rows)
    if samples and not labelled:
        return f"{samples} pictures with labels that came with the dataset, at {resolution} cells a picture; no press was solved here."
    said = f"{labelled} of {len(rows)} presses labelled by finite elements at {resolution} cells a picture."
    return " ".join([said, *common[:1]])


@stage(Layout.report)
def main(args: Namespace) -> None:
    of, results, resolution, model = args.of, args.results, args.resolution, args.model
    solved = read_solved(results)
    gels = {name: sensor.gel for name, sensor in load_sensors(of.parameters("sensors")).items()}
    explorer = open_explorer(results, resolution, model, solved, gels)
    known = about(results, of.data.name, resolution, model, of.params)
    limit = read_parameters(of.parameters("report")).report.embed_mb * 1e6
    folder, embedded = place_parts(
        args.out.parent, in_parts(tqdm(explorer.presses(), "presses", len(explorer.rows))), limit
    )
    data = explorer_data(explorer, known) | {"parts": {"size": PART, "beside": folder}}
    sections, common = sections_of(explorer, model, solved)
    lead = lead_of(explorer.rows, resolution, len(explorer.samples), common)
    explored = Explored(data, embedded) if explorer.rows else None
    write_text(args.out, render(of.data.name, lead, sections, explored))
    forget_parts(args.out.parent, folder)


if __name__ == "__main__":
    main.exit()
