"""Branch pareto: seconds of a solve against its error, for every solver, mesh density and load-step count.

`mesh` makes one of its meshes, `scene` solves one scene by every method, `chart` draws.
"""

from argparse import Namespace
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median

from gelforge.errors import BadInput
from gelforge.flow.files import listed, publish, read_json, write_csv, write_if_changed, write_json
from gelforge.flow.layout import Layout, beside
from gelforge.flow.main import group, stage
from gelforge.flow.params import CHARTED, load_params, parameters_of, plain
from gelforge.flow.params.stages import ForMeshes, ForPareto, read_parameters
from gelforge.flow.params.tables import CHOOSING, CLASSES, IN_PROCESS, METHODS, VERIFYING, WAYS, FeaTable
from gelforge.flow.progress import progress
from gelforge.geometry.gel import load_gel
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.mesh.family import MeshName, make_mesh
from gelforge.mechanics.solvers.contactclass import contact_class
from gelforge.stages.meshes import publish_mesh
from gelforge.sweeps.deviation import errors, frontier
from gelforge.sweeps.methods import DOUBLED, REFERENCE, Method, every_method, quick_methods
from gelforge.sweeps.scenes import NamedScene, parse_scene
from gelforge.sweeps.trial import ChartBench, given_reference, load_bench, measure

VERSION = 4
GOAL_TOTAL, GOAL_CELLS = 0.02, 0.08  # what a label setting should meet over all scenes
COLUMNS = ("method", "solver", "size_mm", "load_steps", "scenes", "failed", "cpu_seconds_median",
           "cpu_seconds_worst",
           "total_median", "total_worst", "total_worst_scene", "cells_median", "cells_worst", "cells_worst_scene",
           "frontier_total", "frontier_cells")  # fmt: skip


def solve_scene(bench: ChartBench, scene: NamedScene, methods: list[Method], checks: list[Method]) -> dict:
    """Every method on one scene, the last of `methods` being the reference; records by method with their errors.

    checks: other solves of the reference.
    """
    reference = methods[-1].name
    methods = [*methods, *checks]
    records = {m.name: measure(bench, scene, m) for m in progress(methods, scene.name)}
    compared: dict[str, dict] = {}
    for method in methods:
        record = records[method.name] | {"method": asdict(method)}
        compared[method.name] = record | {"errors": errors(record, records[reference])}
    found: dict = {"scene": scene.name, "class": contact_class(scene.scene), "table": scene.table}
    found |= {"reference": reference, "methods": compared}
    if DOUBLED in records:
        found["reference_check"] = compared[DOUBLED]["errors"]
    return found


