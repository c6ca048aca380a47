"""Stage 90: one page that shows what was pressed, solved, labelled, learnt, and what failed."""

import importlib.metadata
import json
import subprocess
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.flow.files import read_csv, read_json, write_text
from gelforge.flow.main import command, option
from gelforge.reporting import pictures
from gelforge.reporting.page import Section, render
from gelforge.stages.plan import planned_shards

VERSION = 1
PACKAGES = ("numpy", "scipy", "torch", "pymeshlab", "pytetwild", "pyvista", "emcee", "opencv-contrib-python-headless")


def read_tables(results: Path, stage: str, suffix: str = "") -> list[dict]:
    """Rows of a stage's tables of the planned shards, each with its `shard`; a stage may not have made all of them."""
    paths = {name: results / stage / f"{name}{suffix}.csv" for name in planned_shards(results / "00_plan" / "shards")}
    return [{**row, "shard": name} for name, path in paths.items() if path.exists() for row in read_csv(path)]


def numbers(rows: list[dict], *columns: str) -> dict[str, np.ndarray]:
    """Columns as arrays under their short names, NaN where a cell is empty."""
    return {c.split("_")[0]: np.array([float(row[c] or "nan") for row in rows]) for c in columns}


def presses_section(poses: list[dict]) -> Section:
    """What the bench did."""
    table = numbers(poses, "x0_mm", "y0_mm", "dx_mm", "dy_mm", "dz_mm", "fz_n")
    names = [row["indenter"] for row in poses]
    sensors = sorted({row["sensor_id"] for row in poses})
    section = Section("Presses")
    section.text(f"{len(poses)} good presses of {len(set(names))} indenters on sensors {', '.join(sensors)}.")
    return section.picture(pictures.presses(table, names), "Positions, forces and shear travel in the raw log.")


def pick(poses: list[dict], solved: dict[str, dict], count: int) -> list[dict]:
    """Solved samples for the gallery: evenly over the force range, each indenter before any comes twice."""
    usable = [row for row in poses if solved.get(row["sample_id"], {}).get("status") == "OK"]
    usable.sort(key=lambda row: float(row["dz_mm"]))
    seen: set[str] = set()
    first = [row for row in usable if not (row["indenter"] in seen or seen.add(row["indenter"]))]
    rest = [row for row in usable if row not in first]
    return (first + rest)[:count]


def press_section(results: Path, row: dict, shard: str) -> Section:
    """One press in three dimensions."""
    from gelforge.mechanics.family import load_mesh
    from gelforge.records.forcefile import ForceFile

    with ForceFile(results / "40_forces" / f"{shard}.npz") as forces:
        at = forces.index(row["sample_id"])
        mesh = load_mesh(results / "20_meshes", str(forces.mesh[at]))
        sample = forces.sample(at, mesh.surface_nodes)
    travel = [float(row[c]) for c in ("dx_mm", "dy_mm", "dz_mm")]
    png = pictures.press_3d(
        mesh, sample.nodes, sample.displacement, sample.force, results / "10_poses" / row["stl"], travel
    )
    total = ", ".join(f"{v:.2f}" for v in sample.force.sum(axis=0))
    caption = f"{row['sample_id']}: {row['indenter']}, {-travel[2]:.2f} mm deep; forces on the gel (red) sum to ({total}) N."
    return Section("One press").picture(png, caption)


def labels_section(results: Path, data: Path, rows: list[dict], shards: dict[str, str], resolution: str) -> Section:
    """Images beside their labels."""
    import cv2

    section = Section("Labels")
    section.text(f"Force per cell at {resolution}, channels and signs as in FEATS; compression is negative z.")
    for row in rows:
        with np.load(
            results / "50_labels" / resolution / f"{shards[row['sample_id']]}.npz", allow_pickle=False
        ) as file:
            label = file["label"][list(file["sample_id"]).index(row["sample_id"])]
        image = cv2.cvtColor(cv2.imread(str(data / row["image"])), cv2.COLOR_BGR2RGB)
        title = f"{row['sample_id']} {row['indenter']} {row['dz_mm']} mm"
        section.picture(pictures.label_over_image(image, label, title), title)
    return section


def flatten(value, prefix: str = "") -> list[tuple[str, float]]:
    """Leaves of nested dicts of numbers as (dotted name, number)."""
    if isinstance(value, dict):
        return [leaf for key, inner in value.items() for leaf in flatten(inner, f"{prefix}{key}.")]
    return [(prefix.rstrip("."), value)] if isinstance(value, (int, float, str)) else []


