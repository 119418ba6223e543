"""AR model of the errors of a fit, and how many independent ones they are worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import freqz

from thermaltool.fitting.data import Array
from thermaltool.timeseries.ar import burg, yule_walker
from thermaltool.timeseries.runs import joined

# Order of the AR model at most; rows of the shortest run for each coefficient.
MAX_AR_ORDER, ROWS_PER_COEFFICIENT = 15, 10
# Runs of errors shorter than this [rows] say nothing of their colour beside longer ones.
MIN_RUN = 40
# Share of the errors' variance below which what drives them is rounding.
MIN_VARIANCE = 1e-9
# Frequencies at which a spectral density is taken: its mean is exact for far fewer.
FREQUENCIES = 4096


def long_runs(runs: Sequence[Array]) -> list[int]:
    """Which of the runs are long enough: those of `MIN_RUN`, or of the longest there is."""
    least = min(MIN_RUN, max((len(run) for run in runs), default=0))
    return [k for k, run in enumerate(runs) if least and len(run) >= least]


def known_runs(errors: Array) -> list[slice]:
    """Rows of the runs without a hole, in order.

    Parameters
    ----------
    errors : ndarray, shape (n,)
        NaN where there is none.
    """
    there = np.flatnonzero(np.isfinite(errors))
    if not len(there):
        return []
    parts = np.split(there, np.flatnonzero(np.diff(there) > 1) + 1)
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts]


def effective_share(errors: Sequence[Array]) -> float:
    """Share of the rows that count as independent in a mean square: 1/Σ ρ² of their AR model.

    Bartlett 1946; by Parseval (mean S)²/mean S² of the spectral density S.

    Parameters
    ----------
    errors : sequence of ndarray
        As `ar_error_model`.
    """
    model = ar_error_model(errors)
    if model is None:
        return 1.0
    _, gain = freqz([1.0], model[0], FREQUENCIES)
    power = np.abs(gain) ** 2
    return float(np.mean(power) ** 2 / np.mean(power**2))


def ar_error_model(errors: Sequence[Array]) -> tuple[Array, float] | None:
    """AR polynomial of errors and the variance of what drives them, of least BIC; None if white.

    By Burg's method from the long runs; where holes leave few of these, by Yule and Walker from all
    pairs of errors that are there.

    Parameters
    ----------
    errors : sequence of ndarray
        Of each record; NaN where there is none.
    """
    runs = [each[run] for each in errors for run in known_runs(each)]
    long = [runs[k] for k in long_runs(runs)]
    rows = sum(map(len, runs))
    if 2 * sum(map(len, long)) < rows:
        longest = max(map(len, runs))
        max_order = min(MAX_AR_ORDER, longest - 1, rows // ROWS_PER_COEFFICIENT)
        if max_order < 1:
            return None
        table = yule_walker(joined([each for each in errors if len(each)]), max_order)
        # Autocovariances over different pairs can be those of no process from some order on.
        valid = int(np.sum(np.cumprod(table.variance > MIN_VARIANCE * table.variance[0])))
    else:
        max_order = min([MAX_AR_ORDER, *(len(e) // ROWS_PER_COEFFICIENT for e in long)], default=0)
        if not long or max_order < 1:
            return None
        table, valid = burg(joined(long), max_order), max_order + 1
    best = int(np.argmin([each.bic for each in table.criteria[:valid]]))
    return (table.whitening(best), float(table.variance[best])) if best else None
