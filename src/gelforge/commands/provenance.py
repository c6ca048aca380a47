"""The provenance of one label: files, parameters, program versions and cost, as text or JSON."""

import json
from argparse import Namespace
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.cli import RESULTS, command, option
from gelforge.flow.files import record_of
from gelforge.flow.layout import FEA, Layout
from gelforge.flow.runs import (
    Step,
    concerning,
    imported_labels,
    pose_of,
    rejections_of,
    steps_of_label,
    steps_to,
)


def provenance(results: Path, sample_id: str, resolution: str) -> dict:
    """The provenance of a label: its sample's solve and the steps in order of execution; or why there is none."""
    of = Layout(results)
    shard = of.shard_of(sample_id)
    imported = imported_labels(results, resolution)
    rejected = [] if imported else rejections_of(results, shard, sample_id)
    if imported:  # this project made no pose, solve or force for it
        steps = []
    elif rejected:  # later stages of its shard do not contain it
        steps = list(steps_to(results, str(of.poses(shard)), shard))
    else:
        steps = steps_of_label(results, shard, resolution)
    pose = pose_of(results, shard, sample_id)
    steps = [replace(step, parameters=concerning(step.parameters, pose)) for step in steps]
    solve = record_of(of.solve(shard, sample_id)) or {}
    return {
        "sample_id": sample_id,
        "shard": shard,
        "imported": str(imported or ""),
        "rejected": rejected,
        "solve": {} if rejected else solve,
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
            text += solve_lines(found["solve"], step.target)
    if not found["steps"]:
        text.append("no stage has run for it yet")
    return text


def solve_lines(solve: dict, target: str) -> list[str]:
    """Lines on the sample's own solve."""
    evidence = solve.get("evidence", {})
    cost = f"{evidence.get('seconds', 0.0):.1f} s"
    cost += f", {evidence['peak_mib']:.0f} MiB" if evidence.get("peak_mib") else ""
    why = f" ({solve['reason']})" if solve.get("reason") else ""
    files = ", ".join(f"{Path(target).with_suffix('')}/{name}" for name in solve.get("files", []))
    return [
        f"    this sample: {solve['status']}{why}, {solve['method']} on mesh {solve['mesh']}, {cost}",
        f"    its files: {files or 'none'}",
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
