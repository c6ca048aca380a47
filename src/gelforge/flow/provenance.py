"""Where one sample's label comes from: every file, parameter and cost, from the records that the flow leaves.

Only the standard library: an answer takes a fraction of a second for 15 000 samples.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gelforge.errors import BadInput, printable
from gelforge.flow.cache import record_of
from gelforge.flow.files import read_csv
from gelforge.flow.layout import Layout, metrics_of


@dataclass(frozen=True)
class Step:
    """One target on the way to a label: its file, what it read, its cost, and what it was made with."""

    target: str
    inputs: list[str]
    seconds: float
    cpu_seconds: float
    peak_mib: float
    started: float
    parameters: dict
    programs: dict[str, str]  # versions


def belongs(path: str, results: Path, shards: set[str], shard: str) -> bool:
    """Whether a prerequisite concerns the sample: files of other shards do not."""
    stem = Path(path).stem
    return Path(path).is_relative_to(results) and (stem == shard or stem not in shards)


def steps_of_label(results: Path, shard: str, resolution: str) -> list[Step]:
    """The steps that led to a shard's labels, first one first, each once.

    Asked for target by target: a label of very many shards names none of them, and one that is not there yet leads to none.
    """
    of = Layout(results)
    paths = (of.poses(shard), of.fea(shard), of.forces(shard), of.labelled(resolution))
    return list({step.target: step for path in paths for step in steps_to(results, str(path), shard)}.values())


def pose_of(results: Path, shard: str, sample_id: str) -> dict:
    """The sample's row of the pose table, empty where there is none."""
    table = Layout(results).poses(shard)
    if not table.exists():
        return {}
    with table.open(newline="", encoding="utf-8") as stream:
        return next((row for row in csv.DictReader(stream) if row["sample_id"] == sample_id), {})


def imported_labels(results: Path, resolution: str) -> Path | None:
    """The labels that a dataset came with at a resolution, in place of solves of its own; None where it came with none."""
    folder = Path("data") / results.name / "labels"
    return folder / f"{resolution}.npz" if folder.is_dir() else None


def rejections_of(results: Path, shard: str, sample_id: str) -> list[str]:
    """Why stage 10 rejected a sample's row of the log, and what to do, one sentence a cell; none where it has a pose.

    A row that gives a name a second time is rejected too, and its sample goes on with the first.
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


def refuse_rejected(results: Path, shard: str, sample_id: str) -> None:
    """BadInput with the reasons for a sample whose row of the log stage 10 rejected."""
    if rejected := rejections_of(results, shard, sample_id):
        command = Layout(results).command("labels")
        raise BadInput(
            f"sample {sample_id} was rejected and gets no label: {'. '.join(rejected)}; then run {command}"
        )


def concerning(parameters: dict[str, dict], pose: dict) -> dict[str, dict]:
    """Parameter files without the entries of the catalogues that are of other indenters and sensors."""
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
