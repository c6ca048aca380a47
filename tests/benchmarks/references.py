"""References of the chart solved once more on other meshes: how much two references of one scene differ.

The other mesh has elements a little larger, so pytetwild makes all of its tetrahedra anew. Every solve is kept under its
key in --work, so a run that was interrupted goes on.
"""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.main import command, option
from gelforge.flow.params import load_params, parameters_of
from gelforge.flow.params.stages import ForPareto
from gelforge.labelling.sensor import load_sensors
from gelforge.stages.pareto import VERSION, checks_of
from gelforge.sweeps.deviation import errors
from gelforge.sweeps.keptreferences import averaged
from gelforge.sweeps.methods import LARGE_REFERENCE, TURNED
from gelforge.sweeps.references import reference_mesh
from gelforge.sweeps.scenes import NamedScene, parse_scene, read_tables
from gelforge.sweeps.symmetry import images_of
from gelforge.sweeps.trial import ChartBench, given_reference, load_bench, measure
from tests.benchmarks.chart_meshes import ensure_meshes
from tests.benchmarks.figures import Figure, publish_figures
from tests.benchmarks.outside import GOALS

CELLS = 2.5  # % of total force, the sum over cells
LARGER = 1.06


def other_bench(bench: ChartBench, work: Path) -> ChartBench:
    """A bench whose references are solved on meshes of slightly larger elements."""
    regions = {
        name: replace(region, size=round(LARGER * region.size, 3))
        for name, region in bench.params.pareto.regions.items()
    }
    params = replace(bench.params, pareto=replace(bench.params.pareto, regions=regions))
    return replace(bench, params=params, meshes=work / "meshes", records=work / "records", references=None)


def solved(bench: ChartBench, scene: NamedScene) -> dict:
    """The reference of a scene as it would be kept: a mean of several solves where it can be."""
    ensure_meshes(bench, [reference_mesh(bench.params, scene.fine)])
    record = measure(bench, scene, LARGE_REFERENCE)
    others = [measure(bench, scene, check) for check in checks_of(scene, bench.params) if check.name == TURNED]
    if record.get("cells") is None:
        raise BadInput(f"{scene.name} on the other mesh is {record['status']}: {record['reason']}")
    return record | averaged(record, others[0] if others else None, images_of(scene.scene))


@command(
    option("--workflow", type=Path, default=Path("workflow")),
    option("--references", type=Path, default=Path("data/fea_challenge")),
    option("--scenes", nargs="+", default=GOALS),
    option("--work", type=Path, default=Path("results/benchmarks/references"), help="what is kept"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    params = parameters_of(load_params(args.workflow), ForPareto, VERSION)
    sensors = load_sensors(args.workflow / "sensors.toml")
    bench = load_bench(params, sensors, args.work / "meshes", args.work / "records", args.references)
    other, tables, figures = other_bench(bench, args.work), read_tables(args.workflow), []
    for name in args.scenes:
        scene = parse_scene(name, tables[name], params.material.nu)
        reference = given_reference(bench, scene)
        if reference is None:
            raise BadInput(f"{args.references} has no reference of {name} at today's settings; make pareto solves it")
        apart = errors(solved(other, scene), reference)
        note = f"total force {100 * apart['total']:.2f} %"
        figures.append(Figure(f"{name}, two references, cells", 100 * apart["cells"], "<=", CELLS, "%", note))
        publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
