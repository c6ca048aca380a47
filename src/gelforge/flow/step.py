"""The wrapper of every recipe: a log, a record, and a target that is whole or absent.

`python -m gelforge.flow.step TARGET INPUT… -- COMMAND…`: COMMAND writes TARGET.part; this renames it on success. Nothing runs where
command and contents of all inputs are those of the target's record: the target is dated anew, because make goes by dates alone.
An input @FILE stands for the paths that FILE lists.
"""

import fcntl
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from gelforge.errors import BadInput, unwritable
from gelforge.flow.files import State, changed, digest_of, record_of, states_of, take, write_json
from gelforge.flow.jobs import adopt_orphans, die_with_parent, handed_on
from gelforge.flow.layout import log_of, metrics_of
from gelforge.flow.runs import count_finished, installed

TAIL_LINES = 20
LEFT_BEHIND_S = 2.0  # that processes are waited for whose parent has ended
NOTICES = ("rejected: ", "failed: ", "note: ")  # lines of a log that a person must see although the step succeeded


def record_at(target: Path) -> dict:
    """The record of a target's last run; empty where there is none that can be read."""
    record = record_of(metrics_of(target)) or {}
    return record if isinstance(record.get("inputs"), dict) else {}


def fresh(target: Path, inputs: Sequence[str], command: list[str]) -> dict[str, State | None] | None:
    """States of the inputs where a target is what its command would make of them; None where it is not, or may not be."""
    record = record_at(target)
    known = record.get("inputs", {})
    if record.get("exit_code") != 0 or record["command"] != command or known.keys() != set(inputs):
        return None
    if not target.is_file() or record["sha256"] != digest_of(target) or any(lost_beside(target)):
        return None
    now = states_of(inputs, known)
    return None if changed(known, now) else now


def is_redated(target: Path, inputs: Sequence[str], command: list[str], begun: int) -> bool:
    """Date a target as of `begun`, ns, where it is what its command would make; return whether it is."""
    states = fresh(target, inputs, command)
    if states is None:
        return False
    write_json(metrics_of(target), record_at(target) | {"inputs": states})
    date(target, states, begun)
    return True


def redated(target: Path, words: Iterable[str], command: list[str]) -> bool:
    """As `build` begins: whether the target is what its command would make of these inputs, and is dated anew."""
    with locked(target) as begun:
        return is_redated(target, list(dict.fromkeys(expanded(words))), command, begun)


def beside(path: Path) -> dict[Path, str]:
    """Digests of the files beside a JSON target that it names under "sha256"."""
    listed = (record_of(path) or {}).get("sha256") if path.suffix == ".json" else None
    return {path.with_name(name): digest for name, digest in (listed or {}).items()}


def lost_beside(path: Path) -> Iterator[Path]:
    """Files that a target names and that are gone."""
    return (file for file in beside(path) if not file.is_file())


def refuse_corrupt(path: Path, now: State | None) -> None:
    """BadInput where an input, or a file beside it that it names, has not the content that it was published with.

    A file without a record was made by hand; one whose record cannot be read is not known to be whole.
    """
    metrics = metrics_of(path)
    if not metrics.exists() or not path.is_file():
        return
    made = record_of(metrics) or {}
    if made.get("exit_code"):
        return  # the last run failed, and left the file of the one before
    wrong = path if not now or made.get("sha256") != now[0] else None
    wrong = wrong or next(
        (file for file, digest in beside(path).items() if not file.is_file() or digest_of(file) != digest), None
    )
    if wrong:
        gone = " ".join(dict.fromkeys(map(str, (path, wrong))))
        raise BadInput(
            f"{wrong}: is not as it was made; remove it (rm {gone}) and run make again, which makes it anew"
        )


def build(target: Path, inputs: list[str], command: list[str]) -> int:
    """Make one target, or date it anew; return the exit code."""
    with locked(target) as begun:
        # a second make that waited here finds the work of the first one done
        if is_redated(target, inputs, command, begun):
            return 0
        states = states_of(inputs, {})
        for path, now in states.items():
            refuse_corrupt(Path(path), now)
        part = Path(f"{target}.part")
        try:
            return publish_part(target, part, states, command, begun)
        finally:
            # a full disk may stop any of this; what is half written must not stay
            shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink(missing_ok=True)


@contextmanager
def locked(target: Path) -> Iterator[int]:
    """Hold the lock of a target, which one step has at a time; yield the time by the file server's clock, ns."""
    log_path = log_of(target)
    for folder in (target.parent, log_path.parent):
        folder.mkdir(parents=True, exist_ok=True)
    with log_path.with_suffix(".lock").open("a") as lock:
        try:
            take(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"{target}: another make is at it; waiting", flush=True)
            take(lock, fcntl.LOCK_EX)
        os.utime(lock.fileno())
        yield os.fstat(lock.fileno()).st_mtime_ns


def date(path: Path, states: Mapping[str, State | None], begun: int) -> None:
    """Date a file as it was begun, ns, but no older than what it was made of, which may be dated ahead."""
    at = max([begun, *(state[2] for state in states.values() if state)])
    os.utime(path, ns=(at, at))


