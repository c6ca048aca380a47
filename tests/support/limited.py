"""Little disk space: a disk of 64 KiB, and Python run with a limit on the size of files, as if the disk were full."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A disk of 64 KiB at a folder; if it cannot be mounted, the test is skipped."""
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", folder]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small disk is not allowed here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def limited(kib: int, *words) -> subprocess.CompletedProcess:
    """Run `python -m WORDS` with files of at most `kib` KiB."""
    return limited_python(kib, "-m", *words)


def limited_python(kib: int, *words) -> subprocess.CompletedProcess:
    """Run `python WORDS` with files of at most `kib` KiB; without compiled files, which the limit would truncate."""
    command = [sys.executable, "-B", *map(str, words)]
    shell = ["bash", "-c", f'ulimit -f {kib}; exec "$@"', "limited"]
    return subprocess.run([*shell, *command], capture_output=True, text=True, check=False)
