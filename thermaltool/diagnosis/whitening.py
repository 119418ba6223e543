"""Combinations of nuisance columns that are orthonormal under a noise and their prior."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpocon, dpotrf, dtrtri

from thermaltool.effects.effect import Float
from thermaltool.signals.likelihood import Factor
from thermaltool.signals.symmetric import eigh

# Eigenvalues of the scaled nuisance: what is below is left out, and where the digits of the
# products no longer carry the whole projection.
SINGULAR, COLLINEAR = 1e-13, 1e-7


def whitening(gram: Float, prior: Float, columns: Float, factor: Factor) -> tuple[Float, float]:
    """Combinations of columns that are orthonormal under a noise and their prior.

    Parameters
    ----------
    gram : ndarray, shape (c, c)
        Products of the columns under the noise.
    prior : ndarray, shape (c,)
        Their precision.
    columns : ndarray, shape (n, c)
    factor : Factor
        Of the covariance of the noise.

    Returns
    -------
    ndarray, shape (c, r)
        A root of the inverse of the precision; r < c where columns are singular.
    float
        Log determinant of the precision.
    """
    size = np.sqrt(np.diag(gram) + prior)
    size[size == 0] = 1.0
    scaled = (gram + np.diag(prior)) / np.outer(size, size)
    lower, failed = dpotrf(scaled, lower=True, clean=True)
    # With a norm of one the estimate is that of one over the norm of the inverse.
    if len(size) and not failed and dpocon(lower, 1.0, uplo="L")[0] > COLLINEAR:
        spread = 2 * float(np.log(np.diag(lower) * size).sum())
        return dtrtri(lower, lower=True)[0].T / size[:, None], spread
    values, vectors = eigh(scaled)
    spread = float(np.sum(np.log(np.maximum(values, SINGULAR)))) + 2 * float(np.log(size).sum())
    kept = values > SINGULAR
    half = vectors[:, kept] / size[:, None] / np.sqrt(values[kept])
    if np.any(values[kept] < COLLINEAR):
        # Once more from the columns themselves (Cholesky QR twice: Yamamoto et al. 2015).
        chosen = columns @ half
        again = chosen.T @ factor.solve(chosen) + half.T @ (prior[:, None] * half)
        values, vectors = eigh((again + again.T) / 2)
        half = half @ (vectors / np.sqrt(values))
        spread += float(np.log(values).sum())
    return half, spread
