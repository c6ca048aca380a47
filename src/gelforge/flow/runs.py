"""Answers from the records of all targets: progress, failures, changes since, costs, and the provenance of a label.

The wrapper (`step`) writes a record, metrics/STAGE/NAME.json, of each target's last run. This module imports only the
standard library: an answer takes a fraction of a second for 15 000 samples.
"""

import csv
import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelforge.errors import printable
from gelforge.flow.files import below, changed, last_line, read_csv, record_of, states_of
from gelforge.flow.layout import OF_SHARDS, PLAN, Layout, dataset_folder, metrics_of

PROGRAMS = ("gelforge", "numpy", "scipy", "numba", "torch")  # on which the results depend
COST = ("seconds", "cpu_seconds", "peak_mib")
ASKED: dict[str, type | tuple[type, ...]] = {  # keys of a record that are read, with their types
    "target": str,
    "exit_code": int,
    "interrupted": bool,
    "inputs": dict,
    "counts": dict,
    "started": (int, float),
    **dict.fromkeys(COST, (int, float)),
}


def duration(seconds: float) -> str:
    """A duration in words, in s, min or h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


@dataclass(frozen=True)
class LastRun:
    """The last run of one target: its name below results/DATASET without suffix, such as 30_fea/0000, and its record."""

    name: str
    record: dict

    @property
    def stage(self) -> str:
        """The target's stage."""
        return self.name.split("/")[0]

    @property
    def failed(self) -> bool:
        """Whether the run ended with an error; a run that a person stopped does not count as failed."""
        return bool(self.record.get("exit_code")) and not self.record.get("interrupted")

    @property
    def target(self) -> str:
        """The file that it made, "" if the record does not name it."""
        return self.record.get("target", "")

    @property
    def done(self) -> int:
        """Number of samples that its command reported as done."""
        return int(self.record.get("counts", {}).get("done", 0))

    @property
    def lost(self) -> dict[str, int]:
        """How many samples failed in it, by reason."""
        return dict(self.record.get("counts", {}).get("failed", {}))


def last_runs(results: Path) -> list[LastRun]:
    """Last runs of all targets, in the order of their names."""
    of = Layout(results)
    root = f"{of.metrics}/"
    records = ((path[len(root) : -len(".json")], read_run(path)) for path in below(of.metrics, ".json"))
    return [LastRun(name, record) for name, record in records if record is not None and not name.startswith(PLAN)]


def read_run(path: str) -> dict | None:
    """The keys ASKED of a target's record, but those missing or of another type; None if it cannot be read."""
    try:
        with open(path, "rb") as stream:
            record = json.loads(stream.read())
    except (OSError, ValueError):
        return None
    if not isinstance(record, dict):
        return None
    return {key: record[key] for key, kind in ASKED.items() if isinstance(record.get(key), kind)}


def still_asked(results: Path, known: Iterable[LastRun]) -> list[LastRun]:
    """Runs whose targets make still knows, without those of shards that are no longer planned."""
    shards = set(Layout(results).names())
    return [run for run in known if run.stage not in OF_SHARDS or run.name.split("/")[-1] in shards]


def costs_of(known: list[LastRun]) -> dict[str, dict]:
    """Records by target name, of runs whose record holds the cost and the start."""
    return {run.name: run.record for run in known if {"started", *COST} <= run.record.keys()}


def stages(results: Path, costs: Mapping[str, Mapping]) -> list[dict]:
    """Stages in the order they ran: name, targets, seconds, cpu_seconds, peak_mib, and the stages that each reads."""
    found: dict[str, dict] = {}
    for target, cost in sorted(costs.items(), key=lambda item: item[1].get("started", 0.0)):
        name = target.split("/")[0]
        stage = found.setdefault(name, {"name": name, "targets": 0, **dict.fromkeys(COST, 0.0), "reads": set()})
        stage["targets"] += 1
        for kind in ("seconds", "cpu_seconds"):
            stage[kind] += cost.get(kind, 0.0)
        stage["peak_mib"] = max(stage["peak_mib"], cost.get("peak_mib", 0.0))
        start = f"{results}/"
        stage["reads"] |= {
            path[len(start) :].split("/")[0] for path in cost.get("inputs", ()) if path.startswith(start)
        }
    return [stage | {"reads": sorted(stage["reads"] - {PLAN, stage["name"]})} for stage in found.values()]


def changes(target: str | Path, record: Mapping[str, Any] | None = None) -> list[str]:
    """Inputs of a target whose content has changed since; missing ones do not count, because make makes them anyway.

    record: that of the target, if it is known.
    """
    made = record_of(metrics_of(Path(target))) if record is None else record
    known = {
        path: state for path, state in (made or {}).get("inputs", {}).items() if state and os.access(path, os.F_OK)
    }
    return changed(known, states_of(known, known))


