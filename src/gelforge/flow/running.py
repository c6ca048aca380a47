"""How far a run has come: presses solved of all, rate, time left, and what runs now, from what lies on disk.

Only the standard library, because every step of a run asks for it.
"""

import csv
import fcntl
import time
from dataclasses import dataclass
from pathlib import Path

RATE_OVER_S = 600.0
SOLVES = "30_fea"


@dataclass(frozen=True)
class Progress:
    """Presses solved of all planned, presses a second lately (0 where none was), and the targets that run now."""

    solved: int
    total: int
    rate: float
    running: list[str]

    @property
    def stage(self) -> str:
        """The stage that runs now, the latest of them; nothing where none does."""
        return max((target.split("/")[0] for target in self.running), default="")

    def __str__(self) -> str:
        said = [f"{self.solved} of {self.total} presses solved"]
        if self.rate and self.solved < self.total:
            said += [
                f"{self.rate:.2g} a second",
                f"{duration((self.total - self.solved) / self.rate)} left for solves",
            ]
        if not self.running:
            return ", ".join(said)
        more = f" and {len(self.running) - 4} more" if len(self.running) > 4 else ""
        return f"{self.stage}: {', '.join(said)}; now: {', '.join(self.running[:4])}{more}"


def duration(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def planned(results: Path) -> dict[str, int]:
    """Samples of each planned shard."""
    table = results / "00_plan" / "shards.csv"
    if not table.exists():
        return {}
    names = {int(path.stem): path.stem for path in (results / "00_plan" / "shards").glob("*.csv")}
    sizes = dict.fromkeys(names.values(), 0)
    with table.open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            if int(row["shard"]) in names:
                sizes[names[int(row["shard"])]] += 1
    return sizes


def running_targets(results: Path) -> list[str]:
    """Targets that a step holds the lock of, below results/DATASET without suffix."""
    found = []
    for path in sorted((results / "logs").rglob("*.lock")):
        record = results / "metrics" / path.relative_to(results / "logs").with_suffix(".json")
        # Most locks are of targets made long ago: a record that is newer than the lock says so without opening it.
        if record.exists() and record.stat().st_mtime >= path.stat().st_mtime:
            continue
        if is_held(path):
            found.append(str(path.relative_to(results / "logs").with_suffix("")))
    return found


def is_held(path: Path) -> bool:
    """Whether another process holds a lock file."""
    try:
        with path.open("r") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def look(results: Path, now: float | None = None) -> Progress:
    """The state of a dataset's run."""
    now = time.time() if now is None else now
    sizes, solved, lately = planned(results), 0, []
    running = running_targets(results)
    busy = {target.split("/")[1] for target in running if target.startswith(f"{SOLVES}/")}
    for shard, size in sizes.items():
        folder = results / SOLVES / shard
        if shard not in busy and (results / SOLVES / f"{shard}.csv").exists():
            solved += size
            made = (results / SOLVES / f"{shard}.csv").stat().st_mtime
            if now - made > RATE_OVER_S:
                continue
        times = [path.stat().st_mtime for path in folder.glob("*.json")] if folder.exists() else []
        if shard in busy or not (results / SOLVES / f"{shard}.csv").exists():
            solved += len(times)
        lately += [made for made in times if now - made <= RATE_OVER_S]
    span = now - min(lately) if lately else 0.0
    return Progress(
        min(solved, sum(sizes.values())), sum(sizes.values()), len(lately) / span if span > 1 else 0.0, running
    )
