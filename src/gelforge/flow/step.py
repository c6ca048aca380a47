"""The wrapper every recipe runs in: log, cost, and a target that is whole or absent.

`python -m gelforge.flow.step TARGET INPUT… -- COMMAND…`: COMMAND writes TARGET.part; this renames it on
success. An input that lost bytes since it was made is made again first, by the command that made it.
"""

import fcntl
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO

from gelforge.errors import BadInput, unwritable
from gelforge.flow.files import digest_of, last_line, read_json, take, write_json
from gelforge.flow.layout import dataset_folder, log_of, metrics_of
from gelforge.flow.ledger import changed_since
from gelforge.flow.orphans import die_with_parent
from gelforge.flow.programs import installed
from gelforge.flow.running import look
from gelforge.flow.slots import handed_on
from gelforge.flow.terminal import show_line, terminal

TAIL_LINES = 20
LIVE_EVERY_S = 1.0
NOTICES = ("rejected: ", "failed: ", "note: ")  # lines of a log that a person must see although the step succeeded


def follow(stream: Iterable[str], log: IO[str]) -> None:
    """Copy a child's output to its log."""
    for line in stream:
        log.write(line)
        log.flush()


@contextmanager
def live_line(log_path: Path) -> Iterator[None]:
    """While the block runs, keep one line on a person's terminal: how far the whole run has come, and what runs now."""
    device, results = terminal(), dataset_folder(log_path)
    if device is None or results is None:
        yield
        return
    over = threading.Event()

    def show() -> None:
        while not over.wait(LIVE_EVERY_S):
            show_line(device, " | ".join(filter(None, (str(look(results)), last_line(log_path)))))
        show_line(device)

    printer = threading.Thread(target=show, daemon=True)
    printer.start()
    try:
        yield
    finally:
        over.set()
        printer.join()


def run(command: list[str], log_path: Path) -> tuple[int, dict]:
    """Run a command into its log; return its exit code and what it cost."""
    started = time.time()
    slots, environment = handed_on(os.environ)
    with log_path.open("w", encoding="utf-8", errors="replace") as log:
        log.write(f"$ {' '.join(command)}\n")
        log.flush()
        child = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            preexec_fn=die_with_parent,
            env=environment,
            pass_fds=slots,
        )
        stopped = pass_on_stops(child)
        with live_line(log_path):  # after the fork, which must not meet a second thread
            follow(child.stdout or (), log)
            code, usage = ended(child)
    cost = {
        "command": command,
        "exit_code": code,
        "interrupted": bool(code and stopped),
        "started": started,
        "seconds": round(time.time() - started, 3),
        "cpu_seconds": round(usage.ru_utime + usage.ru_stime, 3),
        "peak_mib": round(usage.ru_maxrss / 1024, 1),
        "programs": installed(),
    }
    return code, cost


def pass_on_stops(child: subprocess.Popen) -> list[int]:
    """From now on give a child the signals that tell this process to stop; return those that came, as they come."""
    came: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        pass_on(number, child)

    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, stop)
    return came


def pass_on(number: int, child: subprocess.Popen) -> None:
    """Give a child a signal. Popen's own way would wait for a child that has ended, and `ended` could do so no more."""
    if child.returncode is None:
        with suppress(ProcessLookupError):
            os.kill(child.pid, number)


def ended(child: subprocess.Popen) -> tuple[int, resource.struct_rusage]:
    """Wait for a child: its exit code, and what it used.

    The children of this process all together would not do: a step that repaired its inputs had others before.
    """
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    return child.returncode, usage


def show_notices(log_path: Path) -> None:
    """Repeat what the command rejected, could not solve or found odd, because a log is not read unless something fails."""
    for line in log_path.read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith(NOTICES):
            print(line)


def report_failure(target: Path, log_path: Path, code: int, interrupted: bool) -> None:
    """Say where the log is and show its end; of what a person stopped there is nothing to look for."""
    if interrupted:
        print(f"{target}: interrupted; the same make goes on with it", flush=True)
        return
    lines = log_path.read_text(encoding="utf-8", errors="replace").splitlines()[-TAIL_LINES:]
    print(f"FAILED {target} (exit {code}); log: {log_path}", *(f"  | {line}" for line in lines), sep="\n", flush=True)


def repair(path: Path) -> int:
    """Make an input again if it does not have the content it was published with; return the exit code.

    It goes first: where its command fails, or is one that an older version of the code knew, nobody takes the
    corrupt file for a whole one, and the next make finds it missing and makes it by today's rule. So it does where the
    record of the input, and with it the command, is lost. Of several readers the first makes it again, the others wait.
    """
    if corrupt_file(path) is None:
        return 0
    with locked(path) as log_path:
        lost = corrupt_file(path)
        if lost is None:
            return 0
        made, corrupt = record_of(path), path.with_name(lost)
        if not made:
            print(f"{metrics_of(path)}: cannot be read, so nothing tells whether {path} is whole; run make again, which"
                  " makes it again", flush=True)  # fmt: skip
            for gone in (path, metrics_of(path)):
                gone.unlink(missing_ok=True)
            return 1
        if made["exit_code"]:
            print(f"{path}: could not be made; see {log_path}", flush=True)
            return 1
        print(f"{corrupt}: not as it was when it was made; making it again", flush=True)
        for gone in (corrupt, path):
            shutil.rmtree(gone) if gone.is_dir() else gone.unlink(missing_ok=True)
        inputs = [Path(name) for name in made["inputs"]]
        return repair_all(inputs) or make_part(path, inputs, made["command"], log_path)