def compared_models(models: list[dict]) -> tuple[list[str], list[list]]:
    """Columns and rows of the table of calibration models, best predicting first; errors are of normal force."""
    columns = [
        "model", "behind", "plus-minus", "ruled out", "C10 (MPa)", "95 % from", "to", "repeated (N)", "these (N)",
    ]  # fmt: skip
    rows = [
        [
            m["model"].replace("+", " + ").replace("_", " "), m["behind"] + 0.0, m["behind_standard_error"],
            "no" if m["indistinguishable"] else "yes", m["c10"]["median"], *m["c10"]["interval95"],
            m["predictive_mae_n"]["fz"], m.get("own_touch_mae_n", {}).get("fz"),
        ]
        for m in models
    ]  # fmt: skip
    return columns, rows


def calibration_section(results: Path) -> Section:
    """Posterior of the material."""
    section = Section("Calibration")
    path = results / "calibrate" / "summary.json"
    if not path.exists():
        return section.text("Not made: make calibrate (needs force readings in the log).", absent=True)
    summary = read_json(path)
    parameters = {"c10": {"label": "C10 (MPa)", **summary["c10"]}, **summary.get("parameters", {})}
    rows = [[v.get("label", name), v["median"], *v["interval68"], *v["interval95"]] for name, v in parameters.items()]
    section.table(["parameter", "median", "68 % from", "to", "95 % from", "to"], rows)
    for sentence in summary.get("sentences", [summary.get("sentence", "")]):
        section.text(sentence)
    if summary.get("models"):
        section.table(*compared_models(summary["models"])).text(
            "Models by their predictive score (expected log density of a reading left out): how far behind the best, "
            "with its standard error. Last, the mean error of normal force when the presses are repeated, and at "
            "these presses, each with its own error of touch."
        )
    for press in summary.get("outliers", []):
        section.text(
            f"Outlier: {press['sample_id']} (row {press['row']}), f{press['component']} {press['measured_n']:.3g} N "
            f"read, {press['predicted_n']:.3g} N predicted, {press['scales_away']:+.1f} deviations; it serves with a "
            "low weight."
        )
    for press in summary.get("solves_spent", {}).get("unsolved", []):
        section.text(f"Left out: {press['sample_id']}: {press['reason']}")
    captions = {
        "predictive.png": "Readings beside what the posterior predicts of them.",
        "corner.png": "Posterior of every parameter, and of every two.",
        "autocorrelation.png": "Autocorrelation of the chain.",
        "trace.png": "Walkers of the chain.",
    }
    return add_pictures(section, results / "calibrate", captions)


def add_pictures(section: Section, folder: Path, captions: dict[str, str]) -> Section:
    """Pictures of a folder, file to caption, in this order; those that were not made are left out."""
    for name, caption in captions.items():
        if (folder / name).exists():
            section.picture((folder / name).read_bytes(), caption)
    return section


def failures_section(results: Path, solved: dict[str, dict]) -> Section:
    """Everything that did not become a label, with its reason."""
    section = Section("Failures")
    rejected = read_tables(results, "10_poses", ".rejected")
    failed = [row for row in solved.values() if row["status"] not in ("OK", "NO_CONTACT")]
    if not rejected and not failed:
        return section.text("None: every row of the log became a label.")
    if rejected:
        columns = ["sample_id", "row", "column", "value", "reason", "remedy"]
        section.text("Rows of the log that were rejected.").table(
            columns, [[r[c] for c in columns] for r in rejected]
        )
    if failed:
        columns = ["sample_id", "status", "reason", "fidelity"]
        section.text("Solves that failed.").table(columns, [[r[c] for c in columns] for r in failed])
    return section


def cost_section(results: Path, solved: dict[str, dict]) -> Section:
    """What each stage cost."""
    section = Section("Cost")
    rows = []
    for folder in sorted(p for p in (results / "metrics").glob("*") if p.is_dir()):
        costs = [read_json(p) for p in folder.rglob("*.json")]
        rows.append([folder.name, len(costs), sum(c["seconds"] for c in costs), max(c["peak_mib"] for c in costs)])
    section.table(["stage", "targets", "seconds, all targets", "largest memory, MiB"], rows)
    by_fidelity: dict[str, list[float]] = {}
    for row in solved.values():
        if row.get("seconds"):
            by_fidelity.setdefault(row["fidelity"], []).append(float(row["seconds"]))
    rows = [[name, len(s), float(np.median(s)), float(np.max(s))] for name, s in sorted(by_fidelity.items())]
    return section.table(["fidelity", "solves", "median seconds", "slowest"], rows)


