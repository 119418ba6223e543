"""Steps of the heat in a record on any clock: they are looked for on an even one.

A logger that comes late now and then, or reads whenever it can, has rows that jitter. The search
for steps takes one length of sample; there readings are those of straight lines between the rows,
and the estimates themselves take the rows as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.heat_steps import HeatSteps, find_steps, why_no_steps
from thermaltool.estimation.pauses import LONG_SAMPLE
from thermaltool.estimation.start import Initial
from thermaltool.responses.modes import Float


def steps_on_any_clock(
    kalman: KalmanEstimator,
    time: Float,
    readings: Float,
    level: Sequence[float],
    initial: Initial,
    there: NDArray[np.bool_],
) -> tuple[HeatSteps | None, str]:
    """Steps of the heat in a record, or why none are looked for.

    Parameters
    ----------
    kalman, time, readings, level, initial
        As for `find_steps`, on any clock.
    there : ndarray, shape (n,)
        Which rows are those of the record, not of its pauses.
    """
    reason = why_no_steps(kalman, time, readings, level, there)
    if not reason:
        return find_steps(kalman, time, readings, level, initial), ""
    if len(time) < 2:
        return None, reason
    clock, even, rows = on_even_clock(time, readings)
    if why_no_steps(kalman, clock, even, level):
        return None, reason
    found = find_steps(kalman, clock, even, level, initial)

    def placed(variances: Float) -> Float:
        """What is of a moment, at the first row from then on."""
        each = np.zeros((len(time), variances.shape[1]))
        np.add.at(each, rows, variances)
        return each

    return replace(
        found,
        likeliest=placed(found.likeliest),
        draws=tuple(map(placed, found.draws)),
        pauses=placed(found.pauses),
    ), ""


def on_even_clock(time: Float, readings: Float) -> tuple[Float, Float, NDArray[np.intp]]:
    """A record on an even clock between its pauses, by straight lines between its readings.

    Parameters
    ----------
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)

    Returns
    -------
    clock : ndarray, shape (m,) [s]
        One sample is the usual one of the record.
    even : ndarray, shape (m, n_sensors)
        NaN where the readings on both sides of a moment are further apart than a lost line.
    rows : ndarray, shape (m,)
        The row of the record that is nearest, or the next one.
    """
    steps = np.diff(time)
    period = float(np.median(steps))
    parts = np.split(time, np.flatnonzero(steps > LONG_SAMPLE * period) + 1)
    clock = np.concatenate(
        [np.linspace(part[0], part[-1], round(np.ptp(part) / period) + 1) for part in parts]
    )
    even = np.full((len(clock), readings.shape[1]), np.nan)
    for column, values in zip(even.T, readings.T, strict=True):
        known = np.flatnonzero(np.isfinite(values))
        if not len(known):
            continue
        read = time[known]
        column[:] = np.interp(clock, read, values[known], np.nan, np.nan)
        after = np.minimum(np.searchsorted(read, clock), len(read) - 1)
        apart = read[after] - read[np.maximum(after - 1, 0)]
        column[(read[after] > clock) & (apart > LONG_SAMPLE * period)] = np.nan
    rows = np.minimum(np.searchsorted(time, clock - period / 2), len(time) - 1)
    return clock, even, rows
