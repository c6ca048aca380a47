"""The provenance of one label: files, parameters, program versions and cost, as text or JSON."""

import json
from argparse import Namespace
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.cli import RESULTS, command, option
from gelforge.flow.files import digest_of
from gelforge.flow.layout import FEA, Layout
from gelforge.flow.runs import (
    Step,
    concerning,
    pose_of,
    steps_of_label,
    steps_to,
)
from gelforge.records.finder import find


def provenance(results: Path, sample_id: str, resolution: str) -> dict:
    """The provenance of a label: its sample's solve and the steps in order of execution; or why there is none."""
    of, found = Layout(results), find(results, sample_id, resolution)
    shard = of.shard_of(sample_id)
    if found.imported:  # this project made no pose, solve or force for it
        steps = []
    elif found.rejected:  # later stages of its shard do not contain it
        steps = list(steps_to(results, str(of.poses(shard)), shard))
    else:
        steps = steps_of_label(results, shard, resolution)
    pose = pose_of(results, shard, sample_id)
    steps = [replace(step, parameters=concerning(step.parameters, pose)) for step in steps]
    posed = of.poses(shard).parent / pose.get("stl", "") if pose.get("stl") else None
    record = found.record if found.of.root == of.root else None
    return {
        "sample_id": sample_id,
        "shard": shard,
        "imported": str(found.imported or ""),
        "rejected": found.rejected,
        "solve": {}
        if found.rejected or record is None
        else record | {"file": str(found.arrays) if record["sha256"] else ""},
        "stl": {"file": str(posed), "sha256": digest_of(posed)} if posed and posed.is_file() else {},
        "steps": [asdict(s) for s in steps],
    }


def lines(found: dict, results: Path) -> list[str]:
    """The provenance as text."""
    text = [f"{found['sample_id']} of shard {found['shard']}", f"log: data/{results.name}/log.csv"]
    if found["imported"]:
        return [*text, f"its label came with the dataset: {found['imported']}"]
    text += [f"rejected, so that it has no label: {why}" for why in found["rejected"]]
    for step in (Step(**made) for made in found["steps"]):
        when = datetime.fromtimestamp(step.started, UTC).strftime("%Y-%m-%d %H:%M:%S")
        text.append(
            f"{step.target}: made {when} UTC in {step.seconds:.1f} s, {step.cpu_seconds:.1f} s of processor time,"
            f" {step.peak_mib:.0f} MiB"
        )
        text += [f"    reads {path}" for path in step.inputs if not Path(path).is_relative_to(Layout(results).params)]
        text += [f"    parameters {name} {json.dumps(values)}" for name, values in step.parameters.items()]
        text.append(f"    by {', '.join(f'{name} {version}' for name, version in sorted(step.programs.items()))}")
        if Path(step.target).is_relative_to(Layout(results).folder(FEA)) and found["solve"]:
            text += solve_lines(found["solve"])
    if found["stl"]:
        text.append(f"posed indenter: {found['stl']['file']}, SHA-256 {found['stl']['sha256'][:12]}")
    if not found["steps"]:
        text.append("no stage has run for it yet")
    return text


def solve_lines(solve: dict) -> list[str]:
    """Lines on the sample's own solve."""
    evidence = solve.get("evidence", {})
    cost = f"{evidence.get('seconds', 0.0):.1f} s"
    cost += f", {evidence['peak_mib']:.0f} MiB" if evidence.get("peak_mib") else ""
    why = f" ({solve['reason']})" if solve.get("reason") else ""
    return [
        f"    this sample: {solve['status']}{why}, {solve['method']} on mesh {solve['mesh']}, {cost}",
        f"    its file in the store: {solve['file'] or 'none'} {solve['sha256'][:12]}",
        *([f"    CalculiX {evidence['ccx_version']}"] if evidence.get("ccx_version") else []),
    ]


@command(
    RESULTS,
    option("--id", help="sample_id in the raw log"),
    option("--resolution", default="24x32"),
    option("--json", action="store_true", help="print everything as JSON"),
)
def main(args: Namespace) -> None:
    if not args.id:
        raise BadInput(f"no sample named; say {Layout(args.results).command('provenance ID=SAMPLE_ID')}")
    found = provenance(args.results, args.id, args.resolution)
    print(json.dumps(found, indent=1) if args.json else "\n".join(lines(found, args.results)))


if __name__ == "__main__":
    main.exit()
