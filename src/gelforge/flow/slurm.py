"""EXECUTOR=slurm: run the tasks of make, shards of stage 30 or one training, as job arrays of `sbatch --wait`.

make writes one line per task, its target and its command, to a file for this module. The job name is unique, and jobs
are cancelled by it, so no job number is parsed from what sbatch prints. Success means a result file for each task:
exit code 0 of sbatch proves nothing, because a purged or cancelled job has it as well.
"""

import math
import os
import re
import secrets
import shlex
import shutil
import signal
import subprocess
import time
from argparse import Namespace
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.cli import command, option
from gelforge.flow.files import read_toml, write_text
from gelforge.flow.jobs import die_with_parent
from gelforge.flow.layout import log_of
from gelforge.flow.schema import ParameterTable, Place, parse
from gelforge.flow.step import TAIL_LINES, redated, say, show_notices
from gelforge.flow.tables import Count, FromNone, Line, Whole

PUBLISHED = Path("workflow/slurm.toml")
STOP = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
LOOK_EVERY_S = 0.5
SAID_EVERY_S = 25.0  # between two progress lines
GONE_AFTER = 60  # largest number of looks at the queue, half a second apart, until cancelled jobs must have left it
SHOWN, LISTED = 5, 50  # largest numbers of missing results shown with the end of their log, and listed by name
# Withheld from Slurm's programs and jobs: limits of an allocation in which make runs, users' filters, make's slots.
WITHHELD = ("SLURM_", "SQUEUE_", "SCANCEL_", "SBATCH_CLUSTERS", "MAKE", "MFLAGS", "GELFORGE_JOBS")
PASSED = ("SLURM_CONF", "SLURM_CLUSTERS")
KILLED = {  # the setting to raise, and what Slurm prints when it kills a task at that limit
    "memory_mb": r"(?im)^slurmstepd\S*: .*(exceeded (job |step )?memory limit|oom.kill)",
    "time_minutes": r"(?m)^slurmstepd\S*: .*DUE TO TIME LIMIT",
}

# Slurm starts a task again after its node was lost; existing results are not made twice.
SCRIPT = """#!/bin/bash
{setup}
set -euo pipefail
export OMP_NUM_THREADS={cores} MKL_NUM_THREADS={cores} OPENBLAS_NUM_THREADS={cores}
mapfile -t -s $(( (SLURM_ARRAY_TASK_ID - 1) * {each} )) -n {each} lines <{tasks}
failed=0
for line in "${{lines[@]}}"; do
    [ -s "${{line%%$'\\t'*}}" ] || (eval "exec ${{line#*$'\\t'}}") || failed=$?
done
echo "exit code $failed"
exit $failed
"""


class Profile(ParameterTable):
    """What one task of a stage may use; workflow/slurm.toml explains every field."""

    partition: Line
    account: Line
    time_minutes: Count
    memory_mb: Whole
    cores: Count
    shards_per_task: Count
    array_limit: Whole
    concurrent: Whole
    options: tuple[Line, ...]
    setup: tuple[Line, ...]
    visible_seconds: FromNone

    def fault(self) -> str | None:
        """Refuse options that name another cluster: scancel and squeue would not find its jobs."""
        if any(each.startswith(("-M", "--cl")) for each in self.options):
            return "options: name another cluster by export SLURM_CLUSTERS=NAME, which scancel reads too"
        return None

    def sbatch_options(self) -> list[str]:
        """Options of `sbatch` for one task."""
        given = {"partition": self.partition, "account": self.account, "mem": self.memory_mb and f"{self.memory_mb}M"}
        chosen = [f"--{name}={value}" for name, value in given.items() if value]
        size = [f"--cpus-per-task={self.cores}", f"--time={self.time_minutes}"]
        return ["--requeue", "--nodes=1", "--ntasks=1", *size, *chosen, *self.options]


def read_profile(path: Path, stage: str) -> Profile:
    """Return the profile of `stage`: for 30_fea [default], overridden by [fea]; BadInput names fault and file.

    A user's own file holds only what differs from PUBLISHED.
    """
    values: dict[str, Any] = {}
    tables = {file: read_toml(file) for file in dict.fromkeys([PUBLISHED, path])}
    for name in ("default", stage.lstrip("0123456789_")):
        for file, table in tables.items():
            own = table.get(name, {})
            values |= own if isinstance(own, dict) else {name: own}
            profile = parse(Profile, values, Place(str(file), (name,)))
    return profile


def environment() -> dict[str, str]:
    """The environment of Slurm's programs, which jobs inherit."""
    return {key: value for key, value in os.environ.items() if key in PASSED or not key.startswith(WITHHELD)}


