"""A module run where files may grow to a few KiB only, as if the disk ended there."""

import subprocess
import sys


def limited(kib: int, *words) -> subprocess.CompletedProcess:
    """Run `python -m WORDS` so; Python keeps no compiled files meanwhile, which the limit would cut off."""
    command = [sys.executable, "-B", "-m", *map(str, words)]
    shell = ["bash", "-c", f'ulimit -f {kib}; exec "$@"', "limited"]
    return subprocess.run([*shell, *command], capture_output=True, text=True, check=False)
