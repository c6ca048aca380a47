"""How far a run has come: presses solved of all, rate, time left, and what runs now, from what lies on disk.

Only the standard library, because every step of a run asks for it.
"""

import csv
import fcntl
import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from gelforge.flow.files import listed, made_at, read_csv, read_json, write_json
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

    def told(self, stages: Iterable[str] = ()) -> str:
        """The pace where these stages or those that run are on the way to solved presses, and what runs; "" where neither."""
        at_work = {*stages, *(target.split("/")[0] for target in self.running)}
        paced = self.pace if at_work & SOLVING else ""
        if not self.running:
            return paced
        more = f" and {len(self.running) - 4} more" if len(self.running) > 4 else ""
        now = f"now: {', '.join(self.running[:4])}{more}"
        return f"{self.stage}: {paced}; {now}" if paced else now

    def __str__(self) -> str:
        return self.told() if self.running else self.pace


def duration(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def running_targets(results: Path) -> list[str]:
    """Targets that a step holds the lock of, below results/DATASET without suffix."""
    found = []
    of = Layout(results)
    for path in listed(of.logs, "*.lock", below=True):
        target = path.relative_to(of.logs)
        # Most locks are of targets made long ago: a record that is newer than the lock says so without opening it.
        if (made_at(of.metrics / target.with_suffix(".json")) or 0.0) >= (made_at(path) or 0.0):
            continue
        if is_held(path):
            found.append(str(target.with_suffix("")))
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


def rejected_in(table: Path) -> int:
    """Rows of the log that a table of rejections names."""
    return len({cells.get("row") for cells in read_csv(table)})


def rows_in(table: Path) -> int:
    """Rows of a table."""
    return len(read_csv(table))


class Counted:
    """Numbers read from tables, kept in a file by the tables' times and sizes: each is read once, not at every look."""

    def __init__(self, kept: Path) -> None:
        self.kept = kept
        self.known: dict[str, object] = {}
        self.seen: dict[str, object] = {}
        with suppress(OSError, ValueError, AttributeError):  # none yet, or damaged: tables are read once more
            self.known = dict(read_json(kept).items())

    def number(self, table: Path, read: Callable[[Path], int]) -> int | None:
        """What `read` finds in a table; None where there is none, or it cannot be read."""
        try:
            state = os.stat(table)
            now = [state.st_mtime_ns, state.st_size]
            match self.known.get(str(table)):
                case [*before, int(number)] if before == now:
                    pass
                case _:
                    number = read(table)
        except (OSError, ValueError, csv.Error):
            return None
        self.seen[str(table)] = [*now, number]
        return number

    def keep(self) -> None:
        """Write what changed; where nothing can be written, tables are read again."""
        if self.seen != self.known:
            with suppress(OSError):
                write_json(self.kept, self.seen)


def made_since(path: Path, since: float) -> float | None:
    """When a file was last written; None where there is none, or one from before."""
    made = made_at(path)
    return made if made is not None and made >= since else None


def look(results: Path, now: float | None = None) -> Progress:
    """The state of a dataset's run."""
    now, of = time.time() if now is None else now, Layout(results)
    counted, solved, lately = Counted(of.counts), 0, []
    rows = {shard: counted.number(of.shard(shard), rows_in) for shard in of.names()}
    sizes = {shard: size for shard, size in rows.items() if size is not None}
    rejected = {s: min(size, counted.number(of.rejected(s), rejected_in) or 0) for s, size in sizes.items()}
    counted.keep()
    sizes = {shard: size - rejected[shard] for shard, size in sizes.items()}
    running = running_targets(results)
    busy = {target.split("/")[1] for target in running if target.startswith(f"{FEA}/")}
    for shard, size in sizes.items():
        # what other parameters or meshes solved is solved again, or found to be as asked when its table is written
        asked = (of.params / "fea.json", of.mesh_table(shard))
        since = max(made_at(path) or 0.0 for path in asked)
        table = None if shard in busy else made_since(of.fea(shard), since)
        if table is not None and now - table > RATE_OVER_S:
            solved += size
            continue
        # a sample that is solved anew may go between the listing and the look at it
        found = (made_since(path, since) for path in listed(of.solves(shard), "*.json"))
        times = [made for made in found if made is not None]
        solved += len(times) if table is None else size
        lately += [made for made in times if now - made <= RATE_OVER_S]
    span = now - min(lately) if lately else 0.0
    total, rate = sum(sizes.values()), len(lately) / span if span > 1 else 0.0
    return Progress(min(solved, total), total, rate, running, sum(rejected.values()))
