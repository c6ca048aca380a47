"""A separate project folder for benchmarks and tests that run make for real, and small datasets in it."""

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from gelforge.flow.files import read_csv, write_csv, write_text

ROOT = Path(__file__).resolve().parents[2]  # the project
# Variables that an outer make sets in the environment of its commands.
OF_MAKE = ("MAKEFLAGS", "MAKEOVERRIDES", "MAKELEVEL", "MFLAGS", "GNUMAKEFLAGS", "MAKE_TERMERR", "MAKE_TERMOUT")
LINKED = ("Makefile", "rules", "src", "envs", ".venv", "pyproject.toml")

# dataset.toml of a log without images whose labels follow its own calibration, on hexahedra that are solved in seconds.
CALIBRATED = """
sensor = "gelsight_mini"
gel = "gelsight_mini"
[params.poses]
images = false
[params.interface]
law = "no_slip"
[params.material]
c10 = "calibrated"
[params.fea]
method = "draft"
tolerance = 0.2
[params.calibrate]
refine = "none"
[params.calibrate.solver]
size = 1.2
layers = 3
widened = []
press_steps = 8
"""


def link_project(root: Path, folder: Path) -> Path:
    """Make a project in `folder`: linked code, its own copy of workflow/, and an empty data/."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in LINKED:
        (folder / name).symlink_to(root / name)
    shutil.copytree(root / "workflow", folder / "workflow")
    (folder / "data").mkdir()
    return folder


def clean_environment() -> dict[str, str]:
    """The environment without the variables of an outer make."""
    return {key: value for key, value in os.environ.items() if key not in OF_MAKE}


def make(
    project: Path, *arguments: str, environment: Mapping[str, str] = MappingProxyType({}), **options
) -> subprocess.CompletedProcess:
    """Run make in a sandbox; `stdout` of the result holds standard output and error. environment: added variables."""
    return subprocess.run(
        ["make", *arguments],
        cwd=project,
        env={**clean_environment(), **environment},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        **options,
    )


# Coarse and in process, because the flow is tested here, not the mechanics; presses are straight and shallow for the same
# reason.
DEEPEST_MM = 0.25
FAST = """
[params.plan]
shard_size = 2

[params.interface]
law = "no_slip"

[params.fea]
method = "draft"
tolerance = 0.2
"""


# What makes the sandbox `whole` of tests/workflow as far as its report.
REPORTED = ("evaluate", "report", "MODEL=tiny", "DATASET=tiny", "RES=6x8")


def lay_dataset(project, root, name, count, overrides=FAST):
    """Copy the first `count` presses of the demo log, made shallow, into data/NAME of a sandbox."""
    demo, data = root / "data" / "demo", project / "data" / name
    rows = read_csv(demo / "log.csv")[:count]
    for row in rows:
        row |= {"dx_mm": "0", "dy_mm": "0", "dz_mm": str(max(float(row["dz_mm"]), -DEEPEST_MM))}
    write_csv(data / "log.csv", list(rows[0]), rows)
    base = (demo / "dataset.toml").read_text(encoding="utf-8").split("[params")[0]
    write_text(data / "dataset.toml", base + overrides)
    for row in rows:
        (data / row["image"]).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(demo / row["image"], data / row["image"])
    return data
