"""One make at a time on the results of a dataset, on whatever machine it runs."""

import fcntl
import os
import select
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from gelforge.flow.files import take
from gelforge.flow.slurm.client import STOP


@contextmanager
def at_work(results: Path, kind: int = fcntl.LOCK_SH) -> Iterator[None]:
    """Hold the lock that every process at work for a make shares."""
    with (results / ".slurm" / "work").open("a") as lock:
        take(lock, kind)
        yield


def called(process: int) -> str:
    """What a process is called that no other one is: its number alone another machine or container may have, too."""
    return f"{process} of {os.stat('/proc/self/ns/pid').st_ino} on {os.uname().nodename}"


def become_only_make(results: Path, make: int) -> IO[str] | None:
    """Return the open lock file of these results once no other make holds it; None if `make` holds it already.

    From then on the signals that stop make are blocked: they are received while waiting, see `pause`.
    """
    folder = results / ".slurm"
    folder.mkdir(parents=True, exist_ok=True)
    lock = (folder / "lock").open("a+")
    try:
        take(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.seek(0)
        if lock.read() == called(make):  # make reads its files again after it made one of them
            return None
        print(f"another make is at work on {results} with Slurm; awaiting it", file=sys.stderr, flush=True)
        take(lock, fcntl.LOCK_EX)
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)
    lock.truncate(0)
    lock.write(called(make))
    lock.flush()
    with at_work(results, fcntl.LOCK_EX):
        pass  # a make that was killed leaves a process behind that is still cancelling
    return lock


def hold(lock: IO[str], make: int) -> None:
    """Keep `lock` in a process of its own until the process `make` ends."""
    if os.fork():
        return
    os.setsid()
    os.chdir("/")
    null = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(null, number)
    # What make handed down (its job slots, output files) must close when make does.
    os.closerange(3, lock.fileno())
    os.closerange(lock.fileno() + 1, 65536)
    await_end(make)
    os._exit(0)


def await_end(process: int) -> None:
    """Return when a process has ended."""
    try:
        poll = select.poll()
        poll.register(os.pidfd_open(process), select.POLLIN)
        poll.poll()
    except ProcessLookupError:
        return
    except OSError:  # a kernel before 5.3
        while Path(f"/proc/{process}").exists():
            time.sleep(0.5)
