"""Branch pareto: time of a solve against its error, for every solver, mesh density and number of load steps.

`scene` solves one scene by every method, `chart` draws the chart of all scenes.
"""

from argparse import Namespace
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.flow.cli import group, stage
from gelforge.flow.files import publish, read_json, write_csv, write_json
from gelforge.flow.layout import Layout, beside
from gelforge.flow.params import StageParameters, read_parameters
from gelforge.flow.tables import METHODS
from gelforge.labelling.sensor import load_sensors
from gelforge.sweeps.deviation import errors, frontier
from gelforge.sweeps.methods import DOUBLED, LARGE_REFERENCE, REFERENCE, Method, every_method
from gelforge.sweeps.scenes import NamedScene, parse_scene
from gelforge.sweeps.trial import ChartBench, given_check, load_bench, measure

VERSION = 6
GOAL_TOTAL, GOAL_CELLS = 0.02, 0.08  # largest relative errors that a method for labels should have over all scenes
COLUMNS = ("method", "solver", "size_mm", "load_steps", "scenes", "failed", "whole", "cpu_seconds_median",
           "cpu_seconds_worst",
           "total_median", "total_worst", "total_worst_scene", "cells_median", "cells_worst", "cells_worst_scene",
           "frontier_total", "frontier_cells")  # fmt: skip


def solve_scene(bench: ChartBench, scene: NamedScene, methods: list[Method]) -> dict:
    """Every method on one scene, the last being the reference; records by method with their errors.

    LARGE_REFERENCE is checked by one more solve, with elements and load steps of twice the size, or by the stored
    result of that check if its reference is stored.
    """
    reference, check = methods[-1].name, given_check(bench, scene)
    if methods[-1] == LARGE_REFERENCE and check is None:
        methods = [*methods, Method(DOUBLED, REFERENCE, doubled=True)]
    records = {m.name: measure(bench, scene, m) for m in tqdm(methods, scene.name)}
    compared: dict[str, dict] = {}
    for method in methods:
        record = records[method.name] | {"method": asdict(method)}
        compared[method.name] = record | {"errors": errors(record, records[reference])}
    found: dict = {"scene": scene.name, "table": scene.table, "reference": reference, "methods": compared}
    if reference == REFERENCE:
        found["reference_check"] = compared[DOUBLED]["errors"] if DOUBLED in compared else check
    return found


def summarise(scenes: list[dict]) -> list[dict]:
    """One row per method over all scenes: cost, errors, failures, whether all were solved, and whether it lies on a frontier.

    A method without a result on some scene counts for no frontier, because its worst error leaves that scene out.
    """
    names = dict.fromkeys(name for scene in scenes for name in scene["methods"])
    reference = {scene["reference"] for scene in scenes} | {DOUBLED}
    rows = [_row(name, scenes) for name in names if name not in reference]
    for kind in ("total", "cells"):
        usable = [row for row in rows if row[f"{kind}_worst"] is not None and row["whole"]]
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
           "scenes": len(records), "failed": len(records) - len(good), "whole": len(good) == len(scenes)}  # fmt: skip
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
    """Solves without a result, each with its reason."""
    return [{"scene": scene["scene"], "method": name, "status": record["status"], "reason": record["reason"]}
            for scene in scenes for name, record in scene["methods"].items()
            if record.get("cells") is None]  # fmt: skip


def reading(rows: list[dict], scenes: list[dict], fails: list[dict]) -> list[str]:
    """The results of the chart in sentences."""
    meets = [row for row in rows if row["total_worst"] is not None and row["whole"]
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
            found = "failed"
            if check:
                found = f"differs by {check['total']:.2%} in total force and by {check['cells']:.1%} in cells"
            said.append(
                f"Check of the reference on {scene['scene']}: a solve with elements and load steps of twice the size {found}."
            )
    if fails:
        said.append(f"{len(fails)} solves gave no result; they are listed with their reasons.")
    return said


def publish_chart(out: Path, scenes: list[dict]) -> dict:
    """Write chart, CSV and, last, JSON (`out`); return the contents of the JSON."""
    from gelforge.reporting.charts import pareto_chart

    rows, fails = summarise(scenes), failures(scenes)
    write_csv(beside(out, ".csv"), COLUMNS, rows)
    with publish(beside(out, ".png")) as part:
        part.write_bytes(pareto_chart(rows, scenes))
    found = {
        "reading": reading(rows, scenes, fails), "rows": rows, "failures": fails,
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
    """Inputs of a solve of the chart: parameters of the stage, the named scene, and the bench."""

    params: StageParameters
    scene: NamedScene
    bench: ChartBench


def asked(args: Namespace) -> ChartedScene:
    """The scene that a command line names."""
    of = args.of
    params = read_parameters(of.parameters("pareto"))
    bench = load_bench(params, load_sensors(of.parameters("chart")), args.out.parent, of.references)
    return ChartedScene(params, planned_scene(of, args.name, params), bench)


def planned_scene(of: Layout, name: str, params: StageParameters) -> NamedScene:
    """A planned scene by name, with its indenter's table."""
    return parse_scene(name, read_json(of.parameters(f"scenes/{name}")), params.material.nu)


@stage(Layout.chart_scene)
def solve(args: Namespace) -> None:
    """Solve one scene by every method; a rerun resumes."""
    from gelforge.mechanics.ccx.program import need_ccx

    need_ccx()
    found = asked(args)
    methods = every_method(found.params.pareto, found.scene.name)
    write_json(args.out, solve_scene(found.bench, found.scene, methods))


def chart_of(paths: list[Path], out: Path) -> None:
    """Draw solved scenes: chart, CSV and JSON."""
    scenes = [read_json(path) for path in paths]
    references = {scene["reference"] for scene in scenes}
    if len(references) != 1:
        raise BadInput(
            f"scenes are compared with different references ({', '.join(sorted(references))}); run make again"
        )
    print("\n".join(publish_chart(out, scenes)["reading"]))


@stage(Layout.chart)
def draw(args: Namespace) -> None:
    """Draw the chart of all planned scenes; other files in the scenes' folder are ignored."""
    of = args.of
    chart_of([of.chart_scene(name) for name in read_json(of.parameters("scenes"))], args.out)


main = group(scene=solve, chart=draw)


if __name__ == "__main__":
    main.exit()
