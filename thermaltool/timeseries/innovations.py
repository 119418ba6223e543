"""Innovations algorithm: ψ weights from the autocovariances, and ARMA start values from them.

The last row of the Cholesky factor of the autocovariance matrix holds the coefficients θ_{m,j} of
the one-step predictor in the innovations, which tend to ψ_j.

Own factor, because `statsmodels.tsa.stattools.innovations_algo` gives the same row but no error for
autocovariances that are those of no process, which holes can leave; and its import adds 0.6 s to
every `fit`, which starts from these weights.

Source: P. J. Brockwell, R. A. Davis, Introduction to Time Series and Forecasting (2002), 2.5.2 and
5.1.3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from thermaltool.errors import FitError
from thermaltool.record import Record
from thermaltool.timeseries.ar import autocovariance
from thermaltool.timeseries.runs import pieces

Array = NDArray[np.float64]


def innovations(record: Record, p: int, q: int, order: int | None = None) -> tuple[Array, Array]:
    """`ar` and `ma` that reproduce the first p + q weights.

    Parameters
    ----------
    record : Record
        Even, of one channel without mean.
    p, q : int
    order : int, optional
        m, the order of the predictor; 10 log10(N) or p + q + 1 by default.

    Raises
    ------
    FitError
        The record is too short, or its autocovariances are those of no process.
    """
    size = sum(run.size for run in pieces(record))
    order = max(int(10 * np.log10(size)), p + q + 1) if order is None else order
    if not p + q <= order < size:
        raise FitError(f"innovations of order {order} for ({p}, {q}) on {size} samples")
    covariance = autocovariance(record, order)
    try:
        lower = np.linalg.cholesky(toeplitz(covariance))
    except np.linalg.LinAlgError as error:
        raise FitError("the autocovariances are those of no process: too many gaps") from error
    row = (lower[-1] / np.diagonal(lower))[::-1]
    psi = row[: p + q + 1]

    # ψ_{q+i} = Σ_k ar_k ψ_{q+i-k}; weights of negative index are zero.
    def before(index: NDArray[np.intp]) -> Array:
        return np.where(index >= 0, psi[np.maximum(index, 0)], 0.0)

    i = np.arange(1, p + 1)
    try:
        ar = np.linalg.solve(before(q + i[:, None] - i), psi[q + i])
    except np.linalg.LinAlgError as error:
        raise FitError(f"the weights of order ({p}, {q}) have no unique answer") from error
    j = np.arange(1, q + 1)
    ma = psi[j] - before(j[:, None] - i) @ ar
    return ar, ma
