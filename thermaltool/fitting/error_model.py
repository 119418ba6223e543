"""AR model of the errors of a fit, and how many independent ones they are worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import freqz

from thermaltool.fitting.data import Array
from thermaltool.timeseries.ar import burg
from thermaltool.timeseries.runs import joined

# Order of the AR model at most; rows of the shortest run for each coefficient.
MAX_AR_ORDER, ROWS_PER_COEFFICIENT = 15, 10
# Runs of errors shorter than this [rows] say nothing of their colour beside longer ones.
MIN_RUN = 40
# Frequencies at which a spectral density is taken: its mean is exact for far fewer.
FREQUENCIES = 4096


def long_runs(runs: Sequence[Array]) -> list[int]:
    """Which of the runs are long enough: those of `MIN_RUN`, or of the longest there is."""
    least = min(MIN_RUN, max((len(run) for run in runs), default=0))
    return [k for k, run in enumerate(runs) if least and len(run) >= least]


def runs_of(errors: Array) -> list[Array]:
    """Runs of errors without a hole, in order.

    Parameters
    ----------
    errors : ndarray, shape (n,)
        NaN where there is none.
    """
    there = np.flatnonzero(np.isfinite(errors))
    if not len(there):
        return []
    return [errors[part] for part in np.split(there, np.flatnonzero(np.diff(there) > 1) + 1)]


def effective_share(runs: Sequence[Array]) -> float:
    """Share of the rows that count as independent in a mean square: 1/Σ ρ² of their AR model.

    Bartlett 1946; by Parseval (mean S)²/mean S² of the spectral density S.
    """
    model = ar_error_model(runs)
    if model is None:
        return 1.0
    _, gain = freqz([1.0], model[0], FREQUENCIES)
    power = np.abs(gain) ** 2
    return float(np.mean(power) ** 2 / np.mean(power**2))


def ar_error_model(runs: Sequence[Array]) -> tuple[Array, float] | None:
    """AR polynomial of errors and the variance of what drives them, of least BIC; None if white."""
    long = [runs[k] for k in long_runs(runs)]
    max_order = min([MAX_AR_ORDER, *(len(e) // ROWS_PER_COEFFICIENT for e in long)]) if long else 0
    if max_order < 1:
        return None
    table = burg(joined(long), max_order)
    best = int(np.argmin([each.bic for each in table.criteria]))
    return (table.whitening(best), float(table.variance[best])) if best else None
