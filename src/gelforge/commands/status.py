"""Samples of a dataset that are done, failed (with reasons) and pending, by stage, from the records of targets."""

from argparse import Namespace
from collections import Counter
from collections.abc import Collection
from pathlib import Path

from gelforge.errors import printable
from gelforge.flow import layout
from gelforge.flow.cli import RESULTS, command
from gelforge.flow.files import listed, record_of
from gelforge.flow.layout import Layout, metrics_of
from gelforge.flow.runs import (
    LastRun,
    causes,
    changes,
    duration,
    last_runs,
    last_words_of,
    stages,
    still_asked,
)

# Only imports of the standard library, so that status of 15 000 samples takes a fraction of a second.

ONE_BY_ONE = (layout.POSES, layout.FEA, layout.FORCES)  # stages that record the outcome of each sample


def lines(results: Path, asked: list[LastRun]) -> list[str]:
    """The table that `make status` prints. asked: last runs of targets that make still knows."""
    of = Layout(results)
    planned = (record_of(metrics_of(of.plan())) or {}).get("counts", {})
    total = int(planned.get("rows", 0))
    if not total:
        return [f"{results}: nothing planned yet; run {of.command('poses')}"]
    done: Counter[str] = Counter()
    lost: dict[str, Counter[str]] = {name: Counter() for name in ONE_BY_ONE}
    for run in asked:
        stage = run.name.rpartition("/")[0].replace("/", " ")
        if run.stage in ONE_BY_ONE or run.stage == layout.LABELS:
            done[stage] += run.done
            lost.setdefault(stage, Counter()).update(run.lost)
    text = [
        f"{results.name}: {total} rows of the log in {planned['shards']} shards",
        f"{'stage':20s} {'done':>7s} {'failed':>7s} {'pending':>7s}",
    ]
    for name, failed in sorted(lost.items()):
        # samples lost in an earlier stage never reach this one
        gone = sum(lost[before].total() for before in ONE_BY_ONE if before < name)
        pending = max(total - done[name] - failed.total() - gone, 0)
        text.append(f"{name:20s} {done[name]:7d} {failed.total():7d} {pending:7d}")
        text += [f"    {count:6d} x {reason}" for reason, count in failed.most_common()]
    return text + whole_lines(results, {run.stage for run in asked if run.failed})


def whole_lines(results: Path, broken: Collection[str]) -> list[str]:
    """Results of the stages that work on all samples at once, or the command that makes them."""
    text = []
    for kind, pattern, target in (
        (layout.IMAGES, "images.json", "images"),
        (layout.DATASET, "*/dataset.json", "dataset"),
        (layout.TRAIN, "*/*.onnx", "train"),
        (layout.EVALUATE, "*/*.json", "evaluate"),
        (layout.REPORT, "*.html", "report"),
        (layout.CALIBRATE, "summary.json", "calibrate"),
        (layout.PARETO, "*.json", "pareto"),
    ):
        found = [str(p.relative_to(results / kind)) for p in listed(results / kind, pattern)]
        absent = f"not made ({Layout(results).command(target)})"
        if kind in broken:
            absent = "not made, because it failed: see below"
        text.append(f"{kind:20s} {', '.join(found) or absent}")
    return text


def outdated_lines(asked: list[LastRun]) -> list[str]:
    """The first target whose inputs changed since it was made, and these inputs; empty where none changed."""
    for run in asked:
        if run.target and (why := causes(changes(run.target, run.record))):
            more = f" and {len(why) - 2} more" if len(why) > 2 else ""
            return [
                f"outdated: {run.name} and what follows from it, because {', '.join(why[:2])}{more} changed since it was made"
            ]
    return []


def failed_lines(results: Path, asked: list[LastRun]) -> list[str]:
    """Targets whose last run failed, grouped by stage and last line of the log; the first one's log is named."""
    alike: dict[tuple[str, str], list[tuple[LastRun, Path]]] = {}
    for run in asked:
        if run.failed:
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


@command(RESULTS)
def main(args: Namespace) -> None:
    results, known = args.results, last_runs(args.results)
    asked = still_asked(results, known)
    text = [
        *lines(results, asked),
        *outdated_lines(asked),
        *failed_lines(results, asked),
        *cost_lines(results, known),
    ]
    print("\n".join(map(printable, text)))


if __name__ == "__main__":
    main.exit()
