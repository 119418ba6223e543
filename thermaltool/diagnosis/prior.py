"""What the parameters of a model, and what its kind leaves out, may be before logs are looked at.

Moves are of the `own` parameters of an output (of logarithms where they are counted so), then
weights of lags of the drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from thermaltool.effects.effect import Float

# Where a model is free, its lags are so many times apart.
APART = 3.0


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior of the moves of an output.

    Attributes
    ----------
    root : ndarray, shape (p + q, r)
        Of the covariance: what each coordinate of variance one moves.
    centre : ndarray, shape (r,)
        Where the model stands in it.
    inverse : ndarray, shape (r, p + q)
        From moves to coordinates.
    """

    root: Float
    centre: Float
    inverse: Float


def wide(at: Float, size: Float, lags: Sequence[tuple[str, float]], heights: Float) -> Prior:
    """Of a model that is free.

    Parameters
    ----------
    at, size : ndarray, shape (p,)
        Where the parameters stand, and how far each may be.
    lags : sequence of (drive, float [s]), q in number
    heights : ndarray, shape (q,)
        Weight that a lag may have; some of them say what all do.
    """
    root = block_diag(np.diag(size), np.diag(heights)[:, _apart(lags)])
    inverse = np.asarray(np.linalg.pinv(root), np.float64)
    return Prior(root, inverse @ np.append(at, np.zeros(len(lags))), inverse)


def visible(covariance: Float, size: Float, at: Float, columns: Float, least: float) -> Prior:
    """By the directions of a covariance that logs show, the most visible first.

    Parameters
    ----------
    covariance : ndarray, shape (p, p)
    size : ndarray, shape (p,)
        Largest deviation of each move.
    at : ndarray, shape (p,)
    columns : ndarray, shape (n, p)
        Change of the rows of the logs with each move.
    least : float
        Norm of a change that is worth a direction.
    """
    root = _root(covariance, size)
    changes = columns @ root
    changes = changes - changes.mean(axis=0)
    values, vectors = np.linalg.eigh(changes.T @ changes)
    turn = vectors[:, values > least**2][:, ::-1]
    inverse = turn.T @ np.linalg.inv(root)
    return Prior(root @ turn, inverse @ at, inverse)


def _apart(lags: Sequence[tuple[str, float]]) -> list[int]:
    """Which of the lags to keep, of every drive the first and what is far from the one before."""
    kept: list[int] = []
    for k, (drive, tau) in enumerate(lags):
        last = next((lags[j][1] for j in reversed(kept) if lags[j][0] == drive), 0.0)
        if not last or max(tau, last) >= APART * min(tau, last):
            kept.append(k)
    return kept


def _root(covariance: Float, size: Float) -> Float:
    """A root of a covariance; never wider than `size`, never exactly known."""
    scaled = covariance / np.outer(size, size)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    return np.asarray(size[:, None] * vectors * np.sqrt(np.clip(values, 1e-12, 1.0)))
