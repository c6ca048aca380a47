"""Direct solvers for sparse symmetric systems: one symbolic factorisation, many numerical ones."""

import ctypes
import os
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import SolveFailed

_ANALYSE, _FACTORISE, _SOLVE, _RELEASE = 11, 22, 33, -1
_POSITIVE_DEFINITE, _INDEFINITE = 2, -2
_NOT_POSITIVE = -4  # PARDISO's error code for a zero pivot or, in a Cholesky factorisation, a negative one


def symmetric_solver(indptr: np.ndarray, indices: np.ndarray, order: np.ndarray | None = None) -> "Pardiso | SuperLU":
    """Solver for the pattern of an upper triangle in CSR form: MKL PARDISO, or SuperLU if MKL is missing.

    indptr: (n + 1,), indices: (nnz,), sorted columns, diagonal first in each row, counting from 0. order: (n,)
    fill-in reducing elimination order of the unknowns, if the caller knows one.
    """
    try:
        _mkl()
    except ImportError as error:
        _report_superlu(str(error))
        return SuperLU(indptr, indices)
    return Pardiso(indptr, indices, order)


@lru_cache(maxsize=1)
def _report_superlu(why: str) -> None:
    """Warn once per process that solves are several times slower than with MKL."""
    print(
        f"solving with SuperLU, because MKL's PARDISO cannot be loaded ({why}); `pip install pypardiso` (1 GB on disk) makes"
        " solves four times as fast",
        file=sys.stderr,
        flush=True,
    )


@lru_cache(maxsize=1)
def _mkl() -> Any:
    """PARDISO's entry point in mkl_rt, loaded once per process."""
    # where pip installs it; without this, importing pypardiso searches every folder of the environment: half a second
    for library in (Path(sys.prefix) / "lib").glob("libmkl_rt.so*"):
        os.environ.setdefault("PYPARDISO_MKL_RT", str(library))
    from pypardiso.pardiso_wrapper import PyPardisoSolver

    return PyPardisoSolver(mtype=_INDEFINITE)  # its own calls are not used


class Pardiso:
    """MKL PARDISO for real symmetric matrices (oneMKL reference, `pardiso`, mtype 2 and -2).

    Cholesky is tried first, at a little over half the cost. Tangents of deep presses are not always positive
    definite; if Cholesky fails, the same values are factorised as indefinite. The pattern is analysed once for each
    kind; `factorise` takes new values only. Factors are in single precision, which is 1.7 times faster: a Newton
    direction exact to 1e-6 loses no convergence, because residuals are in double precision.

    order: (n,) elimination order of the unknowns, from a mesh's geometry; None: METIS finds one.
    """

    name = "pardiso"

    def __init__(self, indptr: np.ndarray, indices: np.ndarray, order: np.ndarray | None = None) -> None:
        self.size = len(indptr) - 1
        self._indptr = np.ascontiguousarray(indptr, np.int32)
        self._indices = np.ascontiguousarray(indices, np.int32)
        self._order = None if order is None else np.ascontiguousarray(order, np.int32)
        self._factors: dict[int, _Factor] = {}
        self._current: _Factor | None = None

    def factorise(self, data: np.ndarray) -> None:
        """Factorise the matrix with upper-triangle values `data` (nnz,); raises SolveFailed if it is singular."""
        for kind in (_POSITIVE_DEFINITE, _INDEFINITE):
            factor = self._factors.get(kind)
            if factor is None:
                factor = self._factors[kind] = _Factor(kind, self._indptr, self._indices, self._order)
            error = factor.factorise(data)
            if not error:
                self._current = factor
                return
            if error != _NOT_POSITIVE:
                break
        raise SolveFailed(f"PARDISO cannot factorise, error {error}", {"pardiso_error": error})

    def solve(self, b: np.ndarray) -> np.ndarray:
        """Solution x (n,) of the system factorised last; raises SolveFailed if there is none."""
        b = np.asarray(b, np.float64)
        scale = float(np.abs(b).max(initial=0.0)) or 1.0
        if self._current is None:
            raise SolveFailed("nothing was factorised yet")
        x = self._current.solve(np.ascontiguousarray(b / scale, np.float32))
        return x.astype(np.float64) * scale


