"""The wrapper of every recipe: it writes a log and a record, and leaves a target whole or absent.

`python -m gelforge.flow.step TARGET INPUT… [-- COMMAND…]`: COMMAND, or else that of the stage which writes such a file
(`flow.layout.command_of`), writes TARGET.part, which is renamed on success. If the command and the contents of all inputs
are those of the target's record, nothing runs, and the target gets a new date, because make compares only dates. An input
@FILE stands for the paths that FILE lists. GELFORGE_LAUNCHER of the environment stands in front of the command that is
run, as on a cluster (`flow/slurm.py`), and is no part of the record.
"""

import atexit
import fcntl
import json
import os
import resource
import runpy
import shlex
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NoReturn

from gelforge.errors import BadInput, unwritable
from gelforge.flow.files import State, changed, digest_of, record_of, states_of, take, write_json
from gelforge.flow.jobs import adopt_orphans, die_with_parent, handed_on
from gelforge.flow.layout import command_of, dataset_folder, log_of, metrics_of, place_in
from gelforge.flow.runs import installed

TAIL_LINES = 20
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # that tell a step to stop
TELL_S = 20.0  # seconds between two lines on the terminal about a command that runs
LEFT_BEHIND_S = 2.0  # how long to wait for orphaned processes
NOTICES = ("rejected: ", "failed: ", "note: ")  # lines of a log that a person must see although the step succeeded


def record_at(target: Path) -> dict:
    """The record of a target's last run; empty if there is none that can be read."""
    record = record_of(metrics_of(target)) or {}
    return record if isinstance(record.get("inputs"), dict) else {}


def cause(target: Path, inputs: Sequence[str], command: list[str]) -> tuple[str, dict[str, State | None]]:
    """Why a target is not what its command would make of its inputs, "" if it is; and the states of the inputs."""
    record = record_at(target)
    known = record.get("inputs", {})
    # digests of results are computed again, because they tell of files that changed without a new date
    now = states_of(inputs, {path: state for path, state in known.items() if dataset_folder(Path(path)) is None})
    if not record:
        return "it was not made yet", now
    if record.get("exit_code") != 0:
        return "its last run did not succeed", now
    if not target.is_file():
        return "it is missing", now
    if lost := lost_beside(target):
        return f"{named([*map(str, lost)])} is missing", now
    if record.get("sha256") != digest_of(target):
        return "it changed since it was made", now
    if gone := sorted(known.keys() - set(inputs)):
        return f"{named(gone)} is no prerequisite any more", now
    if new := [path for path in inputs if path not in known]:
        return f"{named(new)} is a new prerequisite", now
    if different := changed(known, now):
        return f"{named(different)} changed", now
    return ("" if record["command"] == command else "its command changed"), now


def named(paths: Sequence[str]) -> str:
    """The first of some paths, and how many more there are."""
    return f"{paths[0]}{f' (and {len(paths) - 1} more)' if len(paths) > 1 else ''}"


def beside(path: Path) -> dict[Path, str]:
    """Digests of the files beside a JSON target that it names under "sha256"."""
    listed = (record_of(path) or {}).get("sha256") if path.suffix == ".json" else None
    return {path.with_name(name): digest for name, digest in (listed or {}).items()}


def made_with(target: Path) -> list[str]:
    """Names, relative to its folder, of the files that a target's command wrote beside it: STEM.*, and all in STEM/."""
    found = [path for path in target.parent.glob(f"{target.stem}.*") if path.suffix not in (".part", ".lock")]
    others = [path for path in found if metrics_of(path) != metrics_of(target) and metrics_of(path).exists()]
    every = {*found, *(target.with_name(target.stem)).rglob("*")} - {target, *others}
    return sorted(str(path.relative_to(target.parent)) for path in every if path.is_file())


def lost_beside(path: Path) -> list[Path]:
    """Files that were made with a target, or that it names, and that are missing."""
    named = [path.parent / name for name in record_at(path).get("beside", ())]
    return [file for file in (*named, *beside(path)) if not file.is_file()]


def heal(path: Path) -> bool:
    """Make a whole target again by its record if a file that was made with it is gone; return whether it was.

    With the same content it keeps its date, because other targets were made of it.
    """
    record = record_at(path)
    if record.get("exit_code") != 0 or not path.is_file() or not lost_beside(path):
        return False
    made = path.stat().st_mtime_ns
    if record.get("sha256") != digest_of(path) or build(path, [*record["inputs"]], record["command"]):
        return False
    if record_at(path)["sha256"] == record["sha256"]:
        os.utime(path, ns=(made, made))
    return True


