"""Run one sample through all stages in the foreground and show its log; all frames of a filmed press are solved together."""

import re
import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import write_text
from gelforge.flow.layout import Layout, shard_name
from gelforge.flow.main import command, option
from gelforge.flow.params.stages import ForForces, read_parameters
from gelforge.records.frames import presses_of
from gelforge.records.log import read_poses, read_shard, shard_text
from gelforge.records.press import RawRow, check_id


def find_rows(results: Path, sample_id: str) -> list[RawRow]:
    """The raw rows in the planned shards that a sample is solved from: its own, or all of its press where that was filmed.

    Frames lie on one path and one mesh: one of them alone would get other forces than the dataset has of it.
    """
    of = Layout(results)
    rows = read_shard(of.shard(of.shard_of(sample_id)))
    found = next((row for row in rows if row.cells["sample_id"] == sample_id), None)
    if found is None:
        raise of.not_logged(sample_id)
    return next(press for press in presses_of(rows) if found in press)


STEPS = option(
    "--steps", nargs="+", help="what takes a shard to labels (SHARD_STEPS of rules/work.mk); @ is its folder"
)


def in_folder(steps: Sequence[str], work: Path) -> list[tuple[str, list[str]]]:
    """Stage and arguments of each step for a shard in the folder `work`; the last argument is the output."""
    words = ([re.sub(r"^@(?=/)", str(work), word) for word in step.split()] for step in steps)
    return [(module.removeprefix("gelforge.stages."), arguments) for module, *arguments in words]


def require_stiffness(results: Path) -> None:
    """Raise BadInput before a sample is solved where its forces wait for a posterior that was not made yet."""
    from gelforge.stages.forces import material_c10

    of = Layout(results)
    if not of.calibration.exists():
        material_c10(read_parameters(of.params / "forces.json", ForForces).material, None, of.calibration)


@command(
    option("--dataset"),
    option("--id", help="sample_id in the raw log"),
    STEPS,
)
def main(args: Namespace) -> int:
    import importlib

    data, results = Path("data") / args.dataset, Path("results") / args.dataset
    if not args.id:
        raise BadInput(f"no sample named; say {Layout(results).command('sample ID=SAMPLE_ID')}")
    require_stiffness(results)
    work = Layout(results).sample(check_id(args.id)).root
    write_text(Layout(work).shard(shard_name(0)), shard_text(find_rows(results, args.id)))
    for stage, arguments in in_folder(args.steps, work):
        Path(arguments[-1]).parent.mkdir(parents=True, exist_ok=True)
        print(f"== {stage}", file=sys.stderr, flush=True)
        code = importlib.import_module(f"gelforge.stages.{stage}").main(arguments)
        if code:
            return code
        if stage == "poses" and args.id not in {press.sample_id for press in read_poses(arguments[-1])}:
            raise BadInput(f"sample {args.id} was rejected, see above; correct its row of {data}/log.csv")
        if Path(arguments[-1]).suffix == ".csv":
            print(Path(arguments[-1]).read_text(encoding="utf-8"))
    print(f"everything of {args.id} lies in {work}")
    return 0


if __name__ == "__main__":
    main.exit()
