"""How far a run has come: presses solved of all, rate, time left, and what runs now, from what lies on disk.

Only the standard library, because every step of a run asks for it.
"""

import fcntl
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from gelforge.flow.files import below, made_at, names_in, read_csv
from gelforge.flow.kept import Kept
from gelforge.flow.layout import FEA, FORCES, MESHES, POSES, Layout

RATE_OVER_S = 600.0
# Stages on the way to solved presses; of those after them the count of solves tells nothing.
SOLVING = {POSES, MESHES, FEA, FORCES}


@dataclass(frozen=True)
class Progress:
    """Presses solved of all that can be, presses a second lately (0 where none was), and the targets that run now.

    rejected: planned rows that stage 10 rejected, which are no presses to solve.
    """

    solved: int
    total: int
    rate: float
    running: list[str]
    rejected: int = 0

    @property
    def stage(self) -> str:
        """The stage that runs now, the latest of them; nothing where none does."""
        return max((target.split("/")[0] for target in self.running), default="")

    @property
    def pace(self) -> str:
        """Presses solved of all; where some are solved and some are left, how many a second and the time left."""
        if not self.total and self.rejected:
            return f"no press to solve, {self.rejected} rows rejected"
        if not self.total:
            return "no press is planned yet"
        said = f"{self.solved} of {self.total} presses solved"
        if not self.rate or self.solved == self.total:
            return said
        left = duration((self.total - self.solved) / self.rate)
        return f"{said}, {self.rate:.2g} a second, {left} left for solves"

    def summary(self, stages: Iterable[str] = ()) -> str:
        """The pace where these stages or those that run are on the way to solved presses, and what runs; "" where neither."""
        at_work = {*stages, *(target.split("/")[0] for target in self.running)}
        paced = self.pace if at_work & SOLVING else ""
        if not self.running:
            return paced
        more = f" and {len(self.running) - 4} more" if len(self.running) > 4 else ""
        now = f"now: {', '.join(self.running[:4])}{more}"
        return f"{self.stage}: {paced}; {now}" if paced else now

    def __str__(self) -> str:
        return self.summary() if self.running else self.pace


def duration(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def running_targets(results: Path) -> list[str]:
    """Targets that a step holds the lock of, below results/DATASET without suffix."""
    of = Layout(results)
    start = len(f"{of.logs}/")
    names = (path[start : -len(".lock")] for path in below(of.logs, ".lock"))
    return [name for name in names if is_open(of, name) and is_held(of.logs / f"{name}.lock")]


def is_open(of: Layout, name: str) -> bool:
    """Whether a target may be at work: a record newer than its lock, as of most, says without a look at it that it is not."""
    return (made_at(f"{of.metrics}/{name}.json") or 0.0) < (made_at(f"{of.logs}/{name}.lock") or 0.0)


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


def rejected_in(table: Path) -> int:
    """Rows of the log that a table of rejections names."""
    return len({cells.get("row") for cells in read_csv(table)})


def rows_in(table: Path) -> int:
    """Rows of a table."""
    return len(read_csv(table))


def made_since(path: str, since: float) -> float | None:
    """When a file was last written; None where there is none, or one from before."""
    made = made_at(path)
    return made if made is not None and made >= since else None


def look(results: Path, now: float | None = None) -> Progress:
    """The state of a dataset's run."""
    now, of = time.time() if now is None else now, Layout(results)
    kept, planned, solved, lately = Kept(of.counts), of.shards, 0, []
    rows = {shard: kept.of(f"{planned}/{shard}.csv", rows_in) for shard in of.names()}
    sizes = {shard: size for shard, size in rows.items() if size is not None}
    poses = of.folder(POSES)
    bad = {s: kept.of(f"{poses}/{s}.rejected.csv", rejected_in) or 0 for s in sizes}
    kept.keep()
    rejected = {shard: min(size, bad[shard]) for shard, size in sizes.items()}
    sizes = {shard: size - rejected[shard] for shard, size in sizes.items()}
    running = running_targets(results)
    busy = {target.split("/")[1] for target in running if target.startswith(f"{FEA}/")}
    asked, fea, meshes = made_at(of.params / "fea.json") or 0.0, of.folder(FEA), of.meshes
    for shard, size in sizes.items():
        # what other parameters or meshes solved is solved again, or found to be as asked when its table is written
        since = max(asked, made_at(f"{meshes}/{shard}.csv") or 0.0)
        table = None if shard in busy else made_since(f"{fea}/{shard}.csv", since)
        if table is not None and now - table > RATE_OVER_S:
            solved += size
            continue
        # a sample that is solved anew may go between the listing and the look at it
        found = (made_since(f"{fea}/{shard}/{name}", since) for name in names_in(f"{fea}/{shard}", ".json"))
        times = [made for made in found if made is not None]
        solved += len(times) if table is None else size
        lately += [made for made in times if now - made <= RATE_OVER_S]
    span = now - min(lately) if lately else 0.0
    total, rate = sum(sizes.values()), len(lately) / span if span > 1 else 0.0
    return Progress(min(solved, total), total, rate, running, sum(rejected.values()))
