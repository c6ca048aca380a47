"""How far a run has come: shards done of all, the time left, and what runs now, from what lies on disk; a line on make's terminal.

Only the standard library, because every step of a run asks for it.
"""

import fcntl
import os
import shutil
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from gelforge.flow.files import below, made_at
from gelforge.flow.layout import FEA, FORCES, MESHES, PLAN, POSES, Layout

RATE_OVER_S = 600.0
# Stages of one file a shard: its parameters, the folder of the shard's file that it is made from, and its own suffix.
OF_SHARDS = {
    POSES: ("poses", f"{PLAN}/shards", ".csv"),
    MESHES: ("meshes", POSES, ".csv"),
    FEA: ("fea", POSES, ".csv"),
    FORCES: ("forces", FEA, ".npz"),
}


@dataclass(frozen=True)
class Progress:
    """Shards that a stage is done with of all, seconds left (None where unknown), and the targets that run now.

    stage: one of OF_SHARDS, or none where no such stage is at work.
    """

    stage: str
    done: int
    total: int
    left_s: float | None
    running: list[str]

    def __str__(self) -> str:
        """How far the stage is, and what runs."""
        said = []
        if self.stage and self.total:
            left = f", {duration(self.left_s)} left" if self.left_s else ""
            said.append(f"{self.stage}: {self.done} of {self.total} shards{left}")
        if self.running:
            more = f" and {len(self.running) - 4} more" if len(self.running) > 4 else ""
            said.append(f"now: {', '.join(self.running[:4])}{more}")
        return "; ".join(said)


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


def look(results: Path, now: float | None = None, stage: str = "") -> Progress:
    """The state of a dataset's run: of a stage, or else of the latest stage of shards that runs."""
    running = running_targets(results)
    stages = [stage] if stage else [target.split("/")[0] for target in running]
    stage = max((name for name in stages if name in OF_SHARDS), default="")
    if not stage:
        return Progress("", 0, 0, None, running)
    now, of, names = time.time() if now is None else now, Layout(results), Layout(results).names()
    done = [name for name in names if is_made(of, stage, name)]
    ended = (made_at(f"{of.metrics}/{stage}/{name}.json") for name in done)
    lately = [at for at in ended if at is not None and now - at <= RATE_OVER_S]
    span = now - min(lately) if lately else 0.0
    left = (len(names) - len(done)) * span / len(lately) if span > 1.0 else None
    return Progress(stage, len(done), len(names), left, running)


def is_made(of: Layout, stage: str, shard: str) -> bool:
    """Whether a shard's file is there and as new as its parameters and the file that it is made from."""
    params, source, suffix = OF_SHARDS[stage]
    made = made_at(f"{of.root}/{stage}/{shard}{suffix}")
    since = (made_at(of.params / f"{params}.json"), made_at(f"{of.root}/{source}/{shard}.csv"))
    return made is not None and all(made >= (at or 0.0) for at in since)


def terminal() -> str | None:
    """The device of the terminal make writes to; none where it writes to a file or a pipe."""
    # make names it here, or says `true` where it cannot tell.
    name = os.environ.get("MAKE_TERMERR", "")
    return name if name.startswith("/dev/") else None


def show_line(device: str, text: str = "") -> None:
    """Put a text in place of the line that is shown; nothing takes the line away."""
    width = shutil.get_terminal_size().columns - 1
    # The terminal may have been closed since.
    with suppress(OSError), open(device, "w", encoding="utf-8", errors="replace") as shown:
        shown.write("\r\033[K" + "".join(c for c in text if c.isprintable())[:width])
