"""Columns with Gaussian priors in a linear fit, by the products of its rows alone.

The first row and column of a matrix of products is of the residual.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from thermaltool.signals.symmetric import eigh, pseudo_inverse

Float = NDArray[np.float64]

# Directions of the information below this share of the largest, once scaled, are rounding.
MIN_DIRECTION = 1e-13
# Size of what is not there, over the white noise.
ABSENT = 1e-6


def beside(gram: Float, first: int, count: int, size: float) -> tuple[Float, float]:
    """Products beside columns with a prior that are integrated out, and what that costs.

    Parameters
    ----------
    gram : ndarray, shape (c, c)
    first, count : int
        Which columns.
    size : float
        Their prior standard deviation over the noise.

    Returns
    -------
    ndarray, shape (c - count, c - count)
    float
        Logarithm of the determinant of their information over that of the prior.
    """
    out = slice(first, first + count)
    if not count:
        return gram, 0.0
    root = np.linalg.cholesky(gram[out, out] * size**2 + np.eye(count))
    through = solve_triangular(root, size * np.delete(gram[out], out, axis=1), lower=True)
    left = np.delete(np.delete(gram, out, axis=0), out, axis=1) - through.T @ through
    return left, 2 * float(np.sum(np.log(np.diag(root))))


def information_of(columns: int, p: int, *groups: tuple[int, float]) -> Float:
    """Prior information of columns, over that of a row: of the first p none, then groups.

    Parameters
    ----------
    columns, p : int
        Those beyond the groups have none either.
    *groups : (int, float)
        Number, and prior standard deviation over the noise of a row.

    Returns
    -------
    ndarray, shape (columns,)
    """
    prior, start = np.zeros(columns), p
    for count, size in groups:
        prior[start : start + count] = 1 / max(size, ABSENT) ** 2
        start += count
    return prior


def _scaled(gram: Float, prior: Float) -> tuple[Float, Float]:
    """Information with the prior, its diagonal scaled to ones, and the roots of the diagonal."""
    information = gram[1:, 1:] + np.diag(prior)
    height = np.sqrt(np.diag(information))
    height[height == 0] = 1.0
    return information / np.outer(height, height), height


def inverse_of(gram: Float, prior: Float) -> Float:
    """Inverse of the information of the columns with the prior.

    Parameters
    ----------
    gram : ndarray, shape (1 + c, 1 + c)
    prior : ndarray, shape (c,)

    Returns
    -------
    ndarray, shape (c, c)
    """
    scaled, height = _scaled(gram, prior)
    known = pseudo_inverse(scaled, MIN_DIRECTION)
    return np.asarray(known / np.outer(height, height), float)


def marginal(gram: Float, logdet: float, n: int, prior: Float) -> tuple[float, float]:
    """Negative log marginal likelihood, and white noise, for one prior of the columns.

    Parameters
    ----------
    gram : ndarray, shape (1 + c, 1 + c)
    logdet : float
        Of the covariance of the rows, over the white noise, and of what was integrated out.
    n : int
        Rows.
    prior : ndarray, shape (c,)
    """
    scaled, height = _scaled(gram, prior)
    pull = gram[1:, 0] / height
    values, vectors = eigh(scaled)
    seen = values > MIN_DIRECTION * values[-1]
    explained = float(np.sum((pull @ vectors[:, seen]) ** 2 / values[seen]))
    square = max(float(gram[0, 0]) - explained, 1e-300)
    held = prior > 0
    dof = max(n - int(np.sum(~held)), 1)
    occam = float(np.sum(np.log(np.maximum(values, MIN_DIRECTION))))
    occam += 2 * float(np.sum(np.log(height)))
    occam -= float(np.sum(np.log(prior[held])))
    return 0.5 * (dof * np.log(square / dof) + logdet + occam), float(np.sqrt(square / dof))
