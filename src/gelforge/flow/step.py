"""The wrapper every recipe runs in: log, cost, and a target that is whole or absent.

`python -m gelforge.flow.step [--every SECONDS] TARGET INPUT… -- COMMAND…`: COMMAND writes TARGET.part; this renames it on
success. An input that is not as it was made is refused, and nothing is made of it. Jobs of make print at the same time: what
belongs together is printed at once.
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
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO

from gelforge.errors import BadInput, unwritable
from gelforge.flow.files import digest_of, last_line, read_json, take, write_json
from gelforge.flow.layout import Layout, dataset_folder, log_of, metrics_of
from gelforge.flow.ledger import changed_since, installed
from gelforge.flow.orphans import die_with_parent
from gelforge.flow.running import look, show_line, terminal
from gelforge.flow.slots import handed_on

TAIL_LINES = 20
LIVE_EVERY_S = 1.0  # between two looks for the line on a terminal
SAID_EVERY_S = 25.0  # between two lines where there is no terminal: a run is silent for half a minute at most
NOTICES = ("rejected: ", "failed: ", "note: ")  # lines of a log that a person must see although the step succeeded


def follow(stream: Iterable[str], log: IO[str]) -> None:
    """Copy a child's output to its log."""
    for line in stream:
        log.write(line)
        log.flush()


