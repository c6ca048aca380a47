"""First contact: seconds by the clock and of processor of the README's two commands and of the tests, in a fresh clone."""

import json
import os
import resource
import subprocess
import tempfile
import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gelforge.flow.cli import command, option
from tests.support.figures import PUBLISHED_DATA, Figure, publish_figures
from tests.support.sandbox import make

STEPS = ("setup", "demo", "again", "test")  # each needs those before it
GOALS = {"setup": 80, "demo": 150, "again": 0.1, "test": 180}  # seconds by the clock on two idle cores
CALIBRATION, BUSY, DISK = 50, 1.85, 3.5  # seconds of processor, cores, GB


@dataclass(frozen=True)
class Timed:
    """Seconds by the clock and of processor of one command, and the load of the machine as it began."""

    wall: float
    processor: float
    load: float


def timed(project: Path, goal: str) -> Timed:
    """Run make in a project; a failure raises RuntimeError with the end of what it said."""
    load, began = os.getloadavg()[0], time.monotonic()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = make(project, goal, environment={"GELFORGE_REFERENCE": str(PUBLISHED_DATA.resolve())})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"make {goal} failed:\n{done.stdout[-2000:]}")
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Timed(time.monotonic() - began, used, load)


def disk_gb(folder: Path) -> float:
    """Disk that a folder takes, GB; a file with several links counts once, and links lead nowhere."""
    blocks = {}
    for path, _, files in os.walk(folder):
        for name in files:
            about = os.lstat(os.path.join(path, name))
            blocks[about.st_dev, about.st_ino] = about.st_blocks
    return 512e-9 * sum(blocks.values())


def calibration_seconds(project: Path) -> float:
    """Processor seconds of the demo's calibration and of its pictures, by the records of their targets."""
    records = sorted((project / "results/demo/metrics/calibrate").glob("*.json"))
    return sum(json.loads(path.read_text(encoding="utf-8"))["cpu_seconds"] for path in records)


def measure(root: Path, steps: Sequence[str]) -> list[Figure]:
    """Clone the commit of `root` and run the steps in it, one after the other."""
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        project = Path(folder) / "clone"
        subprocess.run(["git", "clone", "--quiet", str(root), str(project)], check=True)
        for step in steps:
            took = timed(project, "demo" if step == "again" else step)
            note = f"fresh clone; {took.processor:.0f} s of processor; load {took.load:.1f} as it began"
            name = "make demo again" if step == "again" else f"make {step}"
            figures.append(Figure(name, took.wall, "<=", GOALS[step], "s", note))
            if step == "setup":
                figures.append(Figure("disk after make setup", disk_gb(project), "<=", DISK, "GB"))
            if step == "demo":
                figures.append(Figure("make demo: cores busy", took.processor / took.wall, ">=", BUSY))
                used = calibration_seconds(project)
                figures.append(Figure("make demo: calibration, processor time", used, "<=", CALIBRATION, "s"))
    return figures


@command(
    option("--until", choices=STEPS, default=STEPS[-1], help="the last step: setup, demo, again or test"),
    option("--out", type=Path, help="results/benchmarks/first.json"),
)
def main(args: Namespace) -> None:
    publish_figures(args.out, measure(Path.cwd(), STEPS[: STEPS.index(args.until) + 1]))


if __name__ == "__main__":
    main.exit()
