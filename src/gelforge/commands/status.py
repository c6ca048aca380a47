"""Samples of a dataset that are done, failed (with reasons) and pending, stage by stage."""

import os
from argparse import Namespace
from collections import Counter
from collections.abc import Collection
from itertools import chain
from pathlib import Path

from gelforge.errors import printable
from gelforge.flow import layout
from gelforge.flow.cache import FileValues
from gelforge.flow.files import listed, names_in, read_csv
from gelforge.flow.layout import Layout
from gelforge.flow.ledger import (
    LastRun,
    causes,
    changed_since,
    failures,
    last_runs,
    last_words_of,
    stages,
    still_asked,
)
from gelforge.flow.main import RESULTS, command, option
from gelforge.flow.running import duration, look, running_targets
from gelforge.records.status import VALID, Status

# Only the standard library before there are forces: status answers in a fraction of a second for 15 000 samples.


def rows_in(table: Path) -> int:
    """Rows of a table."""
    return len(read_csv(table))


def rejections(table: Path) -> list[str]:
    """Why rows of the log were rejected, a reason each; one that is wrong in several columns is one rejected row."""
    return [f"{row['column']}: {row['reason']}" for row in {row["row"]: row for row in read_csv(table)}.values()]


def solves(table: Path) -> list[str]:
    """What became of each press of a shard: OK for a valid solve, else its status and reason."""
    return [
        "OK" if row["status"] in VALID else f"{row['status']}: {row.get('reason', '')}" for row in read_csv(table)
    ]


def lost_forces(path: Path) -> list[str]:
    """Statuses of a shard's valid solves that gave no forces after all."""
    from gelforge.records.forcefile import without_forces  # numpy is a large part of what status takes

    bad = without_forces(path)
    rows = read_csv(Layout(path.parent.parent).fea(path.stem)) if bad else []
    return [bad[row["sample_id"]] for row in rows if row["status"] in VALID and row["sample_id"] in bad]


def poses_state(results: Path, shards: Collection[str], kept: FileValues) -> tuple[int, Counter]:
    """Good rows of the log and reasons of the rejected ones."""
    folder = Layout(results).folder(layout.POSES)
    done = sum(kept.of(f"{folder}/{shard}.csv", rows_in) or 0 for shard in shards)
    failed = (kept.of(f"{folder}/{shard}.rejected.csv", rejections) or () for shard in shards)
    return done, Counter(chain.from_iterable(failed))


def fea_state(results: Path, shards: Collection[str], kept: FileValues) -> tuple[int, Counter, dict[str, int]]:
    """Solves done, reasons of the failed ones, and the valid ones of each whole shard.

    Partly done shards count by their sample files.
    """
    partly, reasons, valid = 0, Counter[str](), {}
    folder = Layout(results).folder(layout.FEA)
    for shard in shards:
        found = kept.of(f"{folder}/{shard}.csv", solves)
        partly += len(names_in(f"{folder}/{shard}", ".json")) if found is None else 0
        reasons.update(found or ())
        valid[shard] = (found or []).count("OK")
    return partly + reasons.pop("OK", 0), reasons, valid


def forces_state(results: Path, valid: dict[str, int], kept: FileValues) -> tuple[int, Counter, dict[str, int]]:
    """Samples with forces, what became of solves that gave none after all, and the samples left of each shard.

    valid: good solves of each shard.
    """
    folder, failed, left, done = Layout(results).folder(layout.FORCES), Counter[str](), dict(valid), 0
    for shard, count in valid.items():
        lost = kept.of(f"{folder}/{shard}.npz", lost_forces)
        if lost is not None:
            failed.update(f"{state}: {Status[state].value}" for state in lost)
            left[shard] = count - len(lost)
            done += left[shard]
    return done, failed, left


def shard_state(folder: Path, valid: dict[str, int]) -> int:
    """Samples of which a shard's file holds forces; valid: solves of each shard."""
    there = set(os.listdir(folder))
    return sum(count for shard, count in valid.items() if f"{shard}.npz" in there)


