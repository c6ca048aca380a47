"""Talking to Slurm's own programs: sbatch, squeue, scancel, scontrol."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from typing import TypeVar

from gelforge.errors import GelforgeError
from gelforge.flow.slurm.cluster import Profile

STOP = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
TRANSIENT = re.compile(
    r"unable to contact|timed out|temporar|try again|connection refused|zero bytes|no answer", re.IGNORECASE
)
OVER_MEMORY = re.compile(r"exceeded (job |step )?memory limit|oom.kill", re.IGNORECASE)
OVER_TIME = re.compile(r"DUE TO TIME LIMIT")
WAITING = {"PENDING", "REQUEUED", "REQUEUE_HOLD", "REQUEUE_FED", "SPECIAL_EXIT", "RESV_DEL_HOLD"}
HELD = "launch failed"  # a task that Slurm could not start and holds back for ever
NODE_LOST = {"NODE_FAIL", "BOOT_FAIL", "PREEMPTED"}
FINAL = NODE_LOST | {"COMPLETED", "FAILED", "TIMEOUT", "DEADLINE", "OUT_OF_MEMORY", "CANCELLED"}


Answer = TypeVar("Answer")


class SlurmRefused(GelforgeError):
    """Slurm did not do what it was asked; carries Slurm's own words."""


class Interrupted(Exception):
    """make was told to stop."""


def call(*command: str, text: str = "", seconds: float = 60.0) -> str:
    """Run one of Slurm's programs and return what it prints; SlurmRefused with its words otherwise."""
    # Inside an allocation of its own make would hand its limits on; its terminal is not the node's; formats are ours.
    ours = ("SLURM_", "SQUEUE_", "MAKE", "MFLAGS")
    env = {key: value for key, value in os.environ.items() if not key.startswith(ours) or key == "SLURM_CONF"}
    try:
        asked = subprocess.run(
            command, input=text, capture_output=True, text=True, timeout=seconds, env=env, check=False
        )
    except FileNotFoundError as error:
        raise SlurmRefused(f"{command[0]}: not found; EXECUTOR=slurm needs Slurm's programs on PATH") from error
    except subprocess.TimeoutExpired as error:
        words = (error.stderr or b"").decode(errors="replace").strip()
        raise SlurmRefused(f"{command[0]}: no answer within {seconds:.0f} s {words}") from error
    if asked.returncode:
        raise SlurmRefused(f"{command[0]}: {asked.stderr.strip() or asked.stdout.strip()}")
    return asked.stdout


def queue(jobs: list[str]) -> dict:
    """Return {(job, index): (state, wait status, reason)} of all elements of job arrays that Slurm still knows."""
    widths = {"ArrayJobID": 20, "ArrayTaskID": 20, "State": 20, "exit_code": 20, "Reason": 80}
    asked = ",".join(f"{name}:{width}" for name, width in widths.items())
    try:
        text = call("squeue", "-h", "-r", "-t", "all", "-j", ",".join(jobs), "-O", asked) if jobs else ""
    except SlurmRefused as error:
        # A finished job is forgotten after MinJobAge; asking for it alone is then an error.
        if "Invalid job id" not in str(error):
            raise
        text = ""
    known = {}
    for line in text.splitlines():
        job, index, state, code, reason = (line[20 * k : 20 * k + 20 + 60 * (k == 4)].strip() for k in range(5))
        if index.isdigit():
            known[job, int(index)] = (state, int(code) if code.isdigit() else 0, reason)
    return known


def array_limit(profile: Profile) -> int:
    """Longest job array the cluster takes: its highest index is MaxArraySize - 1."""
    found = re.search(r"MaxArraySize\s*=\s*(\d+)", patient(profile, lambda: call("scontrol", "show", "config")))
    largest = max(int(found[1]) - 1, 1) if found else 1000
    return min(profile.array_limit or largest, largest)


def find_job(name: str) -> str:
    """Id of the job array of that name, empty where Slurm knows none."""
    return next(iter(call("squeue", "-h", "-t", "all", "-n", name, "-o", "%F").split()), "")


def patient(profile: Profile, ask: Callable[[], Answer]) -> Answer:
    """Return ask(), trying again while the controller is busy or away, for as long as the profile allows."""
    until = time.monotonic() + profile.submit_seconds
    while True:
        try:
            return ask()
        except SlurmRefused as error:
            if not TRANSIENT.search(str(error)) or time.monotonic() >= until:
                raise
        pause(2.0)


def pause(seconds: float) -> None:
    """Wait; Interrupted when make was told to stop (the signals are blocked, so nothing else is cut short)."""
    if signal.sigtimedwait(STOP, seconds):
        raise Interrupted


def cancel_jobs(jobs: list[str]) -> None:
    """Cancel job arrays; SlurmRefused where the controller does not answer."""
    try:
        call("scancel", *jobs)
    except SlurmRefused as error:
        # What has ended needs no cancelling.
        if "Invalid job id" not in str(error):
            raise


def cause_of(state: str, status: int, reason: str, output: str) -> tuple[str, str]:
    """Return why a task ended without its result: (memory, time, node, error or unknown; a sentence)."""
    if state == "OUT_OF_MEMORY" or (state in ("FAILED", "CANCELLED") and OVER_MEMORY.search(output)):
        return "memory", "killed at its memory limit"
    if state in ("TIMEOUT", "DEADLINE") or (state == "CANCELLED" and OVER_TIME.search(output)):
        return "time", "killed at its time limit"
    if HELD in reason:
        return "node", f"could not be started on its node ({reason})"
    if state in NODE_LOST or (state == "FAILED" and not output and reason == "JobLaunchFailure"):
        return "node", f"lost with its node ({state}, {reason})"
    if state == "CANCELLED":
        return "error", "cancelled by somebody else"
    if state == "FAILED":
        how = f"signal {status & 127}" if status & 127 else f"exit {status >> 8}"
        return "error", f"failed ({how})"
    return "unknown", f"left no result ({state or 'Slurm knows nothing of it any more'})"
