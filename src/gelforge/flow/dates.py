"""What dates do not tell make: files that an older one replaced, that come or go, and results dated ahead of the clock.

Only the standard library: each make asks for it.
"""

import os
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import write_text
from gelforge.flow.layout import ESTIMATE, EXPORT, FEA, FEATS, LOGS, LOOK, METRICS, SAMPLES, Layout

NO_RESULTS = (LOGS, METRICS, SAMPLES, ESTIMATE, EXPORT, FEATS, LOOK)  # folders that make does not judge by date
APART_S = 3.0  # of clocks that are waited for


def state_of(path: str) -> str:
    """Times and size of a file or folder, links followed: they change with it. `absent` where there is none.

    The time of a change of its entry, too, which no program sets: a copy that keeps its date is another file.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return "absent"
    return f"{found.st_mtime_ns} {found.st_ctime_ns} {found.st_size}"


def states_of(paths: Iterable[Path | str]) -> dict[str, str]:
    """States by path."""
    return {str(path): state_of(str(path)) for path in paths}


def keep_states(file: Path, states: dict[str, str]) -> None:
    """Write states, one after the other; a name may hold any character but the null one."""
    write_text(file, "".join(f"{state}\t{path}\0" for path, state in states.items() if "\0" not in path))


def unchanged(file: Path) -> bool:
    """Whether all files that states were kept of are as they were."""
    try:
        states = file.read_text(encoding="utf-8", errors="surrogateescape").split("\0")[:-1]
    except OSError:
        return False
    known = (state.split("\t", 1) for state in states)
    return bool(states) and all(len(of) == 2 and state_of(of[1]) == of[0] for of in known)


def ahead(results: Path, since: float) -> list[str]:
    """Results of a dataset that were written after a time, seconds since 1970; solves of single presses left out."""
    found = []
    folders = [str(results)]
    while folders:
        folder = folders.pop()
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    name = os.path.relpath(entry.path, results)
                    if name not in NO_RESULTS and not name.startswith((".", f"{FEA}/")):
                        folders.append(entry.path)
                elif entry.stat(follow_symlinks=False).st_mtime > since:
                    found.append(entry.path)
    return sorted(found)


def refuse_ahead(results: Path) -> None:
    """BadInput where a result is dated ahead of this machine's clock: what is edited until then looks older, and stays unread.

    Clocks a moment apart, and what others write meanwhile, are waited for.
    """
    if not results.is_dir() or not ahead(results, time.time()):
        return
    time.sleep(APART_S - 1.0)
    late = ahead(results, time.time() + 1.0)
    if late:
        dated = time.strftime("%F %T", time.localtime(os.stat(late[0]).st_mtime))
        raise BadInput(
            f"{late[0]} is dated {dated}, and here it is {time.strftime('%F %T')}: make goes by dates, so what is edited before"
            f" that time would stay unread. Set the clocks of all machines that write here alike and wait until then, or"
            f" {Layout(results).command('clean-ahead')}, which removes what is dated ahead ({len(late)} files), but for solved"
            " presses, to be made again"
        )


def main() -> int:
    """Remove results of a dataset that are dated ahead; the table of shards stays, by which samples keep their shards."""
    results = Path(sys.argv[1])
    kept = str(Layout(results).shard_table)
    for path in ahead(results, time.time()) if results.is_dir() else ():
        if path == kept:
            os.utime(path)
        else:
            print(path)
            Path(path).unlink()
    Layout(results).plan().unlink(missing_ok=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
