"""The colour of errors: runs long enough to show it, and an AR model of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import freqz

from thermaltool.fitting.data import Array
from thermaltool.timeseries.ar import burg
from thermaltool.timeseries.runs import joined

# Longest AR description of errors.
LONGEST = 15
# Runs of errors shorter than this say nothing of their colour beside longer ones.
SHORTEST_RUN = 40
# Frequencies at which a spectral density is taken.
POINTS = 4096


def long_runs(runs: Sequence[Array]) -> list[int]:
    """Which of the runs are long enough: those of `SHORTEST_RUN`, or of the longest there is."""
    least = min(SHORTEST_RUN, max((len(run) for run in runs), default=0))
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
    colour = error_colour(runs)
    if colour is None:
        return 1.0
    _, gain = freqz([1.0], colour[0], POINTS)
    power = np.abs(gain) ** 2
    return float(np.mean(power) ** 2 / np.mean(power**2))


def error_colour(runs: Sequence[Array]) -> tuple[Array, float] | None:
    """AR polynomial of errors and the variance of what drives them, of least BIC; None if white."""
    long = [runs[k] for k in long_runs(runs)]
    most = min([LONGEST, *(len(e) // 10 for e in long)]) if long else 0
    if most < 1:
        return None
    table = burg(joined(long), most)
    best = int(np.argmin([each.bic for each in table.criteria]))
    return (table.whitening(best), float(table.variance[best])) if best else None