def branch_section(results: Path, title: str, folder: str, what: str) -> Section:
    """Charts of a branch as they lie in its folder."""
    section = Section(title)
    charts = sorted((results / folder).rglob("*.png"))
    if not charts:
        return section.text(f"Not made: make {folder}.", absent=True)
    section.text(what)
    for png in charts:
        section.picture(png.read_bytes(), png.stem.replace("_", " "))
    return section


def network_section(results: Path, resolution: str, model: str) -> Section:
    """Errors of the trained network, and how it learnt."""
    section = Section("Network")
    path = results / "80_evaluate" / resolution / f"{model}.json"
    if not path.exists():
        return section.text("Not made: make evaluate.", absent=True)
    metrics = read_json(path)
    samples = read_csv(results / "60_dataset" / resolution / "samples.csv")
    learnt = sum(row["split"] == "train" for row in samples)
    section.text(
        f"{model} learnt from {learnt} of {len(samples)} images. Judge it by the controls below: what they reach"
        " without looking at the picture of a press, a network must beat by far."
    )
    for title, columns, rows in evaluation_tables(metrics):
        section.text(title).table(columns, rows)
    captions = {
        f"70_train/{resolution}/{model}.curve.png": "Loss, learning rate and validation error while it learnt.",
        f"80_evaluate/{resolution}/{model}.png": "Predicted against labelled total force, and f_z of some presses.",
    }
    return add_pictures(section, results, captions)


def evaluation_tables(metrics: dict) -> list[tuple[str, list[str], list[list]]]:
    """Tables of an evaluation file; whatever form it has, its numbers are shown under their names."""
    if "tables" in metrics:
        return [(t["title"], t["columns"], t["rows"]) for t in metrics["tables"]]
    return [("Every figure of the evaluation.", ["figure", "value"], [list(leaf) for leaf in flatten(metrics)])]


def versions_section(results: Path) -> Section:
    """What made this: programs and parameters."""
    section = Section("Versions and parameters")
    rows = [["gelforge", importlib.metadata.version("gelforge")]]
    rows += [[name, importlib.metadata.version(name)] for name in PACKAGES]
    try:
        said = subprocess.run(["ccx", "-v"], capture_output=True, text=True).stdout.split()
        rows.append(["CalculiX", said[-1] if said else "unknown"])
    except FileNotFoundError:
        rows.append(["CalculiX", "not installed"])
    section.table(["program", "version"], rows)
    for path in sorted((results / "00_plan" / "params").glob("*.json")):
        section.code(json.dumps(read_json(path), indent=1), f"parameters of {path.stem}")
    return section


def build(data: Path, results: Path, resolution: str, model: str, gallery: int) -> str:
    """The whole page as text."""
    poses = read_tables(results, "10_poses")
    shards = {row["sample_id"]: row["shard"] for row in poses}
    solved = {row["sample_id"]: row for row in read_tables(results, "30_fea")}
    rows = pick(poses, solved, gallery)
    valid = sum(row["status"] in ("OK", "NO_CONTACT") for row in solved.values())
    lead = f"{valid} of {len(shards)} good presses labelled at {resolution}; forces by finite elements, all steps cached."
    sections = [presses_section(poses)]
    if rows:
        deepest = min(rows, key=lambda row: float(row["dz_mm"]))
        sections += [
            press_section(results, deepest, shards[deepest["sample_id"]]),
            labels_section(results, data, rows, shards, resolution),
        ]
    sections += [
        network_section(results, resolution, model),
        calibration_section(results),
        branch_section(
            results,
            "Speed against accuracy",
            "pareto",
            "Seconds of a solve against its error, each point one fidelity and mesh.",
        ),
        failures_section(results, solved),
        cost_section(results, solved),
        versions_section(results),
    ]
    return render(data.name, lead, sections)


@command(
    option("--data", type=Path, help="data/DATASET"),
    option("--results", type=Path, help="results/DATASET"),
    option("--resolution"),
    option("--model"),
    option("--params", type=Path),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    gallery = read_json(args.params)["report"]["gallery"]
    write_text(args.out, build(args.data, args.results, args.resolution, args.model, gallery))


if __name__ == "__main__":
    main.exit()
