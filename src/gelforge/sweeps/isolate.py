"""One solve in a process of its own, so that its time, its memory and its death are its own."""

import os
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkContext, ForkServerContext
from multiprocessing.forkserver import ensure_running
from pathlib import Path

import gelforge
from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.orphans import die_with_parent

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
        pipe.send({"stopped": f"{error}; free space or mend the folder and run make again, it resumes here"})
    except ImportError as error:
        pipe.send({"stopped": f"{error}; run make setup"})
    except Exception as error:
        pipe.send({"status": CRASHED, "reason": f"{type(error).__name__}: {error}"})
    pipe.close()


# Of the server that solves are forked from, and so of them: the cost of a solve is that of one thread, whatever the user
# has set, and a server that had several could not fork without some of its children hanging.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
ASKED_BY = "GELFORGE_ASKED_BY"  # the process that began the server, with which it ends
# A solve is looked at so often, and may take so many times its limit by the clock on a machine that has other work.
LOOK_S, WAITING = 1.0, 10.0


def fresh() -> ForkServerContext:
    """Where processes come from that share no thread with this one, and have the kernels of the solver loaded.

    A server that has run nothing else forks them: a process that was forked beside threads of numerical libraries hangs
    where they held a lock. It runs the code that this process does, whatever is installed.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload(["gelforge.sweeps.warm"])
    code = [str(Path(gelforge.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    with surroundings(ONE_THREAD | {ASKED_BY: str(os.getpid()), "PYTHONPATH": os.pathsep.join(filter(None, code))}):
        try:
            ensure_running()
        except OSError as error:  # its socket lies in the folder for temporary files, and has a short name or none
            raise BadInput(
                f"the process that solves are begun from cannot start ({error}); set TMPDIR to a shorter path, such as /tmp"
            ) from error
    return context


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


def running_seconds(pid: int) -> float:
    """User and system time of a running process and of all that it began, 0 where the system does not say (no /proc)."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        begun = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return 0.0
    own = sum(int(ticks) for ticks in fields[11:15]) / os.sysconf("SC_CLK_TCK")
    return own + sum(running_seconds(int(child)) for child in begun)


def why_late(here: Connection, pid: int, limit_s: float) -> str | None:
    """Wait for an answer and return None, or why to wait no longer: the process has used its processor time, or hangs."""
    end = time.monotonic() + WAITING * limit_s
    while not here.poll(min(LOOK_S, limit_s)):
        if running_seconds(pid) > limit_s:
            return f"stopped after {limit_s:g} s of processor time"
        if time.monotonic() > end:
            return f"stopped after {WAITING * limit_s:g} s by the clock, before it had used {limit_s:g} s of processor time"
    return None


def isolated(
    work: Callable[[], dict], limit_s: float, context: ForkContext | ForkServerContext | None = None
) -> dict:
    """The dict that `work` returns from a process of its own, or how that process failed.

    limit_s: of processor time, so that a busy machine changes no result. context: how the process begins; `fresh()` where
    none is given, for which pickle must take `work`. A failure is {"status", "reason"} with status REFUSED (BadInput),
    CRASHED or TIMED_OUT; a full disk, a missing file or package is none of these and raises BadInput.
    """
    context = context or fresh()
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_answer, args=(work, there))
    try:
        child.start()
    except (EOFError, ConnectionError) as error:
        raise GelforgeError("the process that solves are begun from ended; what it printed above says why") from error
    there.close()
    answer, late = None, None
    try:
        late = why_late(here, child.pid or 0, limit_s)
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
        return {"status": TIMED_OUT, "reason": late, "limit_s": limit_s}
    if answer is None:
        return {"status": CRASHED, "reason": f"the process ended with exit code {child.exitcode}"}
    if "stopped" in answer:
        raise BadInput(answer["stopped"])
    return answer
