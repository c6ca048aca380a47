"""One solve in a process of its own, so that its time, its memory and its death are its own."""

import resource
import time
from collections.abc import Callable
from functools import cache
from multiprocessing import get_context
from multiprocessing.context import ForkContext, ForkServerContext

from gelforge.errors import BadInput
from gelforge.flow.step import die_with_parent

REFUSED, CRASHED, TIMED_OUT = "REFUSED", "CRASHED", "TIMED_OUT"


def cpu_seconds() -> float:
    """User and system time of this process and of its finished children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def peak_mib() -> float:
    """Largest resident memory of this process or of one of its children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return max(u.ru_maxrss for u in used) / 1024.0


class Clock:
    """Wall and processor seconds of the block it is entered for."""

    def __enter__(self):
        self._wall, self._cpu = time.perf_counter(), cpu_seconds()
        return self

    def __exit__(self, *_):
        self.seconds, self.cpu_seconds = time.perf_counter() - self._wall, cpu_seconds() - self._cpu


def _answer(work, pipe):
    die_with_parent()
    try:
        pipe.send(work())
    except BadInput as error:
        pipe.send({"status": REFUSED, "reason": str(error)})
    except OSError as error:
        pipe.send({"os_error": str(error)})
    except Exception as error:
        pipe.send({"status": CRASHED, "reason": f"{type(error).__name__}: {error}"})
    pipe.close()


@cache
def fresh() -> ForkServerContext:
    """Where processes come from that share no thread with this one, and have the kernels of the solver loaded.

    A server that has run nothing else forks them: a process that was forked beside threads of numerical libraries hangs
    where they held a lock.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload(["gelforge.sweeps.warm"])
    return context


def isolated(
    work: Callable[[], dict], limit_s: float, context: ForkContext | ForkServerContext | None = None
) -> dict:
    """The dict that `work` returns from a process of its own, or how that process failed.

    context: how the process begins; `fresh()` where none is given, for which pickle must take `work`. A failure is
    {"status", "reason"} with status REFUSED (BadInput), CRASHED or TIMED_OUT; a full disk or a missing file is none of
    these and raises BadInput.
    """
    context = context or fresh()
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_answer, args=(work, there))
    child.start()
    there.close()
    answer, late = None, False
    try:
        late = not here.poll(limit_s)
        answer = None if late else here.recv()
    except EOFError:
        pass
    finally:
        child.join(0.0 if late else 10.0)
        if child.is_alive():
            child.kill()
            child.join()
        here.close()
    if late:
        return {"status": TIMED_OUT, "reason": f"stopped after {limit_s:g} s", "limit_s": limit_s}
    if answer is None:
        return {"status": CRASHED, "reason": f"the process ended with exit code {child.exitcode}"}
    if "os_error" in answer:
        raise BadInput(f"{answer['os_error']}; free space or mend the folder and run make again, it resumes here")
    return answer
