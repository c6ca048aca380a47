"""What is known of work on Slurm: a record per stage, the results seen, and how both are shown to a person."""

import os
import sys
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from gelforge.flow.files import listed, read_csv, read_json, write_json
from gelforge.flow.layout import Layout, log_of, metrics_of
from gelforge.flow.running import DOES, look
from gelforge.flow.step import TAIL_LINES
from gelforge.flow.terminal import show_line, terminal

SAY_EVERY_S = 30.0  # where make has no terminal


@dataclass
class Task:
    """One target and what became of it: state is queued, running, done or failed."""

    target: str
    command: str
    memory_mb: int
    minutes: int
    state: str = "queued"
    reason: str = ""
    runs: int = 0
    where: str = ""


@dataclass
class Batch:
    """One job array; its index k (from 1) runs the tasks numbered groups[k - 1]."""

    name: str
    job: str
    groups: list


@dataclass
class Record:
    """The work of one stage: closed when every task is done or failed."""

    path: Path
    stage: str
    tasks: list = field(default_factory=list)
    batches: list = field(default_factory=list)
    closed: bool = False

    @property
    def folder(self) -> Path:
        """Task lists and Slurm's own output of this work."""
        return self.path.with_name(f"{self.path.name}.d")

    @property
    def results(self) -> Path:
        """results/DATASET, of which this is a stage's work."""
        return self.path.parents[1]

    def save(self) -> None:
        """Write the record, whole or not at all."""
        write_json(self.path, {key: value for key, value in asdict(self).items() if key != "path"})

    def open_tasks(self) -> list[Task]:
        """Tasks neither done nor failed."""
        return [task for task in self.tasks if task.state in ("queued", "running")]

    def accepted(self) -> bool:
        """Whether Slurm has taken every task."""
        return all(task.where for task in self.tasks) and all(batch.job for batch in self.batches)

    def open_batches(self) -> list[Batch]:
        """Job arrays with a task neither done nor failed."""
        names = {task.where.rpartition("/")[0] for task in self.open_tasks()}
        return [batch for batch in self.batches if batch.name in names]


def load(path: Path) -> Record:
    """Read a record."""
    raw = read_json(path)
    tasks, batches = [Task(**t) for t in raw["tasks"]], [Batch(**b) for b in raw["batches"]]
    for batch in batches:
        batch.job = batch.job if batch.job.isdecimal() else ""  # older code took any word of sbatch's answer for it
    return Record(path, raw["stage"], tasks, batches, raw["closed"])


def records(results: Path) -> list[Record]:
    """All records of a dataset's results."""
    return [load(path) for path in listed(results / ".slurm", "*.json")]


class Results:
    """Which targets are there, by listing folders: that refreshes a network file system's cache."""

    def __init__(self) -> None:
        self.names: dict[str, set[str]] = {}

    def look(self, folders: set[str]) -> None:
        """List folders anew."""
        self.names = {}
        for folder in folders:
            try:
                self.names[folder] = set(os.listdir(folder or "."))
            except FileNotFoundError:
                self.names[folder] = set()

    def there(self, target: str) -> bool:
        """Whether a target was listed and has the bytes the wrapper published, by its metrics."""
        folder, name = os.path.split(target)
        if name not in self.names.get(folder, ()):
            return False
        try:
            made = read_json(metrics_of(Path(target)))
            whole = 0 < os.stat(target).st_size == made.get("bytes")
            if whole:
                date_here(target, made.get("read", {}))
        except (FileNotFoundError, ValueError):
            return False
        return whole


def date_here(target: str, read: Mapping[str, int]) -> None:
    """Date a target by this machine's clock where that of its node is ahead of it, or behind what the target was made of.

    make compares dates. read: when each input had been written, ns, as the node saw it; where one changed since, a target
    that is dated ahead is due again.
    """
    made, inputs = os.stat(target).st_mtime_ns, [os.stat(path).st_mtime_ns for path in read]
    same = inputs == list(read.values())
    if same and inputs and (made > time.time_ns() or made < max(inputs)):
        os.utime(target)
    elif not same and made > time.time_ns():
        os.utime(target, ns=(1, 1))


def tail(path: Path, count: int = TAIL_LINES) -> list[str]:
    """Last lines of a text file, none where it is absent."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").splitlines()[-count:]
    except FileNotFoundError:
        return []


def counted(record: Record) -> str:
    """Tasks by state."""
    states = Counter(task.state for task in record.tasks)
    return ", ".join(f"{states[name]} {name}" for name in ("queued", "running", "done", "failed"))


def progress(record: Record, silent: bool) -> str:
    """How far a stage's work on Slurm has come, and the whole dataset's run with it; silent: no controller answers."""
    why = Counter(task.reason for task in record.tasks if task.state == "queued" and task.reason not in ("", "None"))
    note = "the controller does not answer" if silent else why.most_common(1)[0][0] if why else ""
    said = f"{record.stage} on Slurm: {counted(record)}" + (f" ({note})" if note else "")
    return f"{said} | {look(record.results, stage=record.stage).pace}" if record.stage in DOES else said


def show(record: Record, said: float, silent: bool) -> float:
    """Say how far the work has come: on make's terminal always, as a line now and then elsewhere."""
    device = terminal()
    if device is not None:
        show_line(device, progress(record, silent))
    elif time.monotonic() - said > SAY_EVERY_S:
        print(progress(record, silent), file=sys.stderr, flush=True)
        return time.monotonic()
    return said


def unfinished_samples(target: Path) -> list[str]:
    """Samples of a shard that have no file of their own yet, where a stage writes one per sample."""
    folder, shard = target.with_suffix(""), Layout(target.parents[1]).shard(target.stem)
    if not folder.is_dir() or not shard.exists():
        return []
    there = {path.stem for path in (*listed(folder, "*.json"), *listed(folder, "*.stl"))}
    return [row["sample_id"] for row in read_csv(shard) if row["sample_id"] not in there]


def report(record: Record, most: int = 5) -> int:
    """Print what failed, why, and the end of its log; return an exit code."""
    failed = [task for task in record.tasks if task.state == "failed"]
    if device := terminal():
        show_line(device)
    for task in failed[:most]:
        name, _, index = task.where.rpartition("/")
        job = next((batch.job for batch in record.batches if batch.name == name), "")
        output, log = record.folder / name / f"{index}.out", log_of(Path(task.target))
        print(f"FAILED {task.target}: {task.reason}; Slurm job {job}_{index}, run {task.runs}")
        samples = unfinished_samples(Path(task.target))
        if samples:
            print(f"  unfinished samples: {', '.join(samples[:5])} ({len(samples)} in all)")
        # The wrapper's last words are in Slurm's output; a killed one said none.
        lines = tail(output)
        for path in [output] if any(line.startswith("FAILED ") for line in lines) else [output, log]:
            print(f"  {path}:", *(f"  | {line}" for line in tail(path)), sep="\n")
    if len(failed) > most:
        print(f"… and {len(failed) - most} more; {Layout(record.results).command('status')} lists them")
    print(f"{record.stage} on Slurm: {counted(record)}", flush=True)
    return 1 if failed else 0
