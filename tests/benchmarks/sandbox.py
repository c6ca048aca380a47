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


def comma_language(folder: Path) -> dict[str, str] | None:
    """Settings of a language whose numbers have a comma, as German's and French's, made in `folder`; None where it cannot be."""
    source = folder / "comma"
    source.write_text(
        'LC_NUMERIC\ndecimal_point ","\nthousands_sep "."\ngrouping 3;3\nEND LC_NUMERIC\n', encoding="utf-8"
    )
    if shutil.which("localedef") is None:
        return None
    subprocess.run(["localedef", "-c", "-i", source, folder / "xx_XX"], capture_output=True, check=False)
    settings = {"LOCPATH": str(folder), "LC_NUMERIC": "xx_XX", "LC_ALL": ""}
    said = subprocess.run(
        ["stat", "-c", "%.9Y", source], env={**os.environ, **settings}, capture_output=True, text=True, check=True
    )
    return settings if "," in said.stdout else None
