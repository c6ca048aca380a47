"""EXECUTOR=slurm on a real one-machine cluster: cost of a task, and the same forces as locally."""

import os
import shutil
import subprocess
import tempfile
import time
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.flow.cli import command, option, positive
from tests.support.cluster import Cluster, cluster, lay_project, make
from tests.support.figures import Figure, publish_figures
from tests.support.sandbox import clean_environment, link_project

ROOT = Path(__file__).resolve().parents[2]
PROFILE = ROOT / "envs" / "slurm-cluster.toml"
SHARDS = 1500


def bare_seconds(folder: Path, count: int) -> float:
    """Seconds that the work of `count` shards takes without make, two at a time."""
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


def overhead(folder: Path, lab: Cluster, count: int) -> list[Figure]:
    """Time of a task beyond its work."""
    lay_project(folder)
    shards = [str(k) for k in range(count)]
    some = shards[: -(-count // 5)]
    bare = bare_seconds(folder, len(some)) / len(some)
    of_some = (f"SHARDS={' '.join(some)}", "EXECUTOR=local", "DATASET=local")
    make(folder, lab, "poses", *of_some)  # a stage that is never a job
    started = time.monotonic()
    make(folder, lab, "fea", *of_some)
    local = (time.monotonic() - started) / len(some)
    (folder / "runs").rename(folder / "runs-local")
    (folder / "runs").mkdir()
    make(folder, lab, "poses", f"SHARDS={' '.join(shards)}", seconds=6 * 3600)
    started = time.monotonic()
    code, text = make(folder, lab, "fea", f"SHARDS={' '.join(shards)}", seconds=6 * 3600)
    each = (time.monotonic() - started) / count
    if code:
        raise RuntimeError(text)
    once = sum((folder / "runs" / f"fea-{shard}").read_text() == "started\nended\n" for shard in shards)
    parts = f"{1000 * each:.1f} ms a task in all, {1000 * bare:.1f} its work; load {os.getloadavg()[0]:.1f}"
    beyond = f"the same recipes without Slurm take {1000 * local:.1f} ms"
    return [
        Figure(f"overhead of each of {count} tasks", 1000 * (each - bare), "<=", 113, "ms", parts),
        Figure("of it beyond make's own local run", 1000 * (each - local), "<=", 50, "ms", beyond),
        Figure("tasks run exactly once", once, "==", count, "tasks"),
    ]


def demo_forces(folder: Path) -> list[Figure]:
    """The demo's forces through Slurm against those of a local run of the project."""
    subprocess.run(["make", "forces"], cwd=ROOT, env=clean_environment(), check=True)
    project = link_project(ROOT, folder)
    shutil.copytree(ROOT / "data" / "demo", project / "data" / "demo")
    # Without the results of the compared stages: poses, solves, forces and what follows.
    solved = shutil.ignore_patterns("10_poses", "30_fea", "[4-9]0_*", "calibrate", "pareto*", "stability")
    shutil.copytree(ROOT / "results" / "demo", project / "results" / "demo", ignore=solved)
    with cluster(memory_mb=20000) as lab:
        started = time.monotonic()
        code, text = make(project, lab, "forces", "EXECUTOR=slurm", f"SLURM_PROFILE={PROFILE}", seconds=6 * 3600)
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
