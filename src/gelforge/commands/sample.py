"""Run one sample through all stages in the foreground and show its log; all frames of a filmed press are solved together."""

import shutil
import sys
from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.calibration import calibrated
from gelforge.flow.cli import RESULTS, command, option
from gelforge.flow.files import write_text
from gelforge.flow.layout import Layout
from gelforge.flow.params import read_parameters
from gelforge.records.finder import ONLY
from gelforge.records.frames import presses_of
from gelforge.records.log import read_poses, read_shard, shard_text
from gelforge.records.press import RawRow, check_id


def find_rows(results: Path, sample_id: str) -> list[RawRow]:
    """The raw rows that a sample is solved from: its own, or all frames of its press if that was filmed.

    Frames share one load path and one mesh, so a single frame would get other forces than in the dataset.
    """
    of = Layout(results)
    rows = read_shard(of.shard(of.shard_of(sample_id)))
    found = next((row for row in rows if row.cells["sample_id"] == sample_id), None)
    if found is None:
        raise of.not_logged(sample_id)
    return next(press for press in presses_of(rows) if found in press)


def prepared(work: Layout, rows: list[RawRow]) -> Layout:
    """Fill the folder `work` with rows as its only shard, and with a copy of the dataset's stage parameters."""
    of = Layout(work.dataset_root)
    write_text(work.shard(ONLY), shard_text(rows))
    shutil.copy(of.used(of.shard_of(rows[0].cells["sample_id"])), work.used(ONLY))
    shutil.rmtree(work.params, ignore_errors=True)
    shutil.copytree(of.params, work.params)
    return work


def steps(work: Layout, resolution: str) -> list[tuple[str, list[str], Path]]:
    """Stages from the only shard of a folder to its labels: module, arguments and output of each."""
    of_shard = {"poses": work.poses, "fea": work.fea, "forces": work.forces}
    root = str(work.root)
    found = [(name, [root, ONLY], target(ONLY)) for name, target in of_shard.items()]
    return [*found, ("labels", [root, resolution, ONLY], work.labels(resolution, ONLY))]


def require_calibration(of: Layout) -> None:
    """Raise BadInput, before the solve, if labels follow a calibration that does not exist yet."""
    calibrated(read_parameters(of.parameters("forces")), of.base)


@command(
    RESULTS,
    option("--id", help="sample_id in the raw log"),
    option("--resolution", default="24x32"),
)
def main(args: Namespace) -> int:
    import importlib

    of = Layout(args.results)
    if not args.id:
        raise BadInput(f"no sample named; say {of.command('sample ID=SAMPLE_ID')}")
    require_calibration(of)
    work = prepared(of.sample(check_id(args.id)), find_rows(args.results, args.id))
    for stage, words, target in steps(work, args.resolution):
        print(f"== {stage}", file=sys.stderr, flush=True)
        code = importlib.import_module(f"gelforge.stages.{stage}").main(words)
        if code:
            return code
        if stage == "poses" and args.id not in {press.sample_id for press in read_poses(target)}:
            raise BadInput(f"sample {args.id} was rejected, see above; correct its row of {of.log}")
        if target.suffix == ".csv":
            print(target.read_text(encoding="utf-8"))
    print(f"all files of {args.id} are in {work.root}")
    return 0


if __name__ == "__main__":
    main.exit()
