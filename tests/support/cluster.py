"""A real Slurm cluster of one node, and a small project with the flow's own rules for Slurm."""

import json
import os
import shutil
import signal
import subprocess
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from gelforge.flow.files import write_text
from tests.support.sandbox import clean_environment

ROOT = Path(__file__).resolve().parents[2]

NEEDS_SLURM = [
    pytest.mark.slurm,
    pytest.mark.skipif(
        not shutil.which("slurmd", path=f"{os.environ.get('PATH', '')}:/usr/sbin"),
        reason="Slurm is absent; make test installs slurm-wlm and munge where it may",
    ),
]

# The flow's own launcher in front of a trivial module that runs the code in the file faults/NAME.
MAKEFILE = """
MAKEFLAGS += -rR --warn-undefined-variables
.SUFFIXES:
.DELETE_ON_ERROR:
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
export PYTHONPATH := $(CURDIR):$(CURDIR)/src
EXECUTOR ?= slurm
DATASET ?= lab
SHARDS ?= 0 1 2 3
JOBS := 8
PY := .venv/bin/python
ONLY_SHOWN :=
D := results/$(DATASET)
SLURM_PROFILE := own.toml
include rules/run.mk
step = @$(LAUNCHED) $(PY) -m gelforge.flow.step $@ $^ -- $(PY) -m $(strip $1)
POSES := $(SHARDS:%=$D/10_poses/%.csv)
FEA := $(SHARDS:%=$D/30_fea/%.csv)
FORCES := $(SHARDS:%=$D/40_forces/%.npz)
.PHONY: poses fea forces whole
poses: $(POSES)
fea: $(FEA)
forces: $(FORCES)
whole: $D/70_train/whole.pt
$(POSES): $D/10_poses/%.csv: log.csv
	$(call step,work --name poses-$* --out $@.part $<)
$(FEA): $D/30_fea/%.csv: $D/10_poses/%.csv
	$(call step,work --name fea-$* --out $@.part $<)
$(FORCES): $D/40_forces/%.npz: $D/30_fea/%.csv
	$(call step,work --name forces-$* --out $@.part $<)
$D/70_train/whole.pt: $(FORCES)
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


# Stops a cluster when the process that uses it has ended, however it ended.
GUARD = 'while kill -0 "$1" 2>/dev/null; do sleep 1; done; "$2" stop "$3"; rm -rf "$3"'


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
        """Environment in which programs reach this cluster."""
        return {**clean_environment(), "SLURM_CONF": str(self.folder / "slurm.conf")}

    def ask(self, *command: str) -> str:
        """Run one of Slurm's programs and return its standard output."""
        return subprocess.run(command, env=self.environment, capture_output=True, text=True, check=True).stdout


@contextmanager
def cluster(cpus: int = 2, memory_mb: int = 4000, extra: str = ""):
    """Start a cluster and stop it at the end. extra: lines for slurm.conf."""
    made = Cluster(cpus, memory_mb, extra)
    words = ["bash", "-c", GUARD, "guard", str(os.getpid()), str(ROOT / "envs/slurm-cluster.sh"), str(made.folder)]
    guard = subprocess.Popen(
        words,
        start_new_session=True,
        env=os.environ | made.settings,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        made.do("start")
        yield made
    finally:
        guard.kill()
        guard.wait()
        made.do("stop")
        shutil.rmtree(made.folder, ignore_errors=True)


def lay_project(folder: Path, **settings) -> Path:
    """Write a small project with the flow's rules for Slurm and trivial work. settings: [default] of its profile."""
    for name in ("runs", "faults", "workflow"):
        (folder / name).mkdir(parents=True)
    for name in ("rules", "src", ".venv", "workflow/slurm.toml"):
        (folder / name).symlink_to(ROOT / name)
    write_text(folder / "Makefile", MAKEFILE)
    write_text(folder / "work.py", WORK)
    write_text(folder / "log.csv", "log\n")
    lay_profile(folder, **settings)
    return folder


def lay_profile(folder: Path, **settings) -> None:
    """Write the project's own profile."""
    values = {"memory_mb": 50, "time_minutes": 5, "visible_seconds": 3, **settings}
    text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())
    write_text(folder / "own.toml", f"[default]\n{text}")


def start_make(folder: Path, lab: Cluster, *arguments: str, **environment: str) -> subprocess.Popen:
    """Start make in a project, in a process group of its own, its output in one pipe."""
    return subprocess.Popen(
        ["make", *arguments],
        cwd=folder,
        env={**lab.environment, **environment},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def make(folder: Path, lab: Cluster, *arguments: str, seconds: float = 600, **environment: str) -> tuple[int, str]:
    """Run make in a project; return its exit code and its output."""
    process = start_make(folder, lab, *arguments, **environment)
    try:
        text, _ = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGTERM)
        raise
    return process.returncode, text
