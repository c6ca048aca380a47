"""Child processes that end with their parent and count against make's job slots (GNU make's manual, Job Slots)."""

import ctypes
import os
import re
import signal
import stat
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.context import BaseContext

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h


def die_with_parent(number: signal.Signals = signal.SIGTERM) -> None:
    """Make the kernel end this process by a signal when its parent dies, so that kill -9 of make leaves no orphans."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, number)


def adopt_orphans() -> None:
    """Make this process the parent of orphaned descendants, so that it can wait for them and count their cost."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, 1)


def end_with(maker: int) -> None:
    """End this process when its parent, process number `maker`, ends; at once if the parent has ended already."""
    die_with_parent()
    if os.getppid() != maker:
        os.kill(os.getpid(), signal.SIGTERM)


def pool(workers: int, context: "BaseContext | None" = None) -> "ProcessPoolExecutor":
    """A pool of forked or spawned processes that end with this one, however it ends.

    When this process is killed, those of a plain pool wait for work for ever and hold its output open, so that a make
    which follows the output waits with them.
    """
    from concurrent.futures import ProcessPoolExecutor  # every step imports this module, and needs no pool

    return ProcessPoolExecutor(workers, context, initializer=end_with, initargs=(os.getpid(),))


AUTH = re.compile(r" ?--jobserver-(?:auth|fds)=(?:(\d+),(\d+)|fifo:(\S+))")
LOOK_AGAIN_S = 0.5  # between two looks for a slot that another job of make has freed


def inherited(makeflags: str) -> tuple[int, ...]:
    """The two file descriptors of make's jobserver; none if this process did not inherit them.

    Call it before other files are opened, which may take the same numbers.
    """
    found = AUTH.search(makeflags)
    numbers = (int(found[1]), int(found[2])) if found and found[1] else ()
    with suppress(OSError):
        if all(stat.S_ISFIFO(os.fstat(number).st_mode) for number in numbers):
            return numbers
    return ()


def handed_on(environment: Mapping[str, str]) -> tuple[tuple[int, ...], dict[str, str]]:
    """What a child needs to take slots of make: file descriptors, and an environment that names no others."""
    flags = environment.get("MAKEFLAGS", "")
    numbers, found = inherited(flags), AUTH.search(flags)
    lost = found is not None and not numbers and not found[3]
    return numbers, {**environment, "MAKEFLAGS": AUTH.sub("", flags)} if lost else dict(environment)


class Slots:
    """Job slots of make beside this process's own; without make their number is unlimited."""

    def __init__(self) -> None:
        flags = os.environ.get("MAKEFLAGS", "")
        found, numbers = AUTH.search(flags), inherited(flags)
        self.pipe: tuple[int, int] | None = None
        with suppress(OSError):
            if found and (found[3] or numbers):  # opened anew, so that O_NONBLOCK is not set for make itself
                way_in, way_out = (found[3], found[3]) if found[3] else (f"/proc/self/fd/{n}" for n in numbers)
                self.pipe = (os.open(way_in, os.O_RDONLY | os.O_NONBLOCK), os.open(way_out, os.O_WRONLY))
        self.held: list[bytes] = []

    def take(self) -> bool:
        """Take a slot if one is free; return whether this process may start another job."""
        if self.pipe is None:
            return True
        with suppress(BlockingIOError):
            if token := os.read(self.pipe[0], 1):
                self.held.append(token)
                return True
        return False

    def give(self) -> None:
        """Give a slot back."""
        if self.pipe is not None and self.held:
            os.write(self.pipe[1], self.held.pop())


def in_slots(function: Callable[..., Any], tasks: list[tuple], jobs: int) -> Iterator[Any]:
    """Results of function(*task) in the tasks' order, from up to `jobs` processes, which take job slots of make."""
    if jobs <= 1 or len(tasks) <= 1:
        for task in tasks:
            yield function(*task)
        return
    from concurrent.futures import FIRST_COMPLETED, Future, wait

    slots, waiting = Slots(), deque(tasks)
    running: set[Future] = set()
    begun: deque[Future] = deque()
    with pool(jobs) as processes:
        try:
            while waiting or begun:
                # the first one uses the slot of this process
                while waiting and len(running) < jobs and (not running or slots.take()):
                    begun.append(processes.submit(function, *waiting.popleft()))
                    running.add(begun[-1])
                done, running = wait(running, LOOK_AGAIN_S if waiting else None, FIRST_COMPLETED)
                for _ in done:
                    slots.give()
                while begun and begun[0].done():
                    yield begun.popleft().result()
        finally:
            while slots.held:
                slots.give()