def summarise(scenes: list[dict]) -> list[dict]:
    """One row per method over all scenes: cost, errors, failures and whether it lies on a frontier.

    A method that failed on a scene is on none and takes no other off it: its worst error leaves out the scene that was too
    much for it.
    """
    names = dict.fromkeys(name for scene in scenes for name in scene["methods"])
    reference = {scene["reference"] for scene in scenes} | {DOUBLED}
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
    row = {"method": name, "solver": method["solver"], "size_mm": method["size"], "load_steps": method["steps"],
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


def charted(scenes: list[dict]) -> dict[str, dict[str, list[float]]]:
    """What workflow/charted.toml should say: by class of contact and way, worst errors in total force and cells, and cost.

    Cost is the median of processor seconds over that of `label` on all scenes. Empty where a method was not charted.
    """
    ways = [
        (scene["class"], {way: scene["methods"][way] for way in WAYS if way in scene["methods"]})
        for scene in scenes
        if scene.get("class")
    ]
    found = [(kind, of) for kind, of in ways if of.keys() == set(WAYS)]
    if not found or any(not record["errors"] for _, of in found for record in of.values()):
        return {}
    base = median([of["label"]["cpu_seconds"] for _, of in found])
    classes = {kind for kind, _ in found}
    return {
        kind: {way: _class_row([of[way] for held, of in found if held == kind], base) for way in WAYS}
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
    idle = CHOOSING | VERIFYING | {"method", "timeout_s"}
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
        if row["method"] in METHODS and row["total_worst"] is not None:
            said.append(f"{row['method']}: {row['cpu_seconds_median']:.2g} s; total force worst"
                        f" {row['total_worst']:.2%} ({row['total_worst_scene']}), cells worst"
                        f" {row['cells_worst']:.1%} ({row['cells_worst_scene']}).")  # fmt: skip
    for scene in scenes:
        check = scene.get("reference_check")
        if "reference_check" in scene:
            effect = "failed"
            if check:
                effect = f"moves total force by {check['total']:.2%} and cells by {check['cells']:.1%}"
            said.append(f"Halving element size and load step of the reference on {scene['scene']} {effect}.")
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


@dataclass(frozen=True)
class ChartedScene:
    """What a solve of the chart reads: its stage's parameters, its scene by name, and where its meshes lie."""

    params: ForPareto
    scene: NamedScene
    bench: ChartBench


def asked(args: Namespace, meshes: Path) -> ChartedScene:
    """The scene that a command line names."""
    of = args.of
    params = read_parameters(of.parameters("pareto"), ForPareto)
    bench = load_bench(params, load_sensors(of.parameters("sensors")), meshes, args.out.parent, of.references)
    return ChartedScene(params, planned_scene(of, args.name, params), bench)


def planned_scene(of: Layout, name: str, params: ForPareto) -> NamedScene:
    """A scene by name, its indenter's table resolved."""
    return parse_scene(name, read_json(of.parameters(f"scenes/{name}")), params.material.nu)


@stage(Layout.chart_scene)
def solve(args: Namespace) -> None:
    """Solve one scene by every method; a rerun resumes."""
    from gelforge.mechanics.ccx.program import need_ccx

    need_ccx()
    found = asked(args, args.of.chart_mesh("any").parent)
    methods = every_method(found.params.pareto)
    write_json(args.out, solve_scene(found.bench, found.scene, methods, [Method(DOUBLED, REFERENCE, doubled=True)]))


@stage(Layout.quick_scene)
def solve_quick(args: Namespace) -> None:
    """Solve one scene by the few methods of the report's chart."""
    found = asked(args, args.of.meshes)
    params = found.params
    # one chart, one reference: all of its scenes decide which
    scenes = [planned_scene(args.of, name, params) for name in params.pareto.quick.scenes]
    reference_kept = all(given_reference(found.bench, other) for other in scenes)
    methods = quick_methods(params.pareto.quick, params.fea.method not in IN_PROCESS, reference_kept)
    write_json(args.out, solve_scene(found.bench, found.scene, methods, []))


def chart_of(paths: list[Path], out: Path, note: str = "") -> dict:
    """Draw solved scenes: chart, CSV and JSON; return what the JSON holds."""
    scenes = [read_json(path) for path in paths]
    references = {scene["reference"] for scene in scenes}
    if len(references) != 1:
        raise BadInput(f"scenes stand against different references ({', '.join(sorted(references))}); run make again")
    found = publish_chart(out, scenes, note)
    print("\n".join(found["reading"]))
    return found


@stage(Layout.chart)
def draw(args: Namespace) -> None:
    """Draw all scenes, and write the chart's errors for `auto`."""
    of = args.of
    paths = [of.chart_scene(path.stem) for path in listed(of.params / "scenes", "*.json")]
    found = chart_of(paths, args.out)
    print(keep_charted(found["charted"], read_parameters(of.parameters("pareto"), ForPareto), of.workflow))


@stage(Layout.quick_chart)
def draw_quick(args: Namespace) -> None:
    """Draw the scenes of the report's chart."""
    of = args.of
    names = read_parameters(of.parameters("pareto"), ForPareto).pareto.quick.scenes
    note = f"a small chart; {of.command('pareto')} draws the large one"
    chart_of([of.quick_scene(name) for name in names], args.out, note)


@stage(Layout.chart_mesh)
def mesh(args: Namespace) -> None:
    """Make one mesh, ccx-REGION-SIZE: a label region at a density of the chart."""
    meshes = read_parameters(args.of.parameters("meshes"), ForMeshes).meshes
    made, report = make_mesh(MeshName.parse(args.name), load_gel(meshes.gel), meshes)
    publish_mesh(args.name, made, report, args.out)


main = group(mesh=mesh, scene=solve, quick=solve_quick, chart=draw, **{"quick-chart": draw_quick})


if __name__ == "__main__":
    main.exit()
