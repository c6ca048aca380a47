"""Branch pareto: the scenes of the chart and their references as a folder of plain files, a benchmark for any simulator."""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.main import command, group, option
from gelforge.flow.params import SOURCES, load_params, parameters_of, stage_version
from gelforge.flow.params.stages import ForPareto
from gelforge.geometry.gel import use_gels_of
from gelforge.labelling.sensor import load_sensors
from gelforge.sweeps.challenge import write_challenge
from gelforge.sweeps.keptreferences import keep_references
from gelforge.sweeps.scenes import parse_scene, read_tables
from gelforge.sweeps.trial import ChartBench, given_reference


@command(
    option("--scenes", type=Path, nargs="+", help="results/DATASET/pareto/scenes/*.json"),
    option("--references", type=Path, help="folder of the references"),
    option("--workflow", type=Path, default=Path("workflow")),
)
def references(args: Namespace) -> None:
    use_gels_of(args.workflow)
    """Take the references from a finished chart."""
    args.references.mkdir(parents=True, exist_ok=True)
    keep_references(
        (read_json(path) for path in args.scenes), args.references, load_params(args.workflow).material.nu
    )


@command(
    option("--workflow", type=Path, default=Path("workflow")),
    option("--references", type=Path, help="folder of the references"),
    option("--out", type=Path, help="folder to write"),
)
def write(args: Namespace) -> None:
    use_gels_of(args.workflow)
    """Write the folder that others download."""
    params, sensors = load_params(args.workflow), load_sensors(args.workflow / "sensors.toml")
    name = params.pareto.sensor
    if name not in sensors:
        raise BadInput(f"[pareto] sensor = {name!r} is not in {args.workflow}/sensors.toml")
    scenes = [parse_scene(key, table, params.material.nu) for key, table in read_tables(args.workflow).items()]
    made = parameters_of(params, ForPareto, stage_version(Path(__file__).parent, SOURCES["pareto"]))
    bench = ChartBench(args.out, sensors[name], made, args.out, args.references)
    old = [scene.name for scene in scenes if given_reference(bench, scene) is None]
    if old:
        raise BadInput(
            f"{args.references}: the reference of {', '.join(old)} is of another scene, sensor or setting than today's; "
            "run make fea-references"
        )
    args.out.mkdir(parents=True, exist_ok=True)
    write_challenge(scenes, sensors[name], args.references, args.out)
    print(f"{args.out}: {len(scenes)} scenes; read {args.out}/README.md")


main = group(references=references, write=write)


if __name__ == "__main__":
    main.exit()