def publish_part(target: Path, part: Path, states: dict[str, State | None], command: list[str], begun: int) -> int:
    """Run the command, write its record, and give what it wrote its final name; return the exit code."""
    log_path = log_of(target)
    code, cost = run(command, log_path)
    if code == 0 and not part.exists():
        print(f"{target}: the command succeeded but wrote no {part}")
        code = cost["exit_code"] = 1
    cost |= {"target": str(target), "inputs": states, "counts": counts_in(log_path)}
    cost["bytes"] = part.stat().st_size if code == 0 else 0
    if code == 0:
        cost["sha256"] = digest_of(part)
        date(part, states, begun)
    write_json(metrics_of(target), cost)
    if code:
        report_failure(target, log_path, code, cost["interrupted"])
        return code if 0 < code < 126 else 1
    os.replace(part, target)
    show_notices(log_path)
    print(
        f"{target}  {cost['seconds']:.1f} s, {cost['peak_mib']:.0f} MiB{count_finished(target, cost['started'])}",
        flush=True,
    )
    return 0


def run(command: list[str], log_path: Path) -> tuple[int, dict]:
    """Run a target's command into its log; return its exit code and what it cost, with all processes that it began."""
    started = time.time()
    slots, environment = handed_on(os.environ)
    environment.setdefault("TQDM_MININTERVAL", "10")  # seconds between two lines of a log
    with log_path.open("w", encoding="utf-8", errors="replace") as log:
        log.write(f"$ {' '.join(command)}\n")
        log.flush()
        child = subprocess.Popen(
            command, stdout=log, stderr=subprocess.STDOUT, preexec_fn=die_with_parent, env=environment, pass_fds=slots
        )
        stopped = pass_on_stops(child)
        code = child.wait()
        reap()
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return code, {
        "command": command,
        "exit_code": code,
        "interrupted": bool(code and stopped),
        "started": started,
        "seconds": round(time.time() - started, 3),
        "cpu_seconds": round(usage.ru_utime + usage.ru_stime, 3),
        "peak_mib": round(usage.ru_maxrss / 1024, 1),
        "programs": installed(),
    }


def reap() -> None:
    """Wait for processes that the command left to end, such as a server that it forked others from: they belong to its cost."""
    until = time.monotonic() + LEFT_BEHIND_S
    with suppress(ChildProcessError):
        while time.monotonic() < until:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                time.sleep(0.01)


def pass_on_stops(child: subprocess.Popen) -> list[int]:
    """From now on give a child the signals that tell this process to stop; return those that came, as they come."""
    came: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        if child.returncode is None:
            with suppress(ProcessLookupError):
                os.kill(child.pid, number)

    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, stop)
    return came


def lines_of(log_path: Path) -> list[str]:
    """Lines of a log; a bar that was drawn over itself is one a look."""
    return log_path.read_text(encoding="utf-8", errors="replace").splitlines()


def counts_in(log_path: Path) -> dict:
    """What a command counted: its last line, where that is a table of JSON."""
    last = next((line for line in reversed(lines_of(log_path)) if line.strip()), "")
    try:
        found = json.loads(last)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def show_notices(log_path: Path) -> None:
    """Repeat what the command rejected, could not solve or found odd, because a log is not read unless something fails."""
    if notices := [line for line in lines_of(log_path) if line.startswith(NOTICES)]:
        print("\n".join(notices), flush=True)


def report_failure(target: Path, log_path: Path, code: int, interrupted: bool) -> None:
    """Say where the log is and show its end; of what a person stopped there is nothing to look for."""
    if interrupted:
        print(f"{target}: interrupted; the same make goes on with it", flush=True)
        return
    shown = [
        f"FAILED {target} (exit {code}); log: {log_path}",
        *(f"  | {line}" for line in lines_of(log_path)[-TAIL_LINES:]),
    ]
    print("\n".join(shown), flush=True)


def expanded(words: Iterable[str]) -> Iterator[str]:
    """Inputs, with those of lists in place of the lists."""
    for word in words:
        if word.startswith("@"):
            yield from Path(word[1:]).read_text(encoding="utf-8").split()
        else:
            yield word


def main(argv: Sequence[str] | None = None) -> int:
    argv = sys.argv[1:] if argv is None else list(argv)
    if "--" not in argv[1:-1]:
        print("usage: python -m gelforge.flow.step TARGET INPUT… -- COMMAND…", file=sys.stderr)
        return 2
    split = argv.index("--")
    die_with_parent()
    adopt_orphans()
    try:
        return build(Path(argv[0]), list(dict.fromkeys(expanded(argv[1:split]))), argv[split + 1 :])
    except KeyboardInterrupt:
        return 130
    except BadInput as error:
        print(f"{argv[0]}: {error}")
        return 2
    except OSError as error:
        print(f"{argv[0]}: {unwritable(error)}, then run make again")
        return 1


if __name__ == "__main__":
    sys.exit(main())