@contextmanager
def live_line(target: Path, log_path: Path, every_s: float) -> Iterator[None]:
    """While the block runs, say how far the whole run has come, and what runs now.

    A person's terminal gets one line that is kept up to date. Elsewhere a line is printed every `every_s` seconds, by one of a
    dataset's steps that run at the same time: the one that holds the lock of a file.
    """
    device, results, started, over = terminal(), dataset_folder(log_path), time.monotonic(), threading.Event()
    speaker = (Layout(results).logs if results else log_path.parent) / "speaker"

    def come() -> str:
        last = last_line(log_path) if log_path.exists() else ""
        return " | ".join(filter(None, (str(look(results)) if results else "", last)))

    def show(device: str) -> None:
        while not over.wait(LIVE_EVERY_S):
            show_line(device, come())
        show_line(device)

    def say() -> None:
        with speaker.open("w") as lock:
            while not over.wait(every_s):
                with suppress(BlockingIOError):
                    take(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    print(f"{target}  {time.monotonic() - started:.0f} s so far  [{come()}]", flush=True)

    printer = threading.Thread(target=show if device else say, args=[device] if device else [], daemon=True)
    printer.start()
    try:
        yield
    finally:
        over.set()
        printer.join()


def run(command: list[str], target: Path, log_path: Path, every_s: float) -> tuple[int, dict]:
    """Run a target's command into its log; return its exit code and what it cost."""
    started = time.time()
    slots, environment = handed_on(os.environ)
    with log_path.open("w", encoding="utf-8", errors="replace") as log:
        log.write(f"$ {' '.join(command)}\n")
        log.flush()
        begun = os.fstat(log.fileno()).st_mtime_ns
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
        with live_line(target, log_path, every_s):  # after the fork, which must not meet a second thread
            follow(child.stdout or (), log)
            code, usage = ended(child)
    cost = {
        "command": command,
        "exit_code": code,
        "interrupted": bool(code and stopped),
        "started": started,
        "begun_ns": begun,
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
    """Wait for a child: its exit code, and what it used."""
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    return child.returncode, usage


def show_notices(log_path: Path) -> None:
    """Repeat what the command rejected, could not solve or found odd, because a log is not read unless something fails."""
    lines = log_path.read_text(encoding="utf-8", errors="replace").splitlines()
    if notices := [line for line in lines if line.startswith(NOTICES)]:
        print("\n".join(notices), flush=True)


def report_failure(target: Path, log_path: Path, code: int, interrupted: bool) -> None:
    """Say where the log is and show its end; of what a person stopped there is nothing to look for."""
    if interrupted:
        print(f"{target}: interrupted; the same make goes on with it", flush=True)
        return
    lines = log_path.read_text(encoding="utf-8", errors="replace").splitlines()[-TAIL_LINES:]
    shown = [f"FAILED {target} (exit {code}); log: {log_path}", *(f"  | {line}" for line in lines)]
    print("\n".join(shown), flush=True)


def refuse_corrupt(path: Path) -> None:
    """BadInput where an input, or a file beside it that it names, has not the content that it was published with.

    A file without a record was made by hand; one whose record cannot be read is not known to be whole.
    """
    metrics = metrics_of(path)
    if not metrics.exists() or not path.is_file():
        return
    try:
        made = dict(read_json(metrics))
    except (ValueError, TypeError):
        made = {}
    if made.get("exit_code"):
        return  # the last run failed, and left the file of the one before
    changed = path if made.get("sha256") != digest_of(path) else changed_beside(path)
    if changed:
        gone = " ".join(dict.fromkeys(map(str, (path, changed))))
        raise BadInput(
            f"{changed}: is not as it was made; remove it (rm {gone}) and run make again, which makes it anew"
        )


def changed_beside(path: Path) -> Path | None:
    """The first of the files beside a JSON target, named with their digests under "sha256" in it, that is not as it was."""
    listed = read_json(path).get("sha256") if path.suffix == ".json" else None
    beside = ((path.with_name(name), digest) for name, digest in (listed or {}).items())
    return next((file for file, digest in beside if not file.is_file() or digest_of(file) != digest), None)


def build(target: Path, inputs: list[Path], command: list[str], every_s: float) -> int:
    """Make one target: lock, run, publish; return the exit code."""
    before = file_state(target)
    for path in inputs:
        refuse_corrupt(path)
    with locked(target, every_s) as log_path:
        # A second make that waited here finds the work of the first one done. Clocks cannot tell: a file's time stamp
        # lags by the kernel's tick, and a file server has a clock of its own.
        if file_state(target) not in (None, before) and not changed_since([(str(target), map(str, inputs))]):
            return 0
        return make_part(target, inputs, command, log_path, every_s)


def file_state(path: Path) -> tuple[int, int] | None:
    """What changes whenever a file is published again: its inode and time stamp in ns; None where there is none."""
    try:
        state = path.stat()
    except FileNotFoundError:
        return None
    return state.st_ino, state.st_mtime_ns


@contextmanager
def locked(target: Path, every_s: float) -> Iterator[Path]:
    """Hold the lock of a target, which one step has at a time; yield where its log lies."""
    log_path = log_of(target)
    for folder in (target.parent, log_path.parent):
        folder.mkdir(parents=True, exist_ok=True)
    with log_path.with_suffix(".lock").open("w") as lock:
        try:
            take(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"{target}: another make is at it; waiting", flush=True)
            with live_line(target, log_path, every_s):
                take(lock, fcntl.LOCK_EX)
        yield log_path


def make_part(target: Path, inputs: list[Path], command: list[str], log_path: Path, every_s: float) -> int:
    """Run the command and publish what it wrote, with its cost; return the exit code."""
    part = Path(f"{target}.part")
    try:
        return publish_part(target, part, inputs, command, log_path, every_s)
    finally:
        # a full disk may stop any of this; what is half written must not stay
        shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink(missing_ok=True)


def publish_part(
    target: Path, part: Path, inputs: list[Path], command: list[str], log_path: Path, every_s: float
) -> int:
    """Run the command, write down its cost, and give what it wrote its final name; return the exit code."""
    code, cost = run(command, target, log_path, every_s)
    begun = cost.pop("begun_ns")
    if code == 0 and not part.exists():
        print(f"{target}: the command succeeded but wrote no {part}")
        code = cost["exit_code"] = 1
    cost |= {"target": str(target), "inputs": [str(path) for path in inputs]}
    cost["bytes"] = part.stat().st_size if code == 0 else 0
    if code == 0:
        cost["sha256"] = digest_of(part)
    write_json(metrics_of(target), cost)
    if code:
        report_failure(target, log_path, code, cost["interrupted"])
        return code if 0 < code < 126 else 1
    # dated when its command began, by the file server's clock: an input that another make wrote meanwhile is newer
    os.utime(part, ns=(begun, begun))
    os.replace(part, target)
    show_notices(log_path)
    results = dataset_folder(target)
    far = str(look(results, stage=target.relative_to(results).parts[0])) if results and terminal() is None else ""
    print(f"{target}  {cost['seconds']:.1f} s, {cost['peak_mib']:.0f} MiB{far and f'  [{far}]'}", flush=True)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    argv = sys.argv[1:] if argv is None else list(argv)
    every_s = SAID_EVERY_S
    if argv[:1] == ["--every"]:
        every_s, argv = float(argv[1]), argv[2:]
    if "--" not in argv[1:-1]:
        print("usage: python -m gelforge.flow.step [--every SECONDS] TARGET INPUT… -- COMMAND…", file=sys.stderr)
        return 2
    split = argv.index("--")
    die_with_parent()
    try:
        return build(Path(argv[0]), [Path(name) for name in argv[1:split]], argv[split + 1 :], every_s)
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
