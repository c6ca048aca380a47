"""Branch pareto: the chart's scenes and references as a folder of plain files, a benchmark for any simulator."""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.cli import RESULTS, command, group, option
from gelforge.flow.files import read_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import load_params, parameters_of, stage_version
from gelforge.geometry.gel import use_gels_of
from gelforge.labelling.sensor import load_sensors
from gelforge.sweeps.challenge import write_challenge
from gelforge.sweeps.keptreferences import keep_references
from gelforge.sweeps.scenes import parse_scene, read_tables
from gelforge.sweeps.trial import ChartBench, given_reference

OUT = option("out", type=Path, metavar="FOLDER", help="folder to write, such as results/fea_challenge")


@command(RESULTS)
def references(args: Namespace) -> None:
    """Take the references from a finished chart."""
    of = Layout(args.results)
    use_gels_of(of.workflow)
    of.references.mkdir(parents=True, exist_ok=True)
    scenes = (read_json(of.chart_scene(name)) for name in read_tables(of.workflow))
    keep_references(scenes, of.references, load_params(of.workflow).material.nu)


@command(OUT)
def write(args: Namespace) -> None:
    """Write the folder that others download."""
    of = Layout(args.out)
    use_gels_of(of.workflow)
    params, sensors = load_params(of.workflow), load_sensors(of.workflow / "sensors.toml")
    name = params.pareto.sensor
    if name not in sensors:
        raise BadInput(
            f"{of.workflow}/sensors.toml has no [{name}], in whose image forces are compared; add it again"
        )
    scenes = [parse_scene(key, table, params.material.nu) for key, table in read_tables(of.workflow).items()]
    made = parameters_of(params, "pareto", stage_version(Path(__file__).parent, "pareto"))
    bench = ChartBench(sensors[name], made, args.out, of.references)
    old = [scene.name for scene in scenes if given_reference(bench, scene) is None]
    if old:
        raise BadInput(
            f"{of.references}: the reference of {', '.join(old)} is of another scene, sensor or setting than today's; "
            "run make fea-references"
        )
    args.out.mkdir(parents=True, exist_ok=True)
    write_challenge(scenes, sensors[name], of.references, args.out)
    print(f"{args.out}: {len(scenes)} scenes; read {args.out}/README.md")


main = group(references=references, write=write)


if __name__ == "__main__":
    main.exit()
