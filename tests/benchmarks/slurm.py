"""The Slurm executor against a real one-machine cluster: cost of a task, time to submit, same forces as locally."""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from argparse import Namespace
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from gelforge.flow.files import read_json, write_text
from gelforge.flow.main import command, option, positive
from tests.benchmarks.figures import Figure, publish_figures
from tests.benchmarks.sandbox import clean_environment, link_project

ROOT = Path(__file__).resolve().parents[2]
SHARDS = 1500

# The flow's own macros over a module that does what the file faults/NAME says, and nothing else.
MAKEFILE = """
MAKEFLAGS += -rR --warn-undefined-variables --output-sync=target
.SUFFIXES:
.DELETE_ON_ERROR:
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
export PYTHONPATH := $(CURDIR):$(CURDIR)/src
EXECUTOR ?= slurm
DATASET ?= lab
SHARDS ?= 0 1 2 3
RES := 24x32
JOBS := 2
PY := .venv/bin/python
SETUP := .venv/bin/python
NO_DATASET := help
D := results/$(DATASET)
wrapped = $(PY) -m gelforge.flow.step $@ $(filter $D/%,$^) -- $(PY) -m $(1)
ifeq ($(EXECUTOR),local)
MAKEFLAGS += -j2
step = @$(wrapped)
barrier =
else
include rules/00_given.mk
include rules/00_slurm.mk
endif
POSES := $(SHARDS:%=$D/10_poses/%.csv)
MESH_TABLES :=
FEA := $(SHARDS:%=$D/30_fea/%.csv)
FORCES := $(SHARDS:%=$D/40_forces/%.npz)
.PHONY: poses fea forces whole status
status:
	@$(PY) -m gelforge.commands.status --results $D
poses: $(POSES) $(call barrier,10_poses)
fea: $(FEA) $(call barrier,30_fea)
forces: $(FORCES) $(call barrier,40_forces)
whole: $D/70_train/whole.pt
$(POSES): $D/10_poses/%.csv: log.csv
	$(call step,work --name poses-$* --out $@.part $<)
$(FEA): $D/30_fea/%.csv: $D/10_poses/%.csv | $(call barrier,10_poses)
	$(call step,work --name fea-$* --out $@.part $<)
$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv | $(call barrier,30_fea)
	$(call step,work --name forces-$* --out $@.part $<)
$D/70_train/whole.pt: $(FORCES) | $(call barrier,40_forces)
	$(call step,work --name whole --out $@.part $^)
"""

WORK = """
import sys, os
name, out, inputs = sys.argv[2], sys.argv[4], sys.argv[5:]
text = "".join(open(path).read() for path in inputs)
with open(f"runs/{name}", "a") as stream:
    stream.write("started\\n")
if os.path.exists(f"faults/{name}"):
    exec(open(f"faults/{name}").read())
with open(out, "w") as stream:
    stream.write(text + name + "\\n")
with open(f"runs/{name}", "a") as stream:
    stream.write("ended\\n")
"""


class Cluster:
    """A Slurm cluster of one node on the loopback address, in a short temporary folder of its own."""

    def __init__(self, cpus: int = 2, memory_mb: int = 4000, extra: str = ""):
        self.folder = Path(tempfile.mkdtemp(prefix="gf-slurm-"))
        self.settings = {"SLURM_CPUS": str(cpus), "SLURM_MEMORY_MB": str(memory_mb), "SLURM_EXTRA": extra}

    def do(self, action: str, *daemon: str) -> None:
        """Run an action of envs/slurm-cluster.sh: start, stop, kill or lose."""
        command = [ROOT / "envs" / "slurm-cluster.sh", action, self.folder, *daemon]
        environment = {**os.environ, **self.settings}
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
        if done.returncode:
            raise RuntimeError(f"slurm-cluster.sh {action}: {done.stdout.decode(errors='replace')}")

    @property
    def environment(self) -> dict[str, str]:
        """What programs need to reach this cluster."""
        return {**clean_environment(), "SLURM_CONF": str(self.folder / "slurm.conf")}

    def ask(self, *command: str) -> str:
        """Run one of Slurm's programs and return its standard output."""
        return subprocess.run(command, env=self.environment, capture_output=True, text=True, check=True).stdout


