"""Eigenvalues and inverses of symmetric matrices, also where divide and conquer fails."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def eigh(matrix: Float) -> tuple[Float, Float]:
    """Eigenvalues, ascending, and eigenvectors of a symmetric matrix.

    LAPACK's divide and conquer, the fastest, ends without a result for some harmless matrices; its
    QR iteration has one.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)

    Returns
    -------
    values : ndarray, shape (n,)
    vectors : ndarray, shape (n, n)

    Raises
    ------
    numpy.linalg.LinAlgError
        Not finite, or neither converges.
    """
    try:
        values, vectors = np.linalg.eigh(matrix)
    except np.linalg.LinAlgError:
        if not np.all(np.isfinite(matrix)):
            raise
        from scipy import linalg

        values, vectors = linalg.eigh(matrix, driver="ev")
    return values, vectors


def pseudo_inverse(matrix: Float, least: float) -> Float:
    """Inverse of a symmetric matrix, without the directions of next to no size.

    Parameters
    ----------
    matrix : ndarray, shape (n, n) or (m, n, n)
    least : float
        Size of an eigenvalue, over that of the largest, below which its direction is left out.

    Returns
    -------
    ndarray, as `matrix`

    Raises
    ------
    numpy.linalg.LinAlgError
        As `eigh`.
    """
    try:
        return np.asarray(np.linalg.pinv(matrix, rcond=least, hermitian=True))
    except np.linalg.LinAlgError:
        if matrix.ndim > 2:
            return np.array([pseudo_inverse(each, least) for each in matrix])
        values, vectors = eigh(matrix)
        sizes = np.abs(values)
        kept = sizes > least * np.max(sizes, initial=0.0)
        return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)