class _Factor:
    """One kind of factorisation of one pattern, and the memory that MKL holds for it."""

    def __init__(self, kind: int, indptr: np.ndarray, indices: np.ndarray, order: np.ndarray | None) -> None:
        self._library, self._kind = _mkl(), kind
        self._indptr, self._indices = indptr, indices
        self._handle = np.zeros(64, np.int64)
        self._options = _pardiso_options()
        self._order = np.zeros(len(indptr) - 1, np.int32) if order is None else order
        self._options[4] = 0 if order is None else 1
        self._none = np.zeros(1, np.float32)
        self._data = np.zeros(len(indices), np.float32)
        self._analysed = False

    def factorise(self, data: np.ndarray) -> int:
        """PARDISO's error code, 0 on success."""
        self._data[:] = data
        if not self._analysed:
            error = self._call(_ANALYSE, self._none, self._none)
            if error:
                return error
            self._analysed = True
        return self._call(_FACTORISE, self._none, self._none)

    def solve(self, b: np.ndarray) -> np.ndarray:
        x = np.empty_like(b)
        error = self._call(_SOLVE, b, x)
        if error:
            raise SolveFailed(f"PARDISO cannot solve, error {error}", {"pardiso_error": error})
        return x

    def _call(self, phase: int, b: np.ndarray, x: np.ndarray) -> int:
        integer = ctypes.c_int32
        error = integer(0)
        as_int = ctypes.POINTER(integer)
        self._library._mkl_pardiso(
            self._handle.ctypes.data_as(ctypes.POINTER(ctypes.c_int64)),
            integer(1), integer(1), integer(self._kind), integer(phase), integer(len(self._indptr) - 1),
            self._data.ctypes.data, self._indptr.ctypes.data_as(as_int), self._indices.ctypes.data_as(as_int),
            self._order.ctypes.data_as(as_int), integer(1), self._options.ctypes.data_as(as_int), integer(0),
            b.ctypes.data, x.ctypes.data, error,
        )  # fmt: skip
        return error.value

    def __del__(self) -> None:
        if getattr(self, "_analysed", False):
            try:
                self._call(_RELEASE, self._none, self._none)
            except Exception:  # modules are gone at exit, and the memory is freed anyway
                pass


def _pardiso_options() -> np.ndarray:
    options = np.zeros(64, np.int32)
    options[0] = 1  # no defaults: the values below
    options[1] = 2  # nested dissection (METIS)
    options[7] = 0  # no iterative refinement: Newton refines
    options[9] = 8  # pivots below 1e-8 of the norm are perturbed
    options[10] = 0  # no scaling and no matching (12): both would need values in the analysis
    options[12] = 0
    options[20] = 1  # 1x1 and 2x2 pivots
    options[27] = 1  # single precision
    options[34] = 1  # counts from 0
    return options


class SuperLU:
    """Fallback from scipy: like `Pardiso`, but in double precision, several times slower, and without reuse."""

    name = "superlu"

    def __init__(self, indptr: np.ndarray, indices: np.ndarray) -> None:
        self._indptr, self._indices = indptr, indices
        self.size = len(indptr) - 1
        self._lu: Any = None

    def factorise(self, data: np.ndarray) -> None:
        import scipy.sparse as sp
        from scipy.sparse.linalg import splu

        upper = sp.csr_matrix(
            (np.asarray(data, np.float64), self._indices, self._indptr), shape=(self.size, self.size)
        )
        full = (upper + sp.triu(upper, 1).T).tocsc()
        try:
            self._lu = splu(full, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        except RuntimeError as error:
            raise SolveFailed(f"SuperLU failed: {error}") from error

    def solve(self, b: np.ndarray) -> np.ndarray:
        return self._lu.solve(b)