@contextmanager
def cluster(cpus: int = 2, memory_mb: int = 4000, extra: str = ""):
    """Start a cluster and stop it at the end. extra: lines for slurm.conf."""
    made = Cluster(cpus, memory_mb, extra)
    try:
        made.do("start")
        yield made
    finally:
        made.do("stop")
        shutil.rmtree(made.folder, ignore_errors=True)


def lay_project(folder: Path, **settings) -> Path:
    """Lay a small project with the flow's Slurm rules over trivial work; `settings` change [default] of its profile."""
    for name in ("runs", "faults", "workflow"):
        (folder / name).mkdir(parents=True)
    for name in ("rules", "src", ".venv"):
        (folder / name).symlink_to(ROOT / name)
    write_text(folder / "Makefile", MAKEFILE)
    write_text(folder / "work.py", WORK)
    write_text(folder / "log.csv", "log\n")
    lay_profile(folder, **{"memory_mb": 50, "time_minutes": 5, "poll_seconds": 1.0, **settings})
    return folder


def lay_profile(folder: Path, **settings) -> None:
    """Write the project's profile with changed settings in [default]."""
    lines = []
    for line in (ROOT / "workflow" / "slurm.toml").read_text(encoding="utf-8").splitlines():
        key = line.partition(" = ")[0]
        value = settings.get(key)
        lines.append(
            line if value is None else f"{key} = {str(value) if not isinstance(value, str) else repr(value)}"
        )
    text = "\n".join(lines).partition("[fea]")[0]
    write_text(folder / "workflow" / "slurm.toml", text)


def start_make(folder: Path, lab: Cluster, *arguments: str) -> subprocess.Popen:
    """Start make in a project, in a process group of its own, its output in one pipe."""
    return subprocess.Popen(
        ["make", *arguments],
        cwd=folder,
        env=lab.environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def make(folder: Path, lab: Cluster, *arguments: str, seconds: float = 600) -> tuple[int, str]:
    """Run make in a project; return its exit code and its output."""
    process = start_make(folder, lab, *arguments)
    try:
        text, _ = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGTERM)
        raise
    return process.returncode, text


def record_of(folder: Path) -> dict:
    """The record of stage 10 as it stands, empty before there is one."""
    try:
        return read_json(folder / "results" / "lab" / ".slurm" / "10_poses.json")
    except FileNotFoundError:
        return {}


def bare_seconds(folder: Path, count: int) -> float:
    """Seconds that the work of `count` shards takes by itself, two at a time."""
    names = "\n".join(str(k) for k in range(count))
    command = [
        "xargs",
        "-P2",
        "-I{}",
        ".venv/bin/python",
        "-m",
        "work",
        "--name",
        "bare",
        "--out",
        "bare-{}",
        "log.csv",
    ]
    started = time.monotonic()
    environment = {**clean_environment(), "PYTHONPATH": f"{folder}:{folder / 'src'}"}
    subprocess.run(command, input=names, text=True, cwd=folder, env=environment, check=True)
    return time.monotonic() - started


def submitted_seconds(process: subprocess.Popen, folder: Path, started: float, count: int) -> tuple[float, list[int]]:
    """Wait until Slurm has all tasks of a make; return the seconds since `started` and the lengths of the arrays."""
    while process.poll() is None:
        taken = [len(batch["groups"]) for batch in record_of(folder).get("batches", []) if batch["job"]]
        if sum(taken) == count:
            return time.monotonic() - started, taken
        time.sleep(0.02)
    raise RuntimeError(process.stdout.read())


