"""Branch pareto: seconds of a solve against its error, for every fidelity, mesh density and load-step count.

`mesh` makes one of its meshes, `scene` solves one scene by every method, `chart` draws.
"""

from argparse import Namespace
from dataclasses import asdict, replace
from pathlib import Path
from statistics import median

from gelforge.errors import BadInput
from gelforge.flow.files import publish, read_json, write_csv, write_if_changed, write_json
from gelforge.flow.layout import beside
from gelforge.flow.main import command, group, option
from gelforge.flow.params import CHARTED, load_params, parameters_of, plain
from gelforge.flow.params.stages import ForPareto, ForParetoMeshes, read_parameters
from gelforge.flow.params.tables import CHOOSING, CLASSES, IN_PROCESS, VERIFYING, FeaTable
from gelforge.flow.progress import progress
from gelforge.geometry.gel import load_gel
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.solvers.contactclass import contact_class
from gelforge.stages.meshes import publish_mesh
from gelforge.sweeps.deviation import errors, frontier
from gelforge.sweeps.methods import HALVED, REFERENCE, TURNED, Method, every_method, quick_methods
from gelforge.sweeps.references import build_mesh, turns
from gelforge.sweeps.scenes import NamedScene, parse_scene
from gelforge.sweeps.symmetry import images_of
from gelforge.sweeps.trial import ChartBench, given_reference, load_bench, measure

# Also of its meshes: what was solved on others is solved anew.
VERSION = 3
GOAL_TOTAL, GOAL_CELLS = 0.02, 0.08  # what a label setting should meet over all scenes
# By what names the chart has the ways among which fidelity "auto" chooses. Hexahedra of quality "label" stand under the first
# of theirs where [fea] hex_quality is another one, which has the second name then.
CHARTED_AS = {
    "hex-draft": ("hex-draft-quality",),
    "hex-label": ("hex-label-quality", "hex-label"),
    "ccx": ("ccx-label",),
}
COLUMNS = ("method", "fidelity", "size_mm", "load_steps", "scenes", "failed", "cpu_seconds_median",
           "cpu_seconds_worst",
           "total_median", "total_worst", "total_worst_scene", "cells_median", "cells_worst", "cells_worst_scene",
           "frontier_total", "frontier_cells")  # fmt: skip


def checks_of(scene: NamedScene, params: ForPareto) -> list[Method]:
    """Further solves of a scene's reference: on halved elements where asked, half a turn about z where it has no image."""
    halved = [Method(HALVED, REFERENCE, halved=True)] * (scene.name in params.pareto.halved)
    alone = turns(params, scene.fine) and not images_of(scene.scene)
    return [*halved, *[Method(TURNED, REFERENCE)] * alone]


def solve_scene(bench: ChartBench, scene: NamedScene, methods: list[Method], checks: list[Method]) -> dict:
    """Every method on one scene, the last of `methods` being the reference; records by method with their errors.

    checks: other solves of the reference (checks_of).
    """
    reference = methods[-1].name
    methods = [*methods, *checks]
    records = {m.name: measure(bench, scene, m) for m in progress(methods, scene.name)}
    halved = HALVED in records
    compared: dict[str, dict] = {}
    for method in methods:
        record = records[method.name] | {"method": asdict(method)}
        against = HALVED if method.name == reference and halved else reference
        compared[method.name] = record | {"errors": errors(record, records[against])}
    found: dict = {"scene": scene.name, "class": contact_class(scene.scene), "table": scene.table}
    found |= {"reference": reference, "methods": compared}
    if halved:
        found["reference_check"] = errors(records[reference], records[HALVED])
    return found


def summarise(scenes: list[dict]) -> list[dict]:
    """One row per method over all scenes: cost, errors, failures and whether it lies on a frontier.

    A method that failed on a scene is on none and takes no other off it: its worst error leaves out the scene that was too
    much for it.
    """
    names = dict.fromkeys(name for scene in scenes for name in scene["methods"])
    reference = {scene["reference"] for scene in scenes} | {HALVED, TURNED}
    rows = [_row(name, scenes) for name in names if name not in reference]
    for kind in ("total", "cells"):
        usable = [row for row in rows if row[f"{kind}_worst"] is not None and not row["failed"]]
        best = frontier([(row["cpu_seconds_median"], row[f"{kind}_worst"]) for row in usable])
        for row in rows:
            row[f"frontier_{kind}"] = False
        for row, good in zip(usable, best, strict=True):
            row[f"frontier_{kind}"] = good
    return rows


