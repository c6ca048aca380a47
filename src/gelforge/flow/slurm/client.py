"""Talking to Slurm's own programs: sbatch, squeue, scancel, scontrol."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import NamedTuple, TypeVar

from gelforge.errors import GelforgeError
from gelforge.flow.slurm.cluster import PUBLISHED, Profile

STOP = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
TRANSIENT = re.compile(
    r"unable to contact|timed out|temporar|try again|connection refused|zero bytes|no answer", re.IGNORECASE
)
# Of sites that allow so many jobs in the queue, and of a controller that holds no more (MaxJobCount).
FULL = re.compile(r"submit ?jobs? ?\w*limit|job submit limit|queue full|unable to accept job", re.IGNORECASE)
OVER_MEMORY = re.compile(r"exceeded (job |step )?memory limit|oom.kill", re.IGNORECASE)
OVER_TIME = re.compile(r"DUE TO TIME LIMIT")
WAITING = {"PENDING", "REQUEUED", "REQUEUE_HOLD", "REQUEUE_FED", "SPECIAL_EXIT", "RESV_DEL_HOLD"}
HELD = "launch failed"  # a task that Slurm could not start and holds back for ever
NODE_LOST = {"NODE_FAIL", "BOOT_FAIL", "PREEMPTED"}
FINAL = NODE_LOST | {"COMPLETED", "FAILED", "TIMEOUT", "DEADLINE", "OUT_OF_MEMORY", "CANCELLED"}
LEAST_ANSWER_S = 60.0
GONE_WITHIN_S = 10.0  # from scancel's answer until none of its jobs is left in the queue
# Inside an allocation of its own make would hand its limits on; its terminal is not the node's; formats are ours, and so
# is which jobs are meant, and on which cluster.
OURS = ("SLURM_", "SQUEUE_", "SCANCEL_", "SBATCH_CLUSTERS", "SBATCH_WAIT", "MAKE", "MFLAGS")

Answer = TypeVar("Answer")


class SlurmRefused(GelforgeError):
    """Slurm did not do what it was asked; carries Slurm's own words."""


class Interrupted(Exception):
    """make was asked to stop."""


class Element(NamedTuple):
    """One task of a job array as Slurm knows it; task 0 stands for all that were cancelled before they began."""

    name: str
    job: str
    task: int
    state: str
    status: int
    reason: str
    node: str = ""

    @property
    def refused(self) -> bool:
        """Whether sbatch was refused: Slurm then still lists a job, which failed without ever having been on a node."""
        return self.state == "FAILED" and not self.node

    @property
    def over(self) -> bool:
        """Whether it does not run any more and never will."""
        return self.state in FINAL or self.state == "COMPLETING"


def ran(*command: str, text: str = "", seconds: float = LEAST_ANSWER_S) -> tuple[str, str]:
    """Run one of Slurm's programs; return what it prints to both streams, or raise SlurmRefused with its words.

    Programs may be wrappers of a site: what one leaves behind when its time is over ends with it, lest it submits later.
    """
    env = {key: value for key, value in os.environ.items() if not key.startswith(OURS) or key == "SLURM_CONF"}
    pipe = subprocess.PIPE
    try:
        asked = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, env=env, start_new_session=True)
    except OSError as error:
        raise SlurmRefused(
            f"{command[0]}: {error.strerror}; EXECUTOR=slurm needs Slurm's programs on PATH"
        ) from error
    late = False
    with asked:
        try:
            said = asked.communicate(text.encode(), timeout=seconds)
        except subprocess.TimeoutExpired:
            late = True
            with suppress(ProcessLookupError):
                os.killpg(asked.pid, signal.SIGKILL)
            try:
                said = asked.communicate(timeout=LEAST_ANSWER_S)
            except subprocess.TimeoutExpired:  # what left the group holds its output open
                said = (b"", b"")
    out, errors = (stream.decode(errors="replace") for stream in said)
    words = errors.strip() or out.strip()
    if late:
        raise SlurmRefused(f"{command[0]}: no answer within {seconds:.0f} s {words}")
    if asked.returncode:
        raise SlurmRefused(f"{command[0]}: {words or f'ended with code {asked.returncode} without a word'}")
    return out, errors


def call(*command: str) -> str:
    """Run one of Slurm's programs and return what it prints; SlurmRefused with its words otherwise."""
    return ran(*command)[0]


