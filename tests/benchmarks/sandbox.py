"""A project folder of its own, for benchmarks and tests that run make for real."""

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

# What an outer make leaves in the environment of what it runs.
OF_MAKE = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "GNUMAKEFLAGS", "MAKE_TERMERR", "MAKE_TERMOUT")
LINKED = ("Makefile", "rules", "src", "envs", ".venv", "pyproject.toml")


def link_project(root: Path, folder: Path) -> Path:
    """Lay a project in `folder`: linked code, its own workflow/, and empty data/ and results/."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in LINKED:
        (folder / name).symlink_to(root / name)
    shutil.copytree(root / "workflow", folder / "workflow")
    (folder / "data").mkdir()
    return folder


def clean_environment() -> dict[str, str]:
    """The environment without what an outer make put there."""
    return {key: value for key, value in os.environ.items() if key not in OF_MAKE}


def make(
    project: Path, *arguments: str, environment: Mapping[str, str] = MappingProxyType({}), **options
) -> subprocess.CompletedProcess:
    """Run make in a sandbox; standard output and error are in the answer's `stdout`. environment: beside what is set."""
    return subprocess.run(
        ["make", *arguments],
        cwd=project,
        env={**clean_environment(), **environment},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        **options,
    )