def _row(name: str, scenes: list[dict]) -> dict:
    records = {scene["scene"]: scene["methods"][name] for scene in scenes if name in scene["methods"]}
    method = next(iter(records.values()))["method"]
    good = {scene: record for scene, record in records.items() if record["errors"]}
    row = {"method": name, "fidelity": method["fidelity"], "size_mm": method["size"], "load_steps": method["steps"],
           "scenes": len(records), "failed": len(records) - len(good)}  # fmt: skip
    seconds = [record["cpu_seconds"] for record in good.values()]
    row |= {"cpu_seconds_median": _median(seconds), "cpu_seconds_worst": max(seconds, default=None)}
    for kind in ("total", "cells"):
        found = {scene: record["errors"][kind] for scene, record in good.items()}
        worst = max(found, key=lambda scene: found[scene], default=None)
        row |= {f"{kind}_median": _median(list(found.values())), f"{kind}_worst": found.get(worst),
                f"{kind}_worst_scene": worst}  # fmt: skip
    return row


def _median(values: list[float]) -> float | None:
    return median(values) if values else None


def failures(scenes: list[dict]) -> list[dict]:
    """Every solve that gave no result, with its reason."""
    return [{"scene": scene["scene"], "method": name, "status": record["status"], "reason": record["reason"]}
            for scene in scenes for name, record in scene["methods"].items()
            if record.get("cells") is None]  # fmt: skip


def ways_of(methods: dict[str, dict]) -> dict[str, dict]:
    """A scene's records of the ways among which "auto" chooses, as far as they are charted."""
    names = {way: next((name for name in of if name in methods), None) for way, of in CHARTED_AS.items()}
    return {way: methods[name] for way, name in names.items() if name is not None}


def charted(scenes: list[dict]) -> dict[str, dict[str, list[float]]]:
    """What workflow/charted.toml should say: by class of contact and way, worst errors in total force and cells, and cost.

    Cost is the median of processor seconds over that of hex-label on all scenes. Empty where a way was not charted.
    """
    ways = [(scene["class"], ways_of(scene["methods"])) for scene in scenes if scene.get("class")]
    found = [(kind, of) for kind, of in ways if of.keys() == CHARTED_AS.keys()]
    if not found or any(not record["errors"] for _, of in found for record in of.values()):
        return {}
    base = median([of["hex-label"]["cpu_seconds"] for _, of in found])
    classes = {kind for kind, _ in found}
    return {
        kind: {way: _class_row([of[way] for held, of in found if held == kind], base) for way in CHARTED_AS}
        for kind in CLASSES
        if kind in classes
    }


def charted_text(found: dict[str, dict[str, list[float]]], old: str) -> str:
    """workflow/charted.toml with these numbers under the comment that it begins with."""
    comment = "".join(line for line in old.splitlines(keepends=True) if line.startswith("#"))
    tables = [
        "".join([f"[{kind}]\n", *(f"{way} = {row}\n" for way, row in of.items())]) for kind, of in found.items()
    ]
    return "\n".join([comment, *tables])


def solving(table: FeaTable) -> dict[str, object]:
    """What of [fea] changes a solve, whichever method is chosen."""
    idle = CHOOSING | VERIFYING | {"fidelity", "timeout_s"}
    return {key: value for key, value in plain(table).items() if key not in idle}


def keep_charted(found: dict[str, dict[str, list[float]]], params: ForPareto, workflow: Path) -> str:
    """Write benchmarked errors to workflow/charted.toml; a sentence that says so, or why not.

    Only of a dataset that solves with the project's own parameters: "auto" of all datasets chooses by them.
    """
    path = workflow / CHARTED
    usual = parameters_of(load_params(workflow), ForPareto, params.version)
    if not found:
        return f"{path} stays as it is: not every method of auto was solved on every scene."
    if replace(usual, fea=params.fea) != params or solving(usual.fea) != solving(params.fea):
        return f"{path} stays as it is: this dataset sets parameters of its own."
    changed = write_if_changed(path, charted_text(found, path.read_text(encoding="utf-8") if path.exists() else ""))
    return f"{path} {'has the errors of this chart now' if changed else 'says the same'}."


def _class_row(records: list[dict], base: float) -> list[float]:
    worst = [max(record["errors"][kind] for record in records) for kind in ("total", "cells")]
    return [*(round(value, 4) for value in worst), round(median([r["cpu_seconds"] for r in records]) / base, 2)]


def reading(rows: list[dict], scenes: list[dict], fails: list[dict]) -> list[str]:
    """What the chart says, in sentences."""
    meets = [row for row in rows if row["total_worst"] is not None and not row["failed"]
             and row["total_worst"] <= GOAL_TOTAL and row["cells_worst"] <= GOAL_CELLS]  # fmt: skip
    said = [f"{len(scenes)} scenes against {scenes[0]['reference']}; seconds are processor seconds of one thread."]
    if meets:
        best = min(meets, key=lambda row: row["cpu_seconds_median"])
        said.append(f"Cheapest within {GOAL_TOTAL:.0%} of total force and {GOAL_CELLS:.0%} per cell on every scene:"
                    f" {best['method']}, {best['cpu_seconds_median']:.2g} s (median).")  # fmt: skip
    else:
        goals = f"{GOAL_TOTAL:.0%} of total force and {GOAL_CELLS:.0%} per cell"
        said.append(f"No method is within {goals} on every scene.")
    for row in rows:
        if row["method"].endswith("-label") and row["total_worst"] is not None:
            said.append(f"{row['method']}: {row['cpu_seconds_median']:.2g} s; total force worst"
                        f" {row['total_worst']:.2%} ({row['total_worst_scene']}), cells worst"
                        f" {row['cells_worst']:.1%} ({row['cells_worst_scene']}).")  # fmt: skip
    for scene in scenes:
        check = scene.get("reference_check")
        if "reference_check" in scene:
            effect = "failed"
            if check:
                effect = f"moves total force by {check['total']:.2%} and cells by {check['cells']:.1%}"
            said.append(f"Halving the reference's element size and load step on {scene['scene']} {effect}.")
    if fails:
        said.append(f"{len(fails)} solves gave no result; they are listed with their reasons.")
    return said


