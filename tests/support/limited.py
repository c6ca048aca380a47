"""Little room for files: a disk of a few KiB, and Python run where none may grow larger, as if the disk ended there."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A disk of 64 KiB at a folder; where none can be mounted, the test is skipped."""
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", folder]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small disk is not allowed here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def limited(kib: int, *words) -> subprocess.CompletedProcess:
    """Run `python -m WORDS` so."""
    return limited_python(kib, "-m", *words)


def limited_python(kib: int, *words) -> subprocess.CompletedProcess:
    """Run `python WORDS` so; Python keeps no compiled files meanwhile, which the limit would cut off."""
    command = [sys.executable, "-B", *map(str, words)]
    shell = ["bash", "-c", f'ulimit -f {kib}; exec "$@"', "limited"]
    return subprocess.run([*shell, *command], capture_output=True, text=True, check=False)
