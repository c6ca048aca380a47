"""How far a run has come: presses done of all, rate, time left, and what runs now, from what lies on disk.

Only the standard library, because every step of a run asks for it.
"""

import fcntl
import time
from dataclasses import dataclass
from pathlib import Path

from gelforge.flow.files import below, made_at, names_in, read_csv
from gelforge.flow.kept import Kept
from gelforge.flow.layout import FEA, MESHES, POSES, Layout

RATE_OVER_S = 600.0
# What stages on the way to solved presses do with the log's rows; the others have no such number.
DOES = {POSES: "rows accepted", MESHES: "presses meshed", FEA: "presses solved"}


@dataclass(frozen=True)
class Progress:
    """Presses that a stage is done with of all that it can do, presses a second lately (0 where none), and what runs now.

    stage: one of DOES, or none where no stage with such a number is at work. rejected: rows that stage 10 rejected.
    """

    done: int
    total: int
    rate: float
    running: list[str]
    rejected: int = 0
    stage: str = FEA

    @property
    def pace(self) -> str:
        """Presses done of all; where some are done and some are left, how many a second and the time left."""
        if not self.total and self.rejected:
            return f"no press left, {self.rejected} rows rejected"
        if not self.total:
            return "no press is planned yet"
        said = f"{self.done} of {self.total} {DOES[self.stage]}"
        if not self.rate or self.done == self.total:
            return said
        left = duration((self.total - self.done) / self.rate)
        return f"{said}, {self.rate:.2g} a second, {left} left for solves"

    def __str__(self) -> str:
        """The pace where there is one, and what runs."""
        paced = self.pace if self.stage else ""
        if not self.running:
            return paced
        more = f" and {len(self.running) - 4} more" if len(self.running) > 4 else ""
        now = f"now: {', '.join(self.running[:4])}{more}"
        return f"{self.stage}: {paced}; {now}" if paced else now


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


def look(results: Path, now: float | None = None, stage: str = "") -> Progress:
    """The state of a dataset's run: of a stage, else of the latest that runs; of the solves where nothing runs."""
    running = running_targets(results)
    stages = [stage] if stage else [target.split("/")[0] for target in running] or [FEA]
    stage = max((name for name in stages if name in DOES), default="")
    if not stage:
        return Progress(0, 0, 0.0, running, stage="")
    now, of = time.time() if now is None else now, Layout(results)
    kept, planned, poses = Kept(of.counts), of.shards, of.folder(POSES)
    rows = {shard: kept.of(f"{planned}/{shard}.csv", rows_in) for shard in of.names()}
    sizes = {shard: size for shard, size in rows.items() if size is not None}
    bad = {s: min(size, kept.of(f"{poses}/{s}.rejected.csv", rejected_in) or 0) for s, size in sizes.items()}
    kept.keep()
    left, rejected = {shard: size - bad[shard] for shard, size in sizes.items()}, sum(bad.values())
    total, rate = sum(left.values()), 0.0
    if stage == FEA:
        done, rate = solves(
            of, left, now, {target.split("/")[1] for target in running if target.startswith(f"{FEA}/")}
        )
    else:
        done = sum(size for shard, size in left.items() if is_made(of, stage, shard))
        total += rejected if stage == POSES else 0
    return Progress(min(done, total), total, rate, running, rejected, stage)


def is_made(of: Layout, stage: str, shard: str) -> bool:
    """Whether a shard's table of stage 10 or 20 is as new as what it is made from."""
    table, source, name = (
        (of.poses(shard), of.shard(shard), "poses")
        if stage == POSES
        else (of.mesh_table(shard), of.poses(shard), "meshes")
    )
    since = max(made_at(path) or 0.0 for path in (source, of.params / f"{name}.json"))
    return made_since(str(table), since) is not None


def solves(of: Layout, sizes: dict[str, int], now: float, busy: set[str]) -> tuple[int, float]:
    """Presses solved of shards of these sizes, and how many a second lately. busy: shards that are being solved."""
    solved, lately = 0, []
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
    return solved, len(lately) / span if span > 1 else 0.0