def lines(results: Path, broken: Collection[str] = (), meshes: Collection[str] | None = None) -> list[str]:
    """The table that `make status` prints.

    broken: stages with a target whose last run failed. meshes: those that presses may take; None where that is not known.
    """
    of = Layout(results)
    kept, planned = FileValues(of.tables), of.shards
    counted = {shard: kept.of(f"{planned}/{shard}.csv", rows_in) for shard in of.names()}
    sizes = {shard: size for shard, size in counted.items() if size is not None}
    total = sum(sizes.values())
    if not total:
        return [f"{results}: nothing planned yet; run {of.command('poses')}"]
    good, rejected = poses_state(results, sizes, kept)
    solved, diverged, valid = fea_state(results, sizes, kept)
    held, unsound, left = forces_state(results, valid, kept)
    kept.keep()
    per_row = [(layout.POSES, good, rejected), (layout.FEA, solved, diverged), (layout.FORCES, held, unsound)]
    per_row += [
        (f"{layout.LABELS} {f.name}", shard_state(f, left), Counter()) for f in listed(results / layout.LABELS, "*x*")
    ]
    text = [
        f"{results.name}: {total} rows of the log in {len(sizes)} shards",
        f"{'stage':20s} {'done':>7s} {'failed':>7s} {'pending':>7s}",
    ]
    for name, done, failed in per_row:
        bad = failed.total()
        # what a stage before lost never comes to this one
        lost = sum(before.total() for stage, _, before in per_row[:3] if stage < name)
        text.append(f"{name:20s} {done:7d} {bad:7d} {max(total - done - bad - lost, 0):7d}")
        text += [f"    {count:6d} x {reason}" for reason, count in failed.most_common()]
    return text + whole_lines(results, broken, meshes)


def whole_lines(results: Path, broken: Collection[str], meshes: Collection[str] | None) -> list[str]:
    """What there is of stages that work on all samples at once, and what makes it where there is nothing."""
    text = []
    for kind, pattern, target in (
        (layout.MESHES, "*.npz", "meshes"),
        (layout.DATASET, "*/dataset.json", "dataset"),
        (layout.TRAIN, "*/*.onnx", "train"),
        (layout.EVALUATE, "*/*.json", "evaluate"),
        (layout.REPORT, "index.html", "report"),
        (layout.CALIBRATE, "summary.json", "calibrate"),
        (layout.PARETO, "*.json", "pareto"),
    ):
        there = listed(results / kind, pattern)
        found = [str(p.relative_to(results / kind)) for p in there]
        absent = f"not made ({Layout(results).command(target)})"
        if kind in broken:
            absent = "not made, because it failed: see below"
        elif kind == layout.MESHES and meshes is not None and not meshes:
            absent = "none needed: hexahedra have no file"
        text.append(f"{kind:20s} {', '.join(found) or absent}")
    return text


def outdated_lines(asked: list[LastRun]) -> list[str]:
    """The first target that what it was made of changed since, and what that was; nothing where all is as it was made."""
    old = changed_since((run.target, run.inputs) for run in asked)
    first = next((run for run in asked if run.target in old), None)
    if first is None:
        return []
    why = causes(old)
    more = f" and {len(why) - 2} more" if len(why) > 2 else ""
    return [f"outdated: {first.name} and what follows from it, because {', '.join(why[:2])}{more} changed since"]


def failed_lines(results: Path, failed: list[LastRun]) -> list[str]:
    """Targets whose last run failed, by stage and by what the log says last; the log named is the first one's."""
    alike: dict[tuple[str, str], list[tuple[LastRun, Path]]] = {}
    for run in failed:
        said, log = last_words_of(results, run)
        alike.setdefault((run.stage, said), []).append((run, log))
    return [
        f"failed: {of[0][0].name}{f' and {len(of) - 1} more' if len(of) > 1 else ''}: {said}; log: {of[0][1]}"
        for (_, said), of in alike.items()
    ]


def cost_lines(results: Path, known: list[LastRun]) -> list[str]:
    """Processor time and memory of each stage so far."""
    if not known:
        return []
    head = f"{'cost so far':20s} {'processor':>12s} {'largest MiB':>12s}"
    found = sorted(stages(results, {run.name: run.record for run in known}), key=lambda stage: stage["name"])
    return [head, *(f"{of['name']:20s} {duration(of['cpu_seconds']):>12s} {of['peak_mib']:12.0f}" for of in found)]


def running_lines(results: Path) -> list[str]:
    """How far the run that is going on has come; nothing where none is."""
    return [f"running: {look(results)}"] if running_targets(results) else []


@command(
    RESULTS,
    option("--meshes", nargs="*", default=None, help="meshes that presses may use"),
)
def main(args: Namespace) -> None:
    results, known = args.results, last_runs(args.results)
    asked = still_asked(results, known, args.meshes)
    failed = failures(results, asked)
    text = [
        *lines(results, {run.stage for run in failed}, args.meshes),
        *outdated_lines(asked),
        *failed_lines(results, failed),
        *cost_lines(results, known),
        *running_lines(results),
    ]
    print("\n".join(map(printable, text)))


if __name__ == "__main__":
    main.exit()
