"""Gaussian priors of what may move in a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.effects.effect import Float
from thermaltool.signals.symmetric import eigh

# Smallest eigenvalue of a scaled covariance, and variance that stands for none.
MIN_EIGENVALUE, TINY = 1e-12, 1e-300


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior of the moves of an output.

    Attributes
    ----------
    root : ndarray, shape (p + q, r)
        Root of the covariance: what each coordinate of variance one moves.
    centre : ndarray, shape (r,)
        Where the model stands in it.
    inverse : ndarray, shape (r, p + q)
        From moves to coordinates.
    """

    root: Float
    centre: Float
    inverse: Float


def root_of(covariance: Float, size: Float | None = None) -> Float:
    """A root of a covariance, no direction exactly known.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
    size : ndarray, shape (n,), optional
        Standard deviation that each parameter has beside what is known of it.

    Returns
    -------
    ndarray, shape (n, n)
    """
    if size is not None:
        covariance = covariance - covariance @ np.linalg.solve(
            covariance + np.diag(size**2), covariance
        )
    # Scales of their own: what differs in size by much cancels to its last digits.
    own = np.sqrt(np.maximum(np.diag(covariance), TINY))
    scaled = covariance / np.outer(own, own)
    values, vectors = eigh((scaled + scaled.T) / 2)
    return np.asarray(own[:, None] * vectors * np.sqrt(np.maximum(values, MIN_EIGENVALUE)))
