"""Flexible GMRES: it ends at the residual asked for, whatever preconditions it, or says early that it will not."""

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.mechanics.linear.gmres import gmres

SIZE = 30


def system(seed, skew=0.3):
    """A matrix (n, n) near a positive definite one that is not symmetric, and a right-hand side (n,)."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(SIZE, SIZE))
    return a @ a.T / SIZE + np.eye(SIZE) + skew * (a - a.T), rng.normal(size=SIZE)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.2, 3e-2, 1e-6]), st.floats(1e-6, 1e6))
@settings(max_examples=30, deadline=None)
def test_what_is_found_leaves_the_residual_asked_for(seed, tolerance, scale):
    matrix, b = system(seed)
    b *= scale
    found = gmres(lambda x: matrix @ x, lambda r: r, b, tolerance, 10 * SIZE)
    assert np.linalg.norm(b - matrix @ found) <= tolerance * np.linalg.norm(b) * (1 + 1e-6)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_preconditioner_may_change_from_step_to_step(seed):
    """That is what is flexible: each direction is kept as it was when it was taken."""
    matrix, b = system(seed)
    rng = np.random.default_rng(seed)
    found = gmres(lambda x: matrix @ x, lambda r: r * rng.uniform(0.5, 2.0, SIZE), b, 1e-8, 10 * SIZE)
    assert np.linalg.norm(b - matrix @ found) <= 1e-8 * np.linalg.norm(b) * (1 + 1e-6)


def test_the_inverse_needs_one_product():
    matrix, b = system(1)
    calls = []

    def apply(x):
        calls.append(1)
        return matrix @ x

    inverse = np.linalg.inv(matrix)
    np.testing.assert_allclose(gmres(apply, lambda r: inverse @ r, b, 1e-9, 5), inverse @ b, rtol=1e-9)
    assert len(calls) == 1


@pytest.mark.parametrize("limit", [4, 12])
def test_a_pace_that_does_not_suffice_is_reported_before_the_limit(limit):
    matrix, b = system(2, skew=3.0)
    calls = []

    def apply(x):
        calls.append(1)
        return matrix @ x

    assert gmres(apply, lambda r: r, b, 1e-10, limit) is None
    assert len(calls) == 3  # of that many the pace is estimated


def test_no_load_has_no_answer_but_zero():
    assert not gmres(lambda x: x, lambda r: r, np.zeros(SIZE), 1e-3, 5).any()


@pytest.mark.filterwarnings("error")
def test_a_matrix_of_zeros_has_no_answer():
    assert gmres(np.zeros_like, lambda r: r, np.ones(SIZE), 1e-3, 5) is None


ON_THREADS = """
import hashlib
import numpy as np
from gelforge.mechanics.linear.gmres import gmres

rng = np.random.default_rng(1)
scale, b = rng.uniform(1.0, 3.0, 60_000), rng.normal(size=60_000)
x = gmres(lambda v: scale * v + 0.1 * np.roll(v, 1), lambda v: v, b, 1e-6, 60)
print(hashlib.sha256(x.tobytes()).hexdigest())
"""


@pytest.mark.processes
def test_the_threads_of_blas_change_nothing():
    """Nor do they take part: where cores are busy, each inner product waited for all of them."""
    reported = {
        subprocess.run(
            [sys.executable, "-c", ON_THREADS], capture_output=True, text=True, check=True,
            env=os.environ | dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), threads),
        ).stdout
        for threads in ("1", "2", "4")
    }  # fmt: skip
    assert len(reported) == 1
