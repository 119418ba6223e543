"""Pauses of a record as rows that nobody has read: a heat wanders, or steps, amid them, too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermaltool.responses.modes import Float

# A sample of so many usual ones is a pause [1]; a shorter one is a lost line, amid which a heat
# changes little.
LONG_SAMPLE = 3.0
# A longer pause has longer samples: so many resolve what the heat before and after its change does.
MAX_ROWS_OF_PAUSE = 100


def with_pauses(time: Float, readings: Float) -> tuple[Float, Float, NDArray[np.bool_]]:
    """A record with rows of NaN in its pauses.

    Parameters
    ----------
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)

    Returns
    -------
    time : ndarray, shape (m,) [s]
    readings : ndarray, shape (m, n_sensors)
    there : ndarray, shape (m,)
        Which rows are those of the record.
    """
    steps = np.diff(time)
    if not len(steps) or np.max(steps) <= LONG_SAMPLE * np.median(steps):
        return time, readings, np.ones(len(time), bool)
    samples = np.round(steps / np.median(steps))
    long = steps > LONG_SAMPLE * np.median(steps)
    # Most rows stay those of the record: its sample is the median one.
    pauses = int(np.sum(long))
    most = max(min(MAX_ROWS_OF_PAUSE, (len(steps) - pauses) // pauses - 2), 0)
    more = np.where(long, np.minimum(samples - 1.0, float(most)), 0).astype(int)
    at = np.append(0, np.cumsum(1 + more))
    there = np.zeros(at[-1] + 1, bool)
    there[at] = True
    filled = np.full((len(there), readings.shape[1]), np.nan)
    filled[at] = readings
    clock = np.interp(np.arange(len(there)), at, time)
    clock[at] = time
    return clock, filled, there
