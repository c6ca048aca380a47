"""Debian's own Python with GetFEM, an independent solver, and its program (python3-getfem, python3-scipy)."""

import subprocess
from pathlib import Path

PYTHON = "/usr/bin/python3"
PROGRAM = Path(__file__).parents[2] / "data/fea_challenge/outside_getfem.py"


def has_getfem() -> bool:
    """Whether Debian's own Python has GetFEM and SciPy, which the program needs."""
    asked = [PYTHON, "-c", "import getfem, scipy"]
    return Path(PYTHON).exists() and subprocess.run(asked, capture_output=True, check=False).returncode == 0
