"""Covariance of least-squares parameters where the noise is not white."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermaltool.signals.symmetric import eigh, pseudo_inverse

Array = NDArray[np.float64]

# Blocks of rows whose scores count as independent: for each parameter, and at the least.
BLOCKS_PER_PARAMETER, MIN_BLOCKS = 4, 30
# Directions of the information below this share of the largest, once scaled, are rounding.
MIN_DIRECTION = 1e-14


def block_covariance(
    jacobian: Array,
    residual: Array,
    owner: NDArray[np.int64],
    weights: Array,
    prior: Array | None = None,
    known: Array | None = None,
) -> Array:
    """Covariance of least-squares parameters under noise of unknown colour, shape (p, p).

    Sandwich estimator with scores summed over blocks of rows, several times as many as
    parameters, so that noise slower than a sample but faster than a block counts in full.

    Parameters
    ----------
    jacobian : ndarray, shape (rows, p)
    residual : ndarray, shape (rows,)
    owner : ndarray of int, shape (rows,)
        Which record a row belongs to; a block does not cross records.
    weights : ndarray, shape (rows,)
        Huber's weights of the squares: below 1 where a residual counts linearly.
    prior : ndarray, shape (p,), optional
        Standard deviations of the parameters before any row, infinite where nothing is known. What
        the rows leave open is known as well as that; without, it may come out as rounding has it.
    known : ndarray, shape (k, p), optional
        Sums of parameters that are known before any row, in units of their standard error; beside
        `prior`.

    Notes
    -----
    H. White, Econometrica 48 (1980) 817; sums over clusters as K.-Y. Liang and S. L. Zeger,
    Biometrika 73 (1986) 13.
    """
    p = jacobian.shape[1]
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0
    scaled = jacobian / size
    # A score that has stopped growing with the residual holds no curvature.
    curved = scaled[weights >= 1]
    blocks = min(max(BLOCKS_PER_PARAMETER * p, MIN_BLOCKS), len(residual))
    label = owner * (blocks + 1) + np.arange(len(residual)) * blocks // len(residual)
    starts = np.flatnonzero(np.diff(label, prepend=-1))
    scores = np.add.reduceat(scaled * (weights * residual)[:, None], starts, axis=0)
    meat = scores.T @ scores * len(scores) / max(len(scores) - p, 1)
    information = curved.T @ curved
    total = float(np.trace(information))
    if prior is None or not total:
        bread = pseudo_inverse(information, MIN_DIRECTION)
        return np.asarray(bread @ meat @ bread / np.outer(size, size))
    # Of so much noise in a row, colour and all, are the scores.
    noise = float(np.trace(meat)) / total
    before = np.diag(noise / (prior * size) ** 2)
    if known is not None:
        before = before + noise * (known / size).T @ (known / size)
    values, vectors = eigh(information + before)
    lost = values < MIN_DIRECTION * values[-1]
    bread = (vectors[:, ~lost] / values[~lost]) @ vectors[:, ~lost].T
    scaled_covariance = bread @ (meat + noise * before) @ bread
    # Where the information is lost in rounding the prior is all there is.
    own = np.where(np.isfinite(prior), (prior * size) ** 2, 0.0)
    spread = vectors[:, lost] ** 2
    scaled_covariance += (vectors[:, lost] * (own @ spread)) @ vectors[:, lost].T
    return np.asarray(scaled_covariance / np.outer(size, size))