def ask(*words: str) -> str:
    """Run one of Slurm's programs and return what it prints; GelforgeError with its message if it fails."""
    done = subprocess.run(words, env=environment(), capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        said = done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode}"
        raise GelforgeError(f"{shlex.join(words)}: {said}")
    return done.stdout


def longest_array(profile: Profile) -> int:
    """Most tasks of one job array: its highest index is MaxArraySize - 1, and max_array_tasks may be less."""
    if profile.array_limit:
        return profile.array_limit
    said = ask("scontrol", "show", "config")
    size, most = (re.search(rf"{name}\s*=\s*(\d+)", said) for name in ("MaxArraySize", "max_array_tasks"))
    return max(1, min(int(size[1]) - 1 if size else 1000, int(most[1]) if most else 10**9))


@dataclass(frozen=True)
class Task:
    """One target, the output file of its job, and the sbatch process that waits for it."""

    target: Path
    output: Path
    sbatch: subprocess.Popen

    def said(self) -> str:
        """Text of the output file, empty if nothing ran."""
        with suppress(FileNotFoundError):
            return self.output.read_text(encoding="utf-8", errors="replace")
        return ""


@dataclass
class Work:
    """The tasks of a stage, as job arrays with one unique name.

    folder: results/DATASET/.slurm/NAME, of scripts, lists and outputs; NAME is the jobs' name. file: of the profile.
    """

    stage: str
    folder: Path
    file: Path
    profile: Profile
    tasks: list[Task] = field(default_factory=list)

    def run(self, noted: dict[str, str]) -> int:
        """Submit the commands by target and wait for their results; return the exit code of the recipe."""
        left = None
        try:
            self.submit(noted)
            left = self.settle()
        finally:
            self.end()
            if self.tasks and left != []:
                self.cancel()
        if left is None:
            say(f"{self.stage}: interrupted, its Slurm jobs are cancelled")
            return 130
        return self.report(left)

    def submit(self, noted: dict[str, str]) -> None:
        """Start the commands in as few arrays as the cluster's limit allows, without waiting."""
        each, most = self.profile.shards_per_task, longest_array(self.profile)
        for first in range(0, len(noted), each * most):
            part, of = list(noted)[first : first + each * most], self.folder / str(first)
            write_text(of / "tasks", "".join(f"{target}\t{noted[target]}\n" for target in part))
            values = {"cores": self.profile.cores, "each": each, "tasks": shlex.quote(f"{of}/tasks")}
            write_text(of / "script", SCRIPT.format(setup="\n".join(self.profile.setup), **values))
            sbatch = self.start(of, math.ceil(len(part) / each))
            self.tasks += [Task(Path(target), of / f"{1 + k // each}.out", sbatch) for k, target in enumerate(part)]

    def start(self, of: Path, count: int) -> subprocess.Popen:
        """Start an sbatch that waits for an array of `count` tasks, whose script lies in the folder `of`."""
        indices = f"1-{count}" + (f"%{self.profile.concurrent}" if self.profile.concurrent else "")
        # After the profile's options, because the last value of an option wins.
        ours = ["--wait", f"--job-name={self.folder.name}", f"--array={indices}", f"--chdir={os.getcwd()}"]
        ours += [f"--output={str(of.absolute()).replace('%', '%%')}/%a.out", "--open-mode=truncate", f"{of}/script"]
        with (of / "sbatch").open("w") as output:
            # In its own process group, which `end` kills: sbatch may be a site's wrapper that passes no signal on.
            streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": output, "stderr": subprocess.STDOUT}
            words = ["sbatch", *self.profile.sbatch_options(), *ours]
            return subprocess.Popen(words, env=environment(), **streams, start_new_session=True)

    def settle(self) -> list[Task] | None:
        """Wait until all results exist, or the missing ones cannot come any more; return the tasks of those.

        None if make was asked to stop; main blocks those signals, so that only this method receives them.
        """
        until, started = math.inf, time.monotonic()
        said = started
        while True:
            over = all(task.sbatch.poll() is not None for task in self.tasks)
            left = self.missing()
            if over:
                until = min(until, time.monotonic() + self.profile.visible_seconds)
            if not left or time.monotonic() >= until or (over and all(map(self.cause, left))):
                return left
            if time.monotonic() >= said + SAID_EVERY_S:
                said = time.monotonic()
                done = len(self.tasks) - len(left)
                say(f"{self.stage} on Slurm: {done} of {len(self.tasks)} results, {said - started:.0f} s so far")
            if signal.sigtimedwait(STOP, LOOK_EVERY_S):
                return None

    def missing(self) -> list[Task]:
        """Tasks without a result, found by listing folders, which refreshes the caches of a network file system."""
        folders = {task.target.parent for task in self.tasks}
        there = {folder: set(os.listdir(folder)) if folder.is_dir() else set() for folder in folders}
        return [task for task in self.tasks if task.target.name not in there[task.target.parent]]

    def end(self) -> None:
        """Kill every sbatch that still waits."""
        for sbatch in {task.sbatch for task in self.tasks}:
            with suppress(ProcessLookupError):
                os.killpg(sbatch.pid, signal.SIGKILL)
            sbatch.wait()

    def cancel(self) -> None:
        """Cancel the jobs by name and wait until they have left the queue; GelforgeError if they stay."""
        ours = (f"--name={self.folder.name}", f"--user={os.getuid()}")
        for _ in range(GONE_AFTER):
            ask("scancel", *ours)
            queued = ask("squeue", "--noheader", *ours, "--states=PD,CF,R,S", "--format=%j")
            if self.folder.name not in queued.split():
                return
            time.sleep(0.5)
        raise GelforgeError(f"jobs stay in the queue; repeat: scancel {' '.join(ours)}")

    def cause(self, task: Task) -> str:
        """Why a task whose sbatch has ended left no result; empty if the result may still appear."""
        said = task.said()
        for setting, killed in KILLED.items():
            if re.search(killed, said):
                table = self.stage.lstrip("0123456789_")
                limit = f"its limit {setting} = {getattr(self.profile, setting)}"
                return f"killed at {limit}; raise it in {self.file} ([{table}] or [default])"
        codes = re.findall(r"(?m)^exit code ([1-9]\d*)$", said)
        if codes:
            return f"exit code {codes[-1]}"
        if "CANCELLED AT" in said:
            return "cancelled"
        return "it did not run" if task.sbatch.returncode and not said else ""

    def report(self, left: list[Task]) -> int:
        """Repeat the commands' notices, print which results are missing and why; return the exit code.

        The output of a failed task is kept beside its target's log, and its last lines are shown.
        """
        missing = set(left)
        for task in self.tasks:
            if task not in missing:
                show_notices(log_of(task.target))
        for path in sorted({task.output.with_name("sbatch") for task in left}):
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines()[-TAIL_LINES:]:
                say(f"sbatch: {line}")
        for k, task in enumerate(left):
            log = log_of(task.target).with_suffix(".slurm.log")
            write_text(log, task.said())
            if k < LISTED:
                say(f"FAILED {task.target}: {self.cause(task) or 'it left no result'}; log: {log}")
            for line in task.said().splitlines()[-TAIL_LINES:] if k < SHOWN else ():
                say(f"  | {line}")
        say(f"{self.stage} on Slurm: {len(self.tasks) - len(left)} of {len(self.tasks)} results")
        return max([1, *(task.sbatch.returncode for task in left)]) if left else 0


