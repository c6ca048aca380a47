"""Solve two presses, so that numba compiles what solves need and keeps it beside the sources.

Usage: envs/kernels.py STAMP CCX_FOUND. Without it each process that solves first compiles for 10 to 30 s.
"""

import sys
from pathlib import Path

import gelforge

stamp, ccx = map(Path, sys.argv[1:])
method = "label" if ccx.read_text().strip() == "none" else "ccx"
print("compiling the solver")
for indenter, by in (("triangle_10", "draft"), ("sphere_10", method)):
    gelforge.label(gelforge.solve(indenter, 0.3, method=by))
stamp.touch()