def overhead(folder: Path, lab: Cluster, count: int) -> list[Figure]:
    """What a task costs beyond its work, and how long make takes until Slurm has all of them."""
    lay_project(folder)
    shards = [str(k) for k in range(count)]
    some = shards[: -(-count // 5)]
    bare = bare_seconds(folder, len(some)) / len(some)
    started = time.monotonic()
    make(folder, lab, "poses", f"SHARDS={' '.join(some)}", "EXECUTOR=local", "DATASET=local")
    local = (time.monotonic() - started) / len(some)
    (folder / "runs").rename(folder / "runs-local")
    (folder / "runs").mkdir()
    started = time.monotonic()
    process = start_make(folder, lab, "poses", f"SHARDS={' '.join(shards)}")
    submitted, taken = submitted_seconds(process, folder, started, count)
    text, _ = process.communicate()
    each = (time.monotonic() - started) / count
    if process.returncode:
        raise RuntimeError(text)
    once = sum((folder / "runs" / f"poses-{shard}").read_text() == "started\nended\n" for shard in shards)
    # The same work with every result outdated: make removes each before it notes the task.
    later = time.time() + 2
    os.utime(folder / "log.csv", (later, later))
    started = time.monotonic()
    process = start_make(folder, lab, "poses", f"SHARDS={' '.join(shards)}")
    outdated, _ = submitted_seconds(process, folder, started, count)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate()
    parts = f"{1000 * each:.1f} ms a task in all, {1000 * bare:.1f} its work; load {os.getloadavg()[0]:.1f}"
    beyond = f"the same recipes without Slurm take {1000 * local:.1f} ms"
    return [
        Figure(f"overhead of each of {count} tasks", 1000 * (each - bare), "<=", 50, "ms", parts),
        Figure("of it beyond make's own local run", 1000 * (each - local), "<=", 50, "ms", beyond),
        Figure("until Slurm has all tasks", submitted, "<=", 5, "s", f"arrays of {taken}"),
        Figure("until it has them where all are outdated", outdated, "<=", 5, "s"),
        Figure("longest array", max(taken), "<=", 1000, "tasks"),
        Figure("tasks run exactly once", once, "==", count, "tasks"),
    ]


def demo_forces(folder: Path) -> list[Figure]:
    """The demo's forces through Slurm against those of the project's own local run."""
    subprocess.run(["make", "forces"], cwd=ROOT, env=clean_environment(), check=True)
    project = link_project(ROOT, folder)
    lay_profile(project, poll_seconds=2.0)
    shutil.copytree(ROOT / "data" / "demo", project / "data" / "demo")
    # The same meshes: what is compared are poses, solves and forces.
    solved = shutil.ignore_patterns(".slurm", "10_poses", "30_fea", "[4-9]0_*", "calibrate", "pareto*", "stability")
    shutil.copytree(ROOT / "results" / "demo", project / "results" / "demo", ignore=solved)
    with cluster(memory_mb=20000) as lab:
        started = time.monotonic()
        code, text = make(project, lab, "forces", "EXECUTOR=slurm", seconds=6 * 3600)
        seconds = time.monotonic() - started
    if code:
        raise RuntimeError(text)
    shards = sorted((ROOT / "results" / "demo" / "40_forces").glob("*.npz"))
    presses, differ = 0, 0
    for path in shards:
        ours, theirs = np.load(path), np.load(project / path.relative_to(ROOT))
        presses += len(ours["sample_id"])
        same = ours.files == theirs.files and all(np.array_equal(ours[key], theirs[key]) for key in ours.files)
        differ += not same
    note = f"{len(shards)} shards, {presses} presses, every array of every file; {seconds:.0f} s"
    return [Figure("shards of the demo whose forces differ from local ones", differ, "==", 0, "shards", note)]


@command(
    option("--out", type=Path),
    option("--only", choices=["overhead", "demo"], help="one part of it, for a quick look", default=None),
    option("--shards", type=positive, default=SHARDS, help="tasks; fewer only to try it out"),
)
def main(args: Namespace) -> None:
    figures = []
    with tempfile.TemporaryDirectory(prefix="gf-bench-") as scratch:
        if args.only != "demo":
            with cluster() as lab:
                figures += overhead(Path(scratch) / "trivial", lab, args.shards)
        if args.only != "overhead":
            figures += demo_forces(Path(scratch) / "demo")
    publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
