"""Run CalculiX as a child process that cannot outlive its parent."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import need_room
from gelforge.flow.jobs import die_with_parent
from gelforge.records.status import Status

_ENOUGH_BYTES = 1 << 20  # a disk with less free space counts as full
BANNER = "CalculiX Version"  # printed at the start of each run
LOOK_S = 0.05  # sampling interval of the memory of a run
OVERDUE = -signal.SIGALRM  # return code of a run that was stopped after its time limit


def ccx_program() -> str | None:
    """Path of the CalculiX program, or None.

    The one named by the environment variable CCX, if that is set; else `ccx` on PATH; else the one that envs/ccx.sh
    installs with conda inside the virtual environment.
    """
    if named := os.environ.get("CCX"):
        return shutil.which(named)
    return shutil.which("ccx") or shutil.which(str(Path(sys.prefix) / "conda/bin/ccx"))


def need_ccx() -> str:
    """Path of the CalculiX program; raises BadInput if there is none."""
    program = ccx_program()
    if program is None:
        raise BadInput(f"ccx: {Status.SOLVER_MISSING.value}")
    return program


@dataclass(frozen=True)
class Job:
    """A finished run: return code, log (stdout), seconds, peak resident memory of the process, MiB."""

    returncode: int
    log: str
    seconds: float
    peak_mib: float

    @property
    def iterations(self) -> int:
        """Newton iterations of all increments and attempts."""
        return self.log.count("largest residual force")

    @property
    def version(self) -> str:
        """The version that the program prints, such as 2.20; empty if it printed none."""
        found = re.search(rf"{BANNER}\s+([^\s,]+)", self.log)
        return found[1] if found else ""

    def reason(self) -> str:
        """The first error in the log, in one line."""
        for start, line in enumerate(lines := self.log.splitlines()):
            if "*ERROR" in line:
                return " ".join(" ".join(lines[start : start + 3]).split())[:200]
        if self.returncode == OVERDUE:
            return f"stopped after {self.seconds:.3g} s; raise timeout_s in [fea]"
        if self.returncode < 0:
            return f"stopped by {signal.Signals(-self.returncode).name}"
        return f"exit code {self.returncode} without a message"


def run_ccx(name: str, folder: Path | str, timeout_s: float) -> Job:
    """Run the deck `name`.inp in `folder` with one thread; a run past `timeout_s` is stopped.

    The .dat of an earlier run of that name is removed first, so that it cannot be taken for this run's. A full disk
    raises OSError, and a program that does not even print its name BadInput: every other sample would fail, too.
    """
    program = need_ccx()
    folder = Path(folder)
    (folder / f"{name}.dat").unlink(missing_ok=True)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1"}
    started = time.perf_counter()
    log_path = folder / f"{name}.log"
    with log_path.open("w") as log:
        child = subprocess.Popen(
            [program, name], cwd=folder, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
            env=environment, preexec_fn=partial(die_with_parent, signal.SIGKILL),
        )  # fmt: skip
        try:
            returncode, peak = _ended(child, timeout_s)
        except BaseException as stop:
            child.kill()
            child.wait()
            if not isinstance(stop, subprocess.TimeoutExpired):
                raise
            returncode, peak = OVERDUE, 0.0
    need_room(folder, _ENOUGH_BYTES)
    said = log_path.read_text(errors="replace")
    if returncode >= 0 and BANNER not in said:
        words = " ".join(said.split())[:200] or "nothing"
        raise BadInput(f"{program} is not a working CalculiX: it ended with code {returncode} and printed: {words}")
    return Job(returncode, said, time.perf_counter() - started, peak)


def _ended(child: subprocess.Popen, timeout_s: float) -> tuple[int, float]:
    """Return code of a program once it has ended, and its peak resident memory, MiB; TimeoutExpired after timeout_s.

    The memory is sampled every LOOK_S: the operating system's own count is the maximum over all children, and at
    least the memory of this process when it started them.
    """
    peak, until = 0.0, time.monotonic() + timeout_s
    while True:
        peak = max(peak, _peak_so_far(child.pid))
        try:
            return child.wait(min(LOOK_S, max(until - time.monotonic(), 0.0))), peak
        except subprocess.TimeoutExpired:
            if time.monotonic() >= until:
                raise


def _peak_so_far(pid: int) -> float:
    """Peak resident memory of a running process so far, MiB; 0 if it has ended."""
    try:
        found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    except OSError:
        return 0.0
    return int(found[1]) / 1024.0 if found else 0.0
