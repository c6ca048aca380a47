"""Time that make needs to find what is outdated of 15 000 samples over five stages: nothing, or one edited row."""

import os
import resource
import shutil
import tempfile
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.flow.cli import command, option, positive
from gelforge.flow.files import read_csv, states_of, write_csv, write_json
from gelforge.flow.layout import metrics_of
from gelforge.flow.runs import installed
from gelforge.records.forcefile import SampleForces, write_forces
from tests.support.figures import Figure, publish_figures
from tests.support.sandbox import link_project, make

SAMPLES = 15_000
REPEATS = 5
LOG_COLUMNS = [
    "sample_id",
    "time_utc",
    "sensor_id",
    "gel_id",
    "indenter",
    "x0_mm",
    "y0_mm",
    "z0_mm",
    "dx_mm",
    "dy_mm",
    "dz_mm",
    "rot_deg",
    "fx_n",
    "fy_n",
    "fz_n",
    "mx_nm",
    "my_nm",
    "mz_nm",
    "image",
]
FEA_COLUMNS = ["sample_id", "status", "reason", "method", "mesh", "file"]


def write_manifest(project: Path, root: Path, samples: int = SAMPLES) -> None:
    """Write a raw log of `samples` rows, and an empty image for each, because make looks at their times."""
    data = project / "data" / "synthetic"
    numbers = dict.fromkeys((c for c in LOG_COLUMNS if c.endswith(("_mm", "_deg", "_n", "_nm"))), "0.5")
    rows = [
        {
            **numbers,
            "sample_id": f"s{k:05d}",
            "time_utc": "",
            "sensor_id": "reference",
            "gel_id": "g1",
            "indenter": "sphere_15",
            "image": f"images/s{k:05d}.png",
        }
        for k in range(samples)
    ]
    write_csv(data / "log.csv", LOG_COLUMNS, rows)
    (data / "images").mkdir()
    for row in rows:
        (data / row["image"]).touch()
    shutil.copy(root / "data" / "demo" / "dataset.toml", data)


def timed_make(project: Path, *goals: str) -> float:
    """Run make in the synthetic project; return its processor time, s, which other load hardly changes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = make(project, "DATASET=synthetic", *goals)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if done.returncode:
        raise RuntimeError(f"make {' '.join(goals)} failed:\n{done.stdout[-2000:]}")
    return seconds


def replanned(project: Path, depth: str) -> float:
    """Edit the last row of the log and plan it; return the processor seconds of `make -n`."""
    log = project / "data" / "synthetic" / "log.csv"
    rows = read_csv(log)
    rows[-1]["x0_mm"] = depth
    write_csv(log, LOG_COLUMNS, rows)
    return timed_make(project, "-n", "labels")


def fill(project: Path) -> int:
    """Write each shard's files that status reads and the labels that make checks; return the number of shards."""
    results = project / "results" / "synthetic"
    node, force, still = np.zeros(1, np.int32), np.array([[0.0, 0.0, -1.0]]), np.zeros((1, 3), np.float32)
    shards = sorted((results / "00_plan" / "shards").glob("*.csv"))
    labels = results / "50_labels" / "24x32"
    for folder in (labels, results / "15_images"):
        folder.mkdir(parents=True)
    for shard in shards:
        ids = [row["sample_id"] for row in read_csv(shard)]
        poses = [{"sample_id": i, "sensor_id": "reference", "indenter": "sphere_15"} for i in ids]
        write_csv(results / "10_poses" / shard.name, ["sample_id", "sensor_id", "indenter"], poses)
        fea = [{"sample_id": i, "status": "OK", "method": "ccx", "mesh": "ccx-centre"} for i in ids]
        write_csv(results / "30_fea" / shard.name, FEA_COLUMNS, fea)
        samples = [SampleForces(name, "OK", "ccx-centre", node, force, still) for name in ids]
        write_forces(results / "40_forces" / f"{shard.stem}.npz", samples, 0.0725)
        (labels / f"{shard.stem}.npz").touch()
        beside = [shard.with_suffix(".json"), shard.with_name(f"{shard.stem}.pictures.json")]
        for stage, suffix, params in (
            ("10_poses", "csv", "poses"),
            ("30_fea", "csv", "fea"),
            ("40_forces", "npz", "forces"),
        ):
            target = results / stage / f"{shard.stem}.{suffix}"
            inputs = (shard, *beside, results / "00_plan/params" / f"{params}.json")
            write_json(metrics_of(target), record_of(project, target, len(ids), *inputs))
    return len(shards)


def record_of(project: Path, target: Path, samples: int, *inputs: Path) -> dict:
    """A record of a target as `step` would write it."""
    cost = {"started": 0.0, "seconds": 9.0, "cpu_seconds": 9.0, "peak_mib": 120.0, "bytes": 9, "exit_code": 0}
    states = states_of(inputs, {})
    about = {
        "target": str(target.relative_to(project)),
        "inputs": {os.path.relpath(path, project): state for path, state in states.items()},
        "counts": {"done": samples, "failed": {}},
        "programs": installed(),
    }
    return cost | about | {"interrupted": False, "sha256": "0" * 64, "command": ["python", "-m", "gelforge.stages"]}


def measure(root: Path, samples: int) -> list[Figure]:
    """Write the log, mark all targets as made, and time make and status with nothing to do."""
    with tempfile.TemporaryDirectory() as folder:
        project = link_project(root, Path(folder) / "project")
        write_manifest(project, root, samples)
        timed_make(project, "-n", "labels")  # reads the plan in, so that shards exist
        shards = fill(project)
        for stage in ("20_meshes", "calibrate"):
            (project / "results/synthetic" / stage).mkdir(exist_ok=True)
        timed_make(project, "-t", "labels")
        if make(project, "-q", "DATASET=synthetic", "labels").returncode:
            raise RuntimeError("the synthetic manifest is not up to date after make -t; the benchmark would lie")
        noop = min(timed_make(project, "labels") for _ in range(REPEATS))
        shown = min(timed_make(project, "-n", "labels") for _ in range(REPEATS))
        planned = min(replanned(project, f"0.{k}") for k in range(1, REPEATS + 1))
        status = min(timed_make(project, "status") for _ in range(REPEATS))
    note = f"{samples} samples, {shards} shards, 5 stages; processor time, best of {REPEATS}"
    return [
        Figure("no-op make", noop, "<=", 0.3, "s", note),
        Figure("no-op make -n", shown, "<=", 0.5, "s", note),
        Figure("make -n after one edited row: plan, and what would run", planned, "<=", 1.3, "s", note),
        Figure("no-op make status", status, "<=", 1.0, "s", note),
    ]


@command(
    option("--samples", type=positive, default=SAMPLES, help="fewer only to try it out"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    publish_figures(args.out, measure(Path.cwd(), args.samples))


if __name__ == "__main__":
    main.exit()
