"""Root of a covariance that rounding or a difference of two may have left indefinite."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermaltool.signals.symmetric import eigh

Float = NDArray[np.float64]


def covariance_root(covariance: ArrayLike) -> Float:
    """L with L Lᵀ = covariance, without its negative part.

    Parameters
    ----------
    covariance : array_like, shape (n, n)
        Of parameters in any units: each one counts in its own standard deviation, or the smaller
        directions are rounding.

    Returns
    -------
    ndarray, shape (n, n)
    """
    matrix = np.asarray(covariance, float)
    size = np.sqrt(np.abs(np.diag(matrix)))
    size[size == 0] = 1.0
    scaled = matrix / np.outer(size, size)
    values, vectors = eigh((scaled + scaled.T) / 2)
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