def repair_all(paths: Iterable[Path]) -> int:
    """Repair one after the other; return the first exit code that is not 0."""
    return next((code for code in map(repair, paths) if code), 0)


def corrupt_file(path: Path) -> str | None:
    """Which file of a target is not as it was published: its own, absent too, or one beside it; None where all is well.

    A target without a record was made by hand or is being made for the first time. One whose record cannot be read counts
    as corrupt.
    """
    metrics = metrics_of(path)
    if not metrics.exists():
        return None
    made = record_of(path)
    if not path.is_file():
        return None if path.is_dir() else path.name
    if not made:
        return path.name
    if made["exit_code"]:
        return None
    return corrupt_beside(path) if whole(path, made) else path.name


def record_of(path: Path) -> dict:
    """The metrics of a target, empty where they are corrupt; a disk that does not answer corrupts nothing."""
    try:
        return read_json(metrics_of(path)) or {}
    except ValueError:
        return {}


def whole(path: Path, made: dict) -> bool:
    """Whether a file has the bytes that its metrics tell of; metrics of older code tell their number alone."""
    return path.stat().st_size == made["bytes"] and made.get("sha256") in (None, digest_of(path))


def corrupt_beside(path: Path) -> str | None:
    """The first of the files beside a JSON target, named with their digests under "sha256" in it, that is not whole."""
    listed = read_json(path).get("sha256") if path.suffix == ".json" else None
    for name, digest in (listed or {}).items():
        beside = path.with_name(name)
        if not beside.is_file() or digest_of(beside) != digest:
            return name
    return None


def build(target: Path, inputs: list[Path], command: list[str]) -> int:
    """Make one target: repair its inputs, lock, run, publish; return the exit code."""
    before = file_state(target)
    code = repair_all(inputs)
    if code:
        return code
    with locked(target) as log_path:
        # A second make that waited here finds the work of the first one done. Clocks cannot tell: a file's time stamp
        # lags by the kernel's tick, and a file server has a clock of its own.
        if file_state(target) not in (None, before) and not changed_since([(str(target), map(str, inputs))]):
            return 0
        return make_part(target, inputs, command, log_path)


def file_state(path: Path) -> tuple[int, int] | None:
    """What changes whenever a file is published again: its inode and time stamp in ns; None where there is none."""
    try:
        state = path.stat()
    except FileNotFoundError:
        return None
    return state.st_ino, state.st_mtime_ns


@contextmanager
def locked(target: Path) -> Iterator[Path]:
    """Hold the lock of a target, which one step has at a time; yield where its log lies."""
    log_path = log_of(target)
    for folder in (target.parent, log_path.parent):
        folder.mkdir(parents=True, exist_ok=True)
    with log_path.with_suffix(".lock").open("w") as lock:
        try:
            take(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"{target}: another make is at it; waiting", flush=True)
            take(lock, fcntl.LOCK_EX)
        yield log_path


def make_part(target: Path, inputs: list[Path], command: list[str], log_path: Path) -> int:
    """Run the command and publish what it wrote, with its cost; return the exit code."""
    part = Path(f"{target}.part")
    try:
        return publish_part(target, part, inputs, command, log_path)
    finally:
        # a full disk may stop any of this; what is half written must not stay
        shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink(missing_ok=True)


def publish_part(target: Path, part: Path, inputs: list[Path], command: list[str], log_path: Path) -> int:
    """Run the command, write down its cost, and give what it wrote its final name; return the exit code."""
    read = {path: file_state(path) for path in inputs}
    code, cost = run(command, log_path)
    if code == 0 and not part.exists():
        print(f"{target}: the command succeeded but wrote no {part}")
        code = cost["exit_code"] = 1
    cost["inputs"] = [str(path) for path in inputs]
    cost["read"] = {str(path): state[1] for path, state in read.items() if state}
    cost["bytes"] = part.stat().st_size if code == 0 else 0
    if code == 0:
        cost["sha256"] = digest_of(part)
    write_json(metrics_of(target), cost)
    if code:
        report_failure(target, log_path, code, cost["interrupted"])
        return code if 0 < code < 126 else 1
    leave_due(target, part, read)
    os.replace(part, target)
    show_notices(log_path)
    results = dataset_folder(target)
    far = str(look(results, stage=target.relative_to(results).parts[0])) if results and terminal() is None else ""
    print(f"{target}  {cost['seconds']:.1f} s, {cost['peak_mib']:.0f} MiB{far and f'  [{far}]'}", flush=True)
    return 0


def leave_due(target: Path, part: Path, read: Mapping[Path, tuple[int, int] | None]) -> None:
    """Date what was made before all that it was made from where that changed meanwhile; read: states before the command.

    Another make may plan anew while the command runs. What it reads then is nobody's guess, so the target is due again.
    """
    changed = [path for path, state in read.items() if file_state(path) != state]
    if not changed:
        return
    oldest = min((state[1] for state in map(file_state, read) if state), default=1)
    os.utime(part, ns=(oldest - 1, oldest - 1))
    print(f"{target}: {changed[0]} changed while it was made; run make again, which makes it again", flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    argv = sys.argv[1:] if argv is None else list(argv)
    if "--" not in argv[1:-1]:
        print("usage: python -m gelforge.flow.step TARGET INPUT… -- COMMAND…", file=sys.stderr)
        return 2
    split = argv.index("--")
    die_with_parent()
    try:
        return build(Path(argv[0]), [Path(name) for name in argv[1:split]], argv[split + 1 :])
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
