"""One solve in a process of its own, so that its time and memory are measured alone and a crash ends only it."""

import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import ceil
from multiprocessing import get_context
from multiprocessing.connection import Connection

from gelforge.errors import BadInput
from gelforge.flow.jobs import die_with_parent

REFUSED, CRASHED, TIMED_OUT = "REFUSED", "CRASHED", "TIMED_OUT"
# The cost of a solve is that of one thread, whatever the user has set.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
# Limit of a solve's wall time over that of its processor time, because the machine may have other work.
WAITING = 10.0


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


def _answer(work: Callable[[], dict], pipe: Connection, limit_s: float) -> None:
    """Run in the child process: signal the start, then send the result of `work`, or why it failed."""
    die_with_parent()
    began = cpu_seconds()
    most = ceil(began + limit_s)  # whole seconds; each process that it starts may take as many
    resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
    pipe.send(None)
    try:
        found = work()
        pipe.send(_late(limit_s) if cpu_seconds() - began > limit_s else found)
    except BadInput as error:
        pipe.send({"status": REFUSED, "reason": str(error)})
    except OSError as error:
        pipe.send({"stopped": f"{error}; free space or repair the folder, then run make again; it resumes here"})
    except ImportError as error:
        pipe.send({"stopped": f"{error}; run make setup"})
    except Exception as error:
        pipe.send({"status": CRASHED, "reason": f"{type(error).__name__}: {error}"})
    pipe.close()


def _late(limit_s: float) -> dict:
    return {"status": TIMED_OUT, "reason": f"stopped after {limit_s:g} s of processor time", "limit_s": limit_s}


@contextmanager
def surroundings(required: dict[str, str]) -> Iterator[None]:
    """Environment variables of the processes that begin while the block runs."""
    before = {name: os.environ.get(name) for name in required}
    os.environ.update(required)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def isolated(work: Callable[[], dict], limit_s: float) -> dict:
    """The dict that `work` returns from a process of its own, or how that process failed.

    The process is spawned, because one forked beside threads of numerical libraries may hang; `work` must be
    picklable. limit_s: processor time, so that a busy machine changes no result. A failure is {"status", "reason"}
    with status REFUSED (BadInput), CRASHED or TIMED_OUT; a full disk, a missing file or a missing package raises
    BadInput.
    """
    context = get_context("spawn")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_answer, args=(work, there, limit_s))
    with surroundings(ONE_THREAD):
        child.start()
    there.close()
    answer = None
    try:
        here.recv()  # it has started: the time of imports does not count
        if not here.poll(WAITING * limit_s):
            reason = f"stopped after {WAITING * limit_s:g} s by the clock, before it had used {limit_s:g} s of processor time"
            answer = {"status": TIMED_OUT, "reason": reason, "limit_s": limit_s}
            child.kill()
        else:
            answer = here.recv()
    except EOFError:
        pass
    finally:
        child.join(10.0)
        if child.is_alive():
            child.kill()
            child.join()
        here.close()
    if answer is None and child.exitcode == -signal.SIGXCPU:
        return _late(limit_s)
    if answer is None:
        return {"status": CRASHED, "reason": f"the process ended with exit code {child.exitcode}"}
    if "stopped" in answer:
        raise BadInput(answer["stopped"])
    return answer
