"""Linear systems of finite elements: symmetric, positive definite, sparse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from thermaltool.errors import FitError

Array = NDArray[np.float64]
# Unknowns up to which a system is factorized: a factor of solids grows as their 4/3rd power, and
# beyond is larger and slower than all solves by conjugate gradients.
MAX_FACTORIZED = 15_000
# Relative residual and iterations of conjugate gradients.
TOLERANCE, MAX_ITERATIONS = 1e-9, 20_000
# Relative residual of shifted systems, which only judge a reduction.
SHIFTED_TOLERANCE = 1e-7


def symmetric_solver(matrix: Any) -> Callable[[Array], Array]:
    """Solver of ``matrix x = b`` for many b, by a factor or by conjugate gradients.

    Parameters
    ----------
    matrix : sparse array, shape (n, n)
        Symmetric and positive definite.

    Returns
    -------
    callable
        Takes and returns ndarray of shape (n,).

    Raises
    ------
    FitError
        From the solver: the iterations do not end.
    """
    n = matrix.shape[0]
    if n <= MAX_FACTORIZED:
        return _factor(matrix).solve
    rows, inverse = sparse.csr_array(matrix), 1 / matrix.diagonal()
    jacobi = sparse_linalg.LinearOperator(
        matrix.shape, lambda b: inverse * b.ravel(), dtype=np.float64
    )

    def solve(right: Array) -> Array:
        if not np.any(right):
            return np.zeros(n)
        found, failed = sparse_linalg.cg(
            rows, right, rtol=TOLERANCE, maxiter=MAX_ITERATIONS, M=jacobi
        )
        if failed:
            raise FitError(
                f"the equations of {n} unknowns are not solved after {failed} iterations: does "
                "the mesh have flat elements?"
            )
        return np.asarray(found)

    return solve


def shifted_solver(matrix: Any, other: Any, shift: complex) -> Callable[[Array], Any]:
    """Solver of ``(matrix + shift other) x = b`` for a shift with a real part of at least 0.

    Parameters
    ----------
    matrix, other : sparse array, shape (n, n)
        Symmetric and positive definite.
    shift : complex

    Raises
    ------
    FitError
        From the solver: the iterations do not end.
    """
    whole = sparse.csr_array(matrix + shift * other)
    if whole.shape[0] <= MAX_FACTORIZED:
        factor = _factor(whole)
        return lambda right: factor.solve(right.astype(complex))
    inverse = 1 / whole.diagonal()
    jacobi = sparse_linalg.LinearOperator(
        whole.shape, lambda b: inverse * b.ravel(), dtype=np.complex128
    )

    def solve(right: Array) -> Any:
        found, failed = sparse_linalg.bicgstab(
            whole, right.astype(complex), rtol=SHIFTED_TOLERANCE, maxiter=MAX_ITERATIONS, M=jacobi
        )
        if failed:
            raise FitError(f"{whole.shape[0]} shifted equations are not solved")
        return found

    return solve


def _factor(matrix: Any) -> Any:
    """LU factors, ordered for a symmetric pattern, without pivots."""
    return sparse_linalg.splu(
        sparse.csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
