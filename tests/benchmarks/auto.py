"""Method "auto" with verified presses against `ccx` alone, on random presses of workflow/rig/paper.toml.

All presses are solved by "auto", and a fraction of them, chosen by a hash of their names, also by CalculiX. The
latter give the cost of `ccx` alone and the differences between both; those that [fea] verify selects count as cost of
"auto". Times are processor times of one process. Records are kept below --work, so that a stopped run resumes.
"""

import tempfile
from argparse import Namespace
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.flow import params as config
from gelforge.flow.cli import command, option, positive
from gelforge.flow.files import digest_of_value, read_json, write_json
from gelforge.flow.params import plain
from gelforge.flow.tables import FeaTable, Params
from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.labelling.sensor import Sensor, load_sensors
from gelforge.mechanics.ccx.program import need_ccx
from gelforge.mechanics.material import Material
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solve import Solvers
from gelforge.records.press import Press
from gelforge.stages.fea import VERSION
from gelforge.sweeps import verification
from gelforge.sweeps.isolate import Clock
from gelforge.sweeps.methods import warm_up
from gelforge.virtualrig.bench import Bench
from gelforge.virtualrig.rigplan import orders, read_plan
from tests.support.figures import Figure, publish_figures

PRESSES = 200
BESIDE = 0.12  # fraction of the presses that CalculiX solves
VERIFIED = 0.05  # fraction of presses that a second method solves, too
COST = 0.4  # of auto's seconds over those of `ccx`


@dataclass(frozen=True)
class Ordered:
    """One press of the mix."""

    name: str
    scene: Scene


def mix(plan_file: Path, workflow: Path, count: int) -> list[Ordered]:
    """The first presses of a plan, each at its final frame, all on the usual gel."""
    plan = replace(read_plan(plan_file), presses=count, frames=1)
    bodies, gel = load_catalogue(workflow / plan.catalogue), load_gel(plan.gel)
    bench, found, seen = Bench(plan, bodies, gel), [], set()
    for order in orders(plan):
        if order.press_id in seen:
            continue  # the same press, seen by another sensor
        seen.add(order.press_id)
        order = replace(order, gel=gel.name)
        depth = bench.reached(order, 0.0)
        dx, dy = (depth / order.depth * part for part in order.shear)
        press = Press(order.x, order.y, 0.0, float(dx), float(dy), -depth, order.rot_deg)
        found.append(Ordered(order.press_id, Scene(gel, Material(plan.truth.nu), bodies[order.indenter], press)))
    return found


class Side:
    """Presses solved by one method, each stored as a file in a folder."""

    def __init__(self, method: str, solvers: Solvers, sensor: Sensor, folder: Path) -> None:
        self.method, self.solvers, self.sensor, self.folder = method, solvers, sensor, folder

    def solve(self, press: Ordered, key: str) -> dict:
        """Seconds, status, method, class, total (3,) N and cells (3, 24, 32) N of a press."""
        path = self.folder / f"{press.name}.{self.method}.json"
        record = read_json(path) if path.exists() else {}
        if record.get("key") != key:
            with Clock() as clock:
                result = self.solvers.solve(press.scene, self.method)
            record = {"key": key, "cpu_seconds": clock.cpu_seconds} | self._outcome(result)
            write_json(path, record)
        return record

    def _outcome(self, result: Result) -> dict:
        evidence = result.kept_evidence
        found = {name: evidence.get(name, "") for name in ("method", "reason", "error_n", "cells_error_n")}
        found |= {"status": result.status.name, "total": result.total.tolist()}
        if result.status.valid and result.mesh is not None:
            cells = verification.surface_cells(result.mesh, result.forces[result.mesh.surface_nodes], self.sensor)
            found["cells"] = np.round(cells, 7).tolist()
        return found


def compared(name: str, auto: dict, ccx: dict) -> verification.Verified:
    """Difference between the two records of a press, as stage 30 records it for a dataset."""
    press = ("", name, auto["method"])
    if "cells" not in auto or ccx.get("method") != "ccx":
        return verification.compare(press, [], ccx["reason"] or "no result of both", None)
    pairs = [(np.array(record["total"]), np.array(record["cells"])) for record in (auto, ccx)]
    errors = [(record["error_n"], record["cells_error_n"]) for record in (auto, ccx)]
    return verification.compare(press, errors, *pairs)


def figures_of(autos: dict[str, dict], ccxs: dict[str, dict], fea: FeaTable) -> tuple[list[Figure], list[dict]]:
    """Cost of auto with its verified presses over that of `ccx`, differences beyond their limits, and the records."""
    alone = np.array([record["cpu_seconds"] for record in ccxs.values()])
    verified = [name for name in autos if autos[name]["method"] != "ccx" and verification.chosen(name, VERIFIED)]
    own = np.array([record["cpu_seconds"] for record in autos.values()])
    seconds = (own.sum() + sum(ccxs[name]["cpu_seconds"] for name in verified)) / len(own)
    found = [compared(name, autos[name], ccxs[name]) for name in ccxs if autos[name]["method"] != "ccx"]
    solved = [record for record in found if not record.reason]
    beyond = [record for record in solved if record.beyond]
    ways = ", ".join(f"{count} by {way}" for way, count in Counter(r["method"] for r in autos.values()).most_common())
    cost = f"{seconds:.2f} s beside {alone.mean():.2f} s (mean of {len(alone)}); {ways}; {len(verified)} verified"
    bad = sum("cells" not in record for record in autos.values())
    return [
        Figure(f"auto with verify = {VERIFIED:g} over ccx, seconds a press", seconds / alone.mean(), "<=", COST, "times", cost),
        Figure("differences beyond their limit", 100 * len(beyond) / max(len(solved), 1), "<=", 100 * verification.ALLOWED,
               "%", f"of {len(solved)} presses; {'; '.join(r.sentence() for r in beyond[:5])}"),
        Figure("presses without a result", bad, "==", 0, "presses", f"of {len(autos)}"),
    ], [asdict(record) for record in found]  # fmt: skip


def settings(params: Params) -> list:
    """What the records depend on apart from the press."""
    return [VERSION, plain(params.fea)]


@command(
    option("--workflow", type=Path, default=Path("workflow")),
    option("--plan", type=Path, default=Path("workflow/rig/paper.toml")),
    option("--presses", type=positive, default=PRESSES),
    option("--work", type=Path, default=Path("results/benchmarks/auto"), help="what is kept"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    need_ccx()
    warm_up()
    params = config.load_params(args.workflow)
    sensor = load_sensors(args.workflow / "sensors.toml")[params.pareto.sensor]
    presses = mix(args.plan, args.workflow, args.presses)
    autos: dict[str, dict] = {}
    ccxs: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as work:
        solvers = Solvers(work, params.fea)
        auto, ccx = (Side(name, solvers, sensor, args.work / "presses") for name in ("auto", "ccx"))
        for press in tqdm(presses, "auto"):
            key = digest_of_value([*settings(params), press.scene.indenter.name, asdict(press.scene.press)])
            autos[press.name] = auto.solve(press, key)
            if verification.chosen(press.name, BESIDE):
                ccxs[press.name] = ccx.solve(press, key)
    figures, differences = figures_of(autos, ccxs, params.fea)
    seed = read_plan(args.plan).seed
    publish_figures(args.out, figures, differences=differences, mix=[{"plan": str(args.plan), "seed": seed}])


if __name__ == "__main__":
    main.exit()