def put_back(target: Path, wrapped: str) -> bool:
    """Put back a target that make moved to TARGET.old if it is what its command would make, else remove it.

    Returns whether it was put back; it then has a new date.
    """
    old = Path(f"{target}.old")
    if not old.exists() or target.exists():
        old.unlink(missing_ok=True)
        return False
    os.replace(old, target)
    words = shlex.split(wrapped)
    split, first = words.index("--"), words.index(str(target)) + 1
    if redated(target, words[first:split], words[split + 1 :]):
        return True
    target.unlink()
    return False


@command(
    option("notes", type=Path, help="results/DATASET/.slurm/NAME, a line TARGET<tab>COMMAND each; it is removed"),
    option("--profile", type=Path, default=PUBLISHED, help="settings that differ from workflow/slurm.toml"),
)
def main(args: Namespace) -> int:
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)
    die_with_parent()  # by SIGTERM, so that jobs end with a make that is killed
    if not shutil.which("sbatch"):
        raise BadInput("sbatch: not found; EXECUTOR=slurm needs Slurm's programs on PATH")
    lines = args.notes.read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    args.notes.unlink()
    noted = dict(line.split("\t", 1) for line in lines if line)
    noted = {target: command for target, command in noted.items() if not put_back(Path(target), command)}
    if not noted:
        return 0
    stage = Path(min(noted)).relative_to(args.notes.parents[1]).parts[0]
    folder = args.notes.with_name(f"gelforge-{stage}-{secrets.token_hex(6)}")
    try:
        return Work(stage, folder, args.profile, read_profile(args.profile, stage)).run(noted)
    finally:
        # Without the list of tasks, a job that Slurm starts in spite of this does nothing.
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main.exit()
