"""No process outlives the one that began it."""

import ctypes
import os
import signal
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.context import BaseContext

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h


def die_with_parent(number: signal.Signals = signal.SIGTERM) -> None:
    """Make the kernel end this process by a signal when its parent dies, so that kill -9 of make leaves no orphans."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, number)


def adopt_orphans() -> None:
    """Make processes that lose their parent below this one its children, so that it can wait for them and knows what they cost."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, 1)


def end_with(maker: int) -> None:
    """End this process when the one of that number, which made it, ends; now where that was faster."""
    die_with_parent()
    if os.getppid() != maker:
        os.kill(os.getpid(), signal.SIGTERM)


def pool(workers: int, context: "BaseContext | None" = None) -> "ProcessPoolExecutor":
    """A pool of processes, forked or spawned, that end with this one, however it ends.

    Those of a plain pool wait for work for ever when this process is killed, and hold open what it writes to: a make that
    follows its output waits with them.
    """
    from concurrent.futures import ProcessPoolExecutor  # every step imports this module, and needs no pool

    return ProcessPoolExecutor(workers, context, initializer=end_with, initargs=(os.getpid(),))