def elements(names: Collection[str]) -> list[Element]:
    """What Slurm still knows of the jobs of these names. Their numbers are Slurm's own, not those of anybody's answer."""
    widths = {
        "ArrayJobID": 20,
        "ArrayTaskID": 20,
        "State": 20,
        "exit_code": 20,
        "Reason": 80,
        "NodeList": 20,
        "Name": 200,
    }
    asked = ",".join(f"{name}:{width}" for name, width in widths.items())
    mine = ("-u", str(os.getuid()), "-n", ",".join(names))  # by user, or the controller sends the jobs of all
    found = []
    for line in call("squeue", "-h", "-r", "-t", "all", *mine, "-O", asked).splitlines() if names else ():
        job, index, state, code = (line[20 * k : 20 * k + 20].strip() for k in range(4))
        reason, node, name = line[80:160].strip(), line[160:180].strip(), line[180:].strip()
        if name in names and job.isdecimal():
            of_one = int(index) if index.isdecimal() else 0
            found.append(Element(name, job, of_one, state, int(code) if code.isdecimal() else 0, reason, node))
    return found


def find_job(name: str) -> str:
    """Number of the first job of that name, empty where Slurm knows none."""
    return min((element.job for element in elements([name]) if not element.refused), key=int, default="")


def submit_job(name: str, options: list[str], script: str, profile: Profile) -> str:
    """Submit a job and return its number, which Slurm tells of the job's name whatever sbatch answers.

    SlurmRefused with sbatch's words where Slurm has no such job then.
    """
    command = ["sbatch", *options, "--parsable", f"--job-name={name}"]
    answers: list[str] = []
    seconds = max(LEAST_ANSWER_S, profile.submit_seconds)

    def ask() -> None:
        # After a failure or a lost answer the job may be there all the same: look before asking again.
        if answers and find_job(name):
            return
        answers.append("")
        answers[-1] = " ".join(" ".join(ran(*command, text=script, seconds=seconds)).split())

    try:
        patient(profile, ask)
    except SlurmRefused as refused:
        with suppress(SlurmRefused):
            if job := find_job(name):
                return job
        if FULL.search(str(refused)):
            raise SlurmRefused(
                f"{refused}; where so many jobs are too many for the cluster, raise shards_per_task (now"
                f" {profile.shards_per_task}) in the profile, {PUBLISHED} or SLURM_PROFILE's: fewer tasks then do the same work"
            ) from refused
        raise
    return patient(profile, lambda: find_job(name)) or confirmed(answers[-1], name)


def confirmed(answer: str, name: str) -> str:
    """The number in sbatch's answer that Slurm says is the job of that name, where squeue shows none (yet).

    SlurmRefused where there is none. One that a wrapper gave another name could not be found again, and is cancelled.
    """
    said = f"sbatch answered {answer[:300]!r}, and Slurm knows no job named {name}"
    for number in re.findall(r"\d+", answer)[:20]:
        with suppress(SlurmRefused):
            shown = call("scontrol", "-o", "show", "job", number).split()
            if f"JobName={name}" in shown:
                return number
            if any(word.startswith("StdOut=") and f"/{name}/" in word for word in shown):
                cancel_jobs([number])
                said += f": it gave job {number} another one, which is cancelled; let it keep --job-name"
                break
    else:
        said += ": cancel by hand what it may have queued where squeue does not look, such as another cluster"
    raise SlurmRefused(f"{said}; `type sbatch` shows what runs as sbatch here")


def array_limit(profile: Profile) -> int:
    """Longest job array the cluster takes: its highest index is MaxArraySize - 1, and max_array_tasks may be less."""
    said = patient(profile, lambda: call("scontrol", "show", "config"))
    found = re.search(r"MaxArraySize\s*=\s*(\d+)", said)
    tasks = re.search(r"max_array_tasks=(\d+)", said)
    limits = [profile.array_limit, int(found[1]) - 1 if found else 1000, int(tasks[1]) if tasks else 0]
    return min(limit for limit in (*limits, 10**9) if limit > 0)


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
    """Wait; Interrupted when make was asked to stop (the signals are blocked, so nothing else is cut short)."""
    if signal.sigtimedwait(STOP, seconds):
        raise Interrupted


def cancel_jobs(jobs: list[str]) -> None:
    """Cancel jobs by number; SlurmRefused where the controller does not answer."""
    try:
        call("scancel", *jobs)
    except SlurmRefused as error:
        # What has ended needs no cancelling.
        if "Invalid job id" not in str(error):
            raise


def cancel_named(names: Collection[str]) -> None:
    """Cancel all jobs of these names and see them gone; SlurmRefused where one stays or nobody answers."""
    until = time.monotonic() + GONE_WITHIN_S
    while left := sorted({element.job for element in elements(names) if not element.over}, key=int):
        if time.monotonic() > until:
            raise SlurmRefused(f"scancel: {', '.join(left)}: still in Slurm's queue after {GONE_WITHIN_S:.0f} s")
        cancel_jobs(left)
        time.sleep(0.2)


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