def causes(paths: Iterable[str]) -> list[str]:
    """Changed inputs in words, each once: those that no target makes or, if there are none, the others."""
    inputs = list(dict.fromkeys(paths))
    given = [path for path in inputs if dataset_folder(Path(path)) is None or f"/{PLAN}/" in path]
    return list(dict.fromkeys(named(path) for path in given or inputs))


def named(path: str) -> str:
    """What an input file holds, in words."""
    name = Path(path).stem
    if f"/{PLAN}/params/" in path:
        return f"parameters of {name}"
    if f"/{PLAN}/shards/" in path:
        return f"rows of the log in shard {name.split('.')[0]}, or their pictures,"
    return path


def last_words_of(results: Path, run: LastRun) -> tuple[str, Path]:
    """The last line of a failed target's log, and the path of the log."""
    log = Layout(results).logs / f"{run.name}.log"
    said = last_line(log) if log.exists() else ""
    return said or f"ended with code {run.record['exit_code']} without a message", log


def installed(programs: Iterable[str] = PROGRAMS) -> dict[str, str]:
    """Version of each installed program, by its name at PyPI."""
    from importlib.metadata import PackageNotFoundError, version

    found = {}
    for program in programs:
        with suppress(PackageNotFoundError):
            found[program] = version(program)
    return found


# -- provenance of one sample's label


@dataclass(frozen=True)
class Step:
    """One target on the way to a label: its file, its inputs, its cost, and its parameters and program versions."""

    target: str
    inputs: list[str]
    seconds: float
    cpu_seconds: float
    peak_mib: float
    started: float
    parameters: dict
    programs: dict[str, str]  # versions


def belongs(path: str, results: Path, shards: Collection[str], shard: str) -> bool:
    """Whether an input concerns the samples of a shard: files of other shards do not, nor those outside `results`."""
    stem = Path(path).name.split(".")[0]
    return Path(path).is_relative_to(results) and (stem == shard or stem not in shards)


def steps_of_label(results: Path, shard: str, resolution: str) -> list[Step]:
    """The steps that led to a shard's labels, in order, each once; if labels are missing, the steps made so far."""
    of = Layout(results)
    paths = (of.poses(shard), of.images(), of.fea(shard), of.forces(shard), of.labels(resolution, shard))
    return list({step.target: step for path in paths for step in steps_to(results, str(path), shard)}.values())


def pose_of(results: Path, shard: str, sample_id: str) -> dict:
    """The sample's row of the pose table, empty if there is none."""
    table = Layout(results).poses(shard)
    if not table.exists():
        return {}
    with table.open(newline="", encoding="utf-8") as stream:
        return next((row for row in csv.DictReader(stream) if row["sample_id"] == sample_id), {})


def rejections_of(results: Path, shard: str, sample_id: str) -> list[str]:
    """Why stage 10 rejected a sample's row of the log, and what to do, one sentence per cell; none if it has a pose.

    If two rows have the same sample_id, the second is rejected, and the sample keeps the pose of the first.
    """
    table = Layout(results).rejected(shard)
    if not table.exists() or pose_of(results, shard, sample_id):
        return []
    wrong = [cells for cells in read_csv(table) if cells.get("sample_id") == sample_id]
    return [
        printable(
            f"row {cells.get('row')} of the log: {cells.get('column')} = {cells.get('value')!r}: {cells.get('reason')};"
            f" {cells.get('hint')}"
        )
        for cells in wrong
    ]


def concerning(parameters: dict[str, dict], pose: dict) -> dict[str, dict]:
    """Parameter files without the catalogue entries of other indenters and sensors."""
    of = {"indenters": pose.get("indenter"), "sensors": pose.get("sensor_id")}
    return {
        name: {of[name]: values[of[name]]} if of.get(name) in values else values
        for name, values in parameters.items()
    }


def steps_to(results: Path, target: str, shard: str) -> Iterator[Step]:
    """Targets on the way to `target` that concern a shard's samples, prerequisites first, each once."""
    shards, params = set(Layout(results).names()), Layout(results).params
    seen: set[str] = set()

    def walk(name: str) -> Iterator[Step]:
        if name in seen:
            return
        seen.add(name)
        record = record_of(metrics_of(Path(name)))
        if not record:
            return
        inputs = [path for path in record.get("inputs", []) if belongs(path, results, shards, shard)]
        for path in inputs:
            yield from walk(path)
        parameters = {
            Path(path).stem: record_of(Path(path)) or {} for path in inputs if Path(path).is_relative_to(params)
        }
        costs = {key: record.get(key, 0.0) for key in ("seconds", "cpu_seconds", "peak_mib", "started")}
        yield Step(name, inputs, **costs, parameters=parameters, programs=record.get("programs", {}))

    yield from walk(target)
