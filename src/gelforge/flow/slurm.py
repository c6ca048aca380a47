"""EXECUTOR=slurm: a launcher in front of a command, which then runs as a job of the cluster.

`python -m gelforge.flow.slurm --profile FILE -- COMMAND…` submits the command by `sbatch --wait` and ends as the job
ends: make waits for it, fails with it and interrupts it as it does a local command. Give make as many jobs as the
cluster shall run at once. Exit code 0 of sbatch is no proof, because a cancelled or purged job has it as well: the
job's own last line is.
"""

import os
import re
import secrets
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.cli import exit_with
from gelforge.flow.files import read_toml
from gelforge.flow.jobs import die_with_parent
from gelforge.flow.schema import ParameterTable, Place, parse
from gelforge.flow.tables import Count, FromNone, Line, Whole

PUBLISHED = Path("workflow/slurm.toml")
# Withheld from Slurm's programs and jobs: limits of an allocation in which make runs, users' filters, make's slots.
WITHHELD = (
    "SLURM_",
    "SQUEUE_",
    "SCANCEL_",
    "SBATCH_CLUSTERS",
    "MAKE",
    "MFLAGS",
    "GELFORGE_JOBS",
    "GELFORGE_LAUNCHER",
)
PASSED = ("SLURM_CONF", "SLURM_CLUSTERS")
ENDED = "gelforge: exit code"  # begins the last line of a job's output
KILLED = {  # the setting to raise, and what Slurm prints when it kills a job at that limit
    "memory_mb": r"(?im)^slurmstepd\S*: .*(exceeded (job |step )?memory limit|oom.kill)",
    "time_minutes": r"(?m)^slurmstepd\S*: .*DUE TO TIME LIMIT",
}


class Profile(ParameterTable):
    """What one job of a stage may use; workflow/slurm.toml explains every field."""

    partition: Line
    account: Line
    time_minutes: Count
    memory_mb: Whole
    cores: Count
    options: tuple[Line, ...]
    setup: tuple[Line, ...]
    visible_seconds: FromNone

    def fault(self) -> str | None:
        """Refuse options that name another cluster: scancel would not find its jobs."""
        if any(each.startswith(("-M", "--cl")) for each in self.options):
            return "options: name another cluster by export SLURM_CLUSTERS=NAME, which scancel reads too"
        return None

    def sbatch_options(self) -> list[str]:
        """Options of `sbatch`."""
        given = {"partition": self.partition, "account": self.account, "mem": self.memory_mb and f"{self.memory_mb}M"}
        chosen = [f"--{name}={value}" for name, value in given.items() if value]
        size = [f"--cpus-per-task={self.cores}", f"--time={self.time_minutes}"]
        return ["--requeue", "--nodes=1", "--ntasks=1", *size, *chosen, *self.options]


def read_profile(path: Path, stage: str) -> Profile:
    """The profile of a stage: [default], overridden by its own table; a user's file holds what differs from PUBLISHED."""
    values: dict[str, Any] = {}
    tables = {file: read_toml(file) for file in dict.fromkeys([PUBLISHED, path])}
    for name in ("default", stage):
        for file, table in tables.items():
            own = table.get(name, {})
            values |= own if isinstance(own, dict) else {name: own}
            profile = parse(Profile, values, Place(str(file), (name,)))
    return profile


def environment() -> dict[str, str]:
    """The environment of Slurm's programs, which jobs inherit."""
    return {key: value for key, value in os.environ.items() if key in PASSED or not key.startswith(WITHHELD)}


def script_of(command: list[str], profile: Profile) -> str:
    """The script of a job: the lines of `setup`, of which none may fail, then the command, then its exit code."""
    cores = " ".join(f"{each}_NUM_THREADS={profile.cores}" for each in ("OMP", "MKL", "OPENBLAS"))
    said = f'echo "a line of setup failed: $BASH_COMMAND"; echo "{ENDED} 1"; exit 1'
    first = [f"trap {shlex.quote(said)} ERR", *profile.setup, "trap - ERR"] if profile.setup else []
    return "\n".join(["#!/bin/bash", *first, f"env {cores} {shlex.join(command)}", f'echo "{ENDED} $?"', ""])


def run(command: list[str], profile: Profile, file: Path, stage: str) -> int:
    """Run a command as a job, print its output, and return its exit code; GelforgeError if it left none."""
    name = f"gelforge-{stage}-{secrets.token_hex(6)}"
    folder = Path(tempfile.mkdtemp(prefix=".slurm-", dir="results"))
    script, output = folder / "script", folder / "out"
    script.write_text(script_of(command, profile))
    words = ["sbatch", "--wait", *profile.sbatch_options(), f"--job-name={name}", f"--chdir={os.getcwd()}",
             f"--output={str(output.absolute()).replace('%', '%%')}", "--open-mode=truncate", str(script)]  # fmt: skip
    said = ""
    try:
        sbatch = subprocess.Popen(words, env=environment(), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT, text=True, start_new_session=True)  # fmt: skip
        told, _ = sbatch.communicate()
        until = time.monotonic() + profile.visible_seconds
        while (
            time.monotonic() < until and ENDED not in said and not any(re.search(at, said) for at in KILLED.values())
        ):
            os.listdir(folder)  # refreshes the cache of a network file system
            said = output.read_text(encoding="utf-8", errors="replace") if output.exists() else ""
            if sbatch.returncode and not said:
                break
            time.sleep(0.0 if ENDED in said else 0.2)
    finally:
        if ENDED not in said:  # interrupted, or lost: no job may stay behind
            subprocess.run(["scancel", f"--name={name}", f"--user={os.getuid()}"], env=environment(), check=False)
        shutil.rmtree(folder, ignore_errors=True)
    body, _, code = said.rpartition(f"{ENDED} ")
    sys.stdout.write(body or said)
    if code.strip().isdecimal():
        return int(code)
    for setting, killed in KILLED.items():
        if re.search(killed, said):
            limit = f"{setting} = {getattr(profile, setting)}"
            raise GelforgeError(
                f"the job was killed at its limit {limit}; raise it in {file} ([{stage}] or [default])"
            )
    raise GelforgeError(
        f"the job left no exit code, it was cancelled or did not run; sbatch said: {told.strip() or 'nothing'}"
    )


STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def stop_once(*_: object) -> None:
    """Stop at the first signal. A terminal and make both send one; the second must not stop the scancel of the first."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def main(argv: list[str] | None = None) -> int:
    words = sys.argv[1:] if argv is None else argv
    if len(words) < 3 or words[0] != "--profile" or "-m" not in words:
        raise BadInput("usage: python -m gelforge.flow.slurm --profile FILE COMMAND…")
    if not shutil.which("sbatch"):
        raise BadInput("sbatch: not found; EXECUTOR=slurm needs Slurm's programs on PATH")
    stage = words[words.index("-m") + 1].rpartition(".")[2]
    for number in STOPS:
        signal.signal(number, stop_once)
    die_with_parent()  # by SIGTERM, so that the job ends with a make that is killed
    return run(words[2:], read_profile(Path(words[1]), stage), Path(words[1]), stage)


if __name__ == "__main__":
    exit_with(lambda argv: main())