def publish_chart(out: Path, scenes: list[dict], note: str) -> dict:
    """Write chart, CSV and JSON (`out`, last); returns what the JSON holds."""
    from gelforge.reporting.charts import pareto_chart

    rows, fails = summarise(scenes), failures(scenes)
    write_csv(beside(out, ".csv"), COLUMNS, rows)
    with publish(beside(out, ".png")) as part:
        part.write_bytes(pareto_chart(rows, scenes, note))
    found = {
        "reading": reading(rows, scenes, fails), "rows": rows, "failures": fails, "charted": charted(scenes),
        "reference_check": {s["scene"]: s["reference_check"] for s in scenes if "reference_check" in s},
        "scenes": {s["scene"]: {name: _brief(r) for name, r in s["methods"].items()} for s in scenes},
    }  # fmt: skip
    write_json(out, found)
    return found


def _brief(record: dict) -> dict:
    keys = ("status", "reason", "total", "seconds", "cpu_seconds", "peak_mib", "nodes", "errors")
    return {key: record.get(key) for key in keys}


@command(
    option("--name"),
    option("--scene", type=Path, help="resolved table, .json"),
    option("--set", choices=("full", "quick"), default="full"),
    option("--params", type=Path),
    option("--sensors", type=Path),
    option("--meshes", type=Path),
    option(
        "--references",
        type=Path,
        help="folder of references that were solved before",
        default=None,
    ),
    option("--out", type=Path),
)
def solve(args: Namespace) -> None:
    """Solve one scene by every method; a rerun resumes."""
    params = read_parameters(args.params, ForPareto)
    scene = parse_scene(args.name, read_json(args.scene), params.material.nu)
    bench = load_bench(params, load_sensors(args.sensors), args.meshes, args.out.parent, args.references)
    if args.set == "quick":
        with_ccx = params.fea.fidelity not in IN_PROCESS
        every = {name: read_json(args.scene.with_name(f"{name}.json")) for name in params.pareto.quick.scenes}
        scenes = [parse_scene(name, table, params.material.nu) for name, table in every.items()]
        # one chart, one reference
        reference_kept = all(given_reference(bench, other) for other in scenes)
        methods, checks = quick_methods(params.pareto.quick, with_ccx, reference_kept), []
    else:
        from gelforge.mechanics.ccx.program import need_ccx

        need_ccx()
        methods = every_method(params.pareto, params.fea.hex_quality)
        checks = checks_of(scene, params)
    write_json(args.out, solve_scene(bench, scene, methods, checks))


@command(
    option("--scenes", type=Path, nargs="+"),
    option("--note", default=""),
    option("--params", type=Path, help="pareto.json; the chart's errors are written for `auto`", default=None),
    option("--workflow", type=Path, default=Path("workflow"), help="folder for these errors"),
    option("--out", type=Path),
)
def draw(args: Namespace) -> None:
    """Draw solved scenes: chart, CSV and JSON."""
    scenes = [read_json(path) for path in args.scenes]
    references = {scene["reference"] for scene in scenes}
    if len(references) != 1:
        raise BadInput(f"scenes stand against different references ({', '.join(sorted(references))}); run make again")
    found = publish_chart(args.out, scenes, args.note)
    print("\n".join(found["reading"]))
    if args.params:
        print(keep_charted(found["charted"], read_parameters(args.params, ForPareto), args.workflow))


@command(
    option("--name", help="ccx-REGION-SIZE or fine-REGION-SIZE"),
    option("--params", type=Path, help="pareto_meshes.json"),
    option("--out", type=Path, help="NAME.npz; NAME.json is written beside it"),
)
def mesh(args: Namespace) -> None:
    """Make one mesh: a label region at a density of the chart, or a tight fine one for the reference."""
    params = read_parameters(args.params, ForParetoMeshes)
    made, report = build_mesh(args.name, load_gel(params.meshes.gel), params)
    publish_mesh(args.name, made, report, args.out)


main = group(mesh=mesh, scene=solve, chart=draw)


if __name__ == "__main__":
    main.exit()
