"""Residual tests: are the one-step errors white, and independent of the inputs.

Ljung 1999, 16.6; Ljung and Box, Biometrika 65 (1978) 297; prewhitening as Box, Jenkins and
Reinsel (2008), 12.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import MAX_AR_ORDER, long_runs
from thermaltool.fitting.output_model import OutputModel
from thermaltool.signals.whiteness import cross_correlation, ljung_box
from thermaltool.timeseries.ar import burg
from thermaltool.timeseries.runs import joined

# Lags at most [samples]: enough for a slow mode, few enough for records of some hundred rows.
MAX_LAGS = 25
# Rows of the shortest run for each lag, and for each coefficient of the whitening filter.
ROWS_PER_LAG = 5


@dataclass(frozen=True)
class ResidualTests:
    """p-values; small ones speak against the model.

    Attributes
    ----------
    lags : int
    white_p : float
        Of the errors being white (Ljung-Box).
    independent_p : mapping of input to float
        Of the errors being independent of this input's past.
    """

    lags: int
    white_p: float
    independent_p: Mapping[str, float]


def residual_tests(model: OutputModel, data: TrainingData) -> ResidualTests:
    """Both tests on the one-step errors of a data set.

    Parameters
    ----------
    model : OutputModel
    data : TrainingData
        Training or validation data.
    """
    runs, delays = (
        list(model.residuals(data)),
        dict(zip(model.names, model.sample_delays, strict=True)),
    )
    inputs = {name: [u[k] for _, u in runs] for k, name in enumerate(delays)}
    return correlation_tests(
        [error for error, _ in runs], inputs, delays, model.residual_parameters
    )


def correlation_tests(
    errors: list[Array],
    inputs: Mapping[str, list[Array]],
    delays: Mapping[str, int],
    fitted: int = 0,
) -> ResidualTests:
    """Whether errors are white, and independent of inputs.

    Parameters
    ----------
    errors : list of ndarray, shape (n_i,)
        Runs without a hole; the short ones are left out.
    inputs : mapping of channel to list of ndarray, shape (n_i,)
    delays : mapping of channel to int
        First lag of each input [samples].
    fitted : int
        Parameters that were fitted to the correlation of the errors.
    """
    runs = [(error, [u[i] for u in inputs.values()]) for i, error in enumerate(errors)]
    long = [runs[k] for k in long_runs(errors)]
    lags = min(MAX_LAGS, min((len(error) for error, _ in long), default=0) // ROWS_PER_LAG)
    if lags < 2:
        return ResidualTests(0, float("nan"), dict.fromkeys(delays, float("nan")))
    errors = [error - np.mean(error) for error, _ in long]
    white = ljung_box(errors, lags, fitted).p_value
    whitened, independent = _whitened(errors), {}
    for k, (name, delay) in enumerate(delays.items()):
        acts = _whitened([u[k] - np.mean(u[k]) for _, u in long])
        acts = [u[len(u) - len(own) :] for own, u in zip(whitened, acts, strict=True)]
        independent[name] = cross_correlation(whitened, acts, lags, delay).p_value
    return ResidualTests(lags, white, independent)


def _whitened(series: list[Array]) -> list[Array]:
    """Each run through the AR model of least AIC that all together have."""
    max_order = min(MAX_AR_ORDER, min(len(x) for x in series) // ROWS_PER_LAG)
    if max_order < 1 or not any(np.any(x) for x in series):
        return series
    table = burg(joined(series), max_order)
    polynomial = table.whitening(table.best)
    return [np.asarray(lfilter(polynomial, [1.0], x)) for x in series]
