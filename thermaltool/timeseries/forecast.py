"""Forecasts of an ARMA model beyond the end of a record, with intervals.

The conditional expectation given all samples, by the state of the exact likelihood, so that short
records and holes count as they are. σ² and the coefficients are taken as known, as usual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from thermaltool.errors import FitError
from thermaltool.record import Record
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.model import ArmaModel
from thermaltool.timeseries.polynomials import impulse_response
from thermaltool.timeseries.runs import difference, places, runs, samples, with_samples
from thermaltool.timeseries.state import transition

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Forecast:
    """Steps 1, 2, ... beyond the last sample.

    Attributes
    ----------
    value : ndarray (L,)
        [unit].
    error : ndarray (L,)
        Standard error [unit].
    low, high : ndarray (L,)
        Interval of the level asked for.
    """

    value: Array
    error: Array
    low: Array
    high: Array


def forecast(model: ArmaModel, record: Record, steps: int, level: float = 0.95) -> Forecast:
    """Forecast `steps` samples beyond the end of a record.

    Parameters
    ----------
    model : ArmaModel
    record : Record
        Even, of one channel, not differenced; its clock counts from the row at which the model's
        trend counts.
    steps : int
    level : float
        Probability inside the interval.

    Raises
    ------
    FitError
        The last run is too short for the model's difference.
    """
    d, values = model.difference, samples(record)
    last = values[runs(record)[-1]]
    if last.size <= d:
        raise FitError(f"the last {last.size} samples in a row are too few for difference {d}")
    clock = places(record)
    centred = samples(difference(record, d)) - _trend(model, clock)
    likelihood = ArmaLikelihood(with_samples(record, centred), -1)
    state, covariance = likelihood.final_state(model.ar, model.ma)
    T = transition(model.ar, model.ma)
    value, extra = np.empty(steps), np.empty((steps, state.size))
    row = np.eye(state.size)[0]
    for k in range(steps):
        value[k], extra[k] = row @ state, row
        row = row @ T
    ahead = clock[runs(record)[-1].stop - 1] + 1.0 + np.arange(steps)
    value += _trend(model, ahead)
    psi = impulse_response(model.ar, model.ma, steps)
    for k in range(d, 0, -1):  # sums take the differences back, from the highest on
        value = np.diff(last, k - 1)[-1] + np.cumsum(value)
        psi, extra = np.cumsum(psi), np.cumsum(extra, axis=0)
    spread = np.cumsum(psi**2) + np.einsum("ki,ij,kj->k", extra, covariance, extra)
    error = np.sqrt(model.sigma2 * spread)
    half = float(ndtri(0.5 + 0.5 * level)) * error
    return Forecast(value, error, value - half, value + half)


def _trend(model: ArmaModel, places: Array) -> Array:
    return sum((c * places**k for k, c in enumerate(model.trend)), np.zeros(places.size))
