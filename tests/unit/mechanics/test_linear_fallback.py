"""What happens where MKL is missing."""

import subprocess
import sys
from pathlib import Path

import pytest

SOLVE = """
import sys
sys.modules["pypardiso.pardiso_wrapper"] = None  # as if it were not installed: the import fails
import numpy as np, scipy.sparse as sp
from gelforge.mechanics.linear.factorisation import symmetric_solver
upper = sp.csr_matrix(np.array([[4.0, 1.0, 0.0], [0.0, 3.0, 1.0], [0.0, 0.0, 2.0]]))
for _ in range(2):
    solver = symmetric_solver(upper.indptr, upper.indices)
    solver.factorise(upper.data.astype(np.float32))  # as solvers assemble them
    full = upper + sp.triu(upper, 1).T
    assert np.allclose(full @ solver.solve(np.arange(3.0)), np.arange(3.0))
"""


@pytest.mark.processes
def test_without_mkl_solves_go_on_and_say_once_that_they_are_slow():
    env = {"PYTHONPATH": str(Path(__file__).parents[3] / "src"), "PATH": "/usr/bin:/bin"}
    done = subprocess.run([sys.executable, "-c", SOLVE], capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("makes solves four times as fast") == 1 and "pypardiso" in done.stderr