def refuse_corrupt(path: Path, now: State | None) -> None:
    """BadInput if the content of an input, or of a file that it names, changed after it was published.

    A file without a record was made by hand and passes; one whose record cannot be read is refused.
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
            f"{wrong}: missing or changed since it was made; remove it (rm {gone}) and run make again, which makes it again"
        )


def build(target: Path, inputs: list[str], command: list[str]) -> int:
    """Make one target, or give it a new date; return the exit code."""
    with locked(target) as begun:
        # a second make that waited here finds the work of the first one done
        why, states = cause(target, inputs, command)
        if not why:
            write_json(metrics_of(target), record_at(target) | {"inputs": states})
            date(target, states, begun)
            return 0
        healed = [path for path in states if heal(Path(path))]
        if healed:
            _, states = cause(target, inputs, command)
        for path, now in states.items():
            refuse_corrupt(Path(path), now)
        if record_at(target):
            say(f"{target}: made again, because {why}")
        part = Path(f"{target}.part")
        try:
            return publish_part(target, part, states, command, begun)
        finally:
            # a full disk may stop any of this; half-written files must not stay
            shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink(missing_ok=True)


@contextmanager
def locked(target: Path) -> Iterator[int]:
    """Hold the lock of a target, so that one step at a time makes it; yield the file server's time, ns."""
    log_path = log_of(target)
    for folder in (target.parent, log_path.parent):
        folder.mkdir(parents=True, exist_ok=True)
    with log_path.with_suffix(".lock").open("a") as lock:
        try:
            take(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(f"{target}: another make is making it; waiting")
            take(lock, fcntl.LOCK_EX)
        os.utime(lock.fileno())
        yield os.fstat(lock.fileno()).st_mtime_ns


def date(path: Path, states: Mapping[str, State | None], begun: int) -> None:
    """Set a file's date to `begun`, ns, or to that of its newest input if that lies later."""
    at = max([begun, *(state[2] for state in states.values() if state)])
    os.utime(path, ns=(at, at))


def publish_part(target: Path, part: Path, states: dict[str, State | None], command: list[str], begun: int) -> int:
    """Run the command, write its record, and rename its output to the final name; return the exit code."""
    log_path = log_of(target)
    code, cost = run(command, log_path)
    if code == 0 and not part.exists():
        say(f"{target}: the command succeeded but wrote no {part}")
        code = cost["exit_code"] = 1
    cost |= {"target": str(target), "inputs": states, "counts": counts_in(log_path)}
    cost["bytes"] = part.stat().st_size if code == 0 else 0
    if code == 0:
        cost |= {"sha256": digest_of(part), "beside": made_with(target)}
        date(part, states, begun)
    write_json(metrics_of(target), cost)
    if code:
        report_failure(target, log_path, code, cost["interrupted"])
        return code if 0 < code < 126 else 1
    os.replace(part, target)
    show_notices(log_path)
    say(f"{target}  {cost['seconds']:.1f} s, {cost['peak_mib']:.0f} MiB{place_in(target)}")
    return 0


def run(command: list[str], log_path: Path) -> tuple[int, dict]:
    """Run a target's command with output to its log; return its exit code and the cost of all its processes."""
    started = time.time()
    slots, environment = handed_on(os.environ)
    environment.setdefault("TQDM_MININTERVAL", "10")  # seconds between two lines of a log
    with log_path.open("w", encoding="utf-8", errors="replace") as log:
        log.write(f"$ {' '.join(command)}\n")
        log.flush()
        # a signal that comes while the child is forked would be a traceback of Python's in the child
        usual = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
        launcher = shlex.split(environment.pop("GELFORGE_LAUNCHER", ""))
        child = os.fork()
        if not child:
            for slot in slots:
                os.set_inheritable(slot, True)
            become([*launcher, *command], environment, log.fileno(), usual, inside=not launcher)
        stopped = pass_on_stops(child)
        signal.pthread_sigmask(signal.SIG_SETMASK, usual)
        tell_progress(log_path)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        stopped.over = True
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
    """Wait for processes that the command left behind, such as a fork server: their cost belongs to the command."""
    until = time.monotonic() + LEFT_BEHIND_S
    with suppress(ChildProcessError):
        while time.monotonic() < until:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                time.sleep(0.01)


def become(command: list[str], environment: dict[str, str], log: int, usual: Iterable[int], inside: bool) -> NoReturn:
    """In the child: carry out `command` with output to the log, and end with its exit code.

    inside: whether `python -m MODULE WORDS` runs in this interpreter, which saves the start of another one.
    """
    code = 1
    try:
        os.dup2(log, 1)
        os.dup2(log, 2)
        begin(usual)
        if not inside or Path(command[0]).absolute() != Path(sys.executable) or command[1:2] != ["-m"]:
            os.execvpe(command[0], command, environment)
        os.environ.clear()
        os.environ.update(environment)
        sys.argv = command[2:]
        try:
            runpy.run_module(command[2], run_name="__main__", alter_sys=True)
            code = 0
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        except BaseException:
            traceback.print_exc()
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError as error:
        print(f"{command[0]}: {error.strerror}", file=sys.stderr, flush=True)
    finally:
        os._exit(code)  # without the ends of what the parent had begun, such as its lock


def begin(usual: Iterable[int]) -> None:
    """What the child does before its command: it ends with its parent, and a signal that waits ends it without a word."""
    die_with_parent()
    for name in STOPS:
        if signal.getsignal(name) is not signal.SIG_IGN:
            signal.signal(name, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, usual)


class Stopped(list):
    """Signals that came; over: whether the child has ended."""

    over = False


def pass_on_stops(child: int) -> Stopped:
    """From now on pass signals that tell this process to stop on to a child; return the list that collects them."""
    came = Stopped()

    def stop(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        if not came.over:
            with suppress(ProcessLookupError):
                os.kill(child, number)

    for name in STOPS:
        signal.signal(name, stop)
    return came


def tell_progress(log_path: Path) -> None:
    """From now on repeat the last line of a log on the terminal every TELL_S seconds, as long as it changes."""
    told = [""]

    def tell(_number: int, _frame: FrameType | None) -> None:
        last = next((line for line in reversed(lines_of(log_path)[1:]) if line.strip()), "")
        if last != told[0]:
            told[0] = last
            say(f"{log_path}: {last}")

    signal.signal(signal.SIGALRM, tell)
    signal.setitimer(signal.ITIMER_REAL, TELL_S, TELL_S)


def lines_of(log_path: Path) -> list[str]:
    """Lines of a log; each update of a progress bar is a line."""
    return log_path.read_text(encoding="utf-8", errors="replace").splitlines()


def counts_in(log_path: Path) -> dict:
    """Counts that a command printed: its last line, if that is a JSON table; else empty."""
    last = next((line for line in reversed(lines_of(log_path)) if line.strip()), "")
    try:
        found = json.loads(last)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def say(text: str) -> None:
    """Print text and its end of line in one write, so that steps that end at the same time do not mix their lines.

    `print` writes the end of line by itself if PYTHONUNBUFFERED is set.
    """
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def show_notices(log_path: Path) -> None:
    """Repeat the log's NOTICES on the terminal, because nobody reads the log of a step that succeeded."""
    if notices := [line for line in lines_of(log_path) if line.startswith(NOTICES)]:
        say("\n".join(notices))


def report_failure(target: Path, log_path: Path, code: int, interrupted: bool) -> None:
    """Print where the log is, and its last lines; for a run that a person stopped, only that it was interrupted."""
    if interrupted:
        say(f"{target}: interrupted; the same make goes on with it")
        return
    shown = [
        f"FAILED {target} (exit {code}); log: {log_path}",
        *(f"  | {line}" for line in lines_of(log_path)[-TAIL_LINES:]),
    ]
    say("\n".join(shown))


def expanded(words: Iterable[str]) -> Iterator[str]:
    """Inputs, with each @FILE replaced by the paths that FILE lists."""
    for word in words:
        if word.startswith("@"):
            yield from Path(word[1:]).read_text(encoding="utf-8").split()
        else:
            yield word


def main(argv: Sequence[str] | None = None) -> int:
    argv = sys.argv[1:] if argv is None else list(argv)
    split = argv.index("--") if "--" in argv else len(argv)
    die_with_parent()
    adopt_orphans()
    try:
        target, inputs = Path(argv[0]), list(dict.fromkeys(expanded(argv[1:split])))
        return build(target, inputs, argv[split + 1 :] or command_of(target))
    except KeyboardInterrupt:
        return 130
    except BadInput as error:
        say(f"{argv[0]}: {error}")
        return 2
    except OSError as error:
        say(f"{argv[0]}: {unwritable(error)}, then run make again")
        return 1


if __name__ == "__main__":
    sys.exit(main())
