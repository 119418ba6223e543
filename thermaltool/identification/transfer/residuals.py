"""Residual tests: are the one-step errors white, and independent of the inputs.

Ljung 1999, 16.6; Ljung and Box, Biometrika 65 (1978) 297; prewhitening as Box, Jenkins and
Reinsel (2008), 12.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

from thermaltool.identification.arma.ar import burg
from thermaltool.identification.transfer.data import Array, Data
from thermaltool.identification.transfer.identify import error_record
from thermaltool.identification.transfer.model import TransferModel

LAGS = 25
# Longest AR model by which errors and inputs are made white before they are correlated.
LONGEST = 15


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


@dataclass(frozen=True)
class Cause:
    """An input as the errors may still depend on it.

    Attributes
    ----------
    runs : list of ndarray
        One for each run of errors, ending with it.
    delay : int
        Samples before which it acts on nothing.
    free : int
        Parameters that were fitted to its way to the output.
    """

    runs: list[Array]
    delay: int
    free: int


def residual_tests(model: TransferModel, data: Data) -> ResidualTests:
    """Both tests on a data set.

    Parameters
    ----------
    model : TransferModel
    data : Data
        Training or validation data.
    """
    searched = sum(model.orders.nf) if model.structure == "oe" else 0
    fitted = len(model.C) + len(model.D) - 2 + (len(model.F[0]) - 1 if model.structure
                                                in ("arx", "armax") else searched)  # fmt: skip
    used = [s for s in data.stretches if len(s) > model.orders.first + sum(model.orders.nf) + 1]
    causes = {}
    for k, name in enumerate(model.names):
        runs = [s.inputs[k] - np.mean(s.inputs[k]) for s in used]
        free = model.orders.nb[k] + len(model.denominator(k)) - 1
        causes[name] = Cause(runs, model.orders.nk[k], free)
    return tested(model.residuals(data), causes, fitted)


def tested(errors: list[Array], causes: Mapping[str, Cause], fitted: int) -> ResidualTests:
    """Both tests on one-step errors.

    Parameters
    ----------
    errors : list of ndarray
    causes : mapping of input to Cause
    fitted : int
        Parameters that were fitted to the course of the errors.
    """
    errors = [e - np.mean(e) for e in errors]
    longest = max((len(e) for e in errors), default=0)
    lags = min(LAGS, longest // 5)
    if lags < 2:
        return ResidualTests(0, float("nan"), dict.fromkeys(causes, float("nan")))
    rows = sum(len(e) for e in errors)
    power = sum(float(e @ e) for e in errors) or 1.0
    r = np.array([sum(float(e[k:] @ e[: len(e) - k]) for e in errors) for k in range(1, lags + 1)])
    statistic = rows * (rows + 2) * np.sum((r / power) ** 2 / (rows - np.arange(1.0, lags + 1)))
    white = float(chi2.sf(statistic, max(lags - fitted, 1)))
    independent = {name: _independence(errors, cause, lags) for name, cause in causes.items()}
    return ResidualTests(lags, white, independent)


def _independence(errors: list[Array], cause: Cause, lags: int) -> float:
    """N Σ r² of whitened errors with the whitened input, from the delay on."""
    e, u = _whitened(errors), _whitened(cause.runs)
    products = np.zeros(lags)
    for own, acts in zip(e, u, strict=False):
        acts = acts[len(acts) - len(own) :]
        for lag in range(lags):
            at = lag + cause.delay
            if at < len(own):
                products[lag] += float(own[at:] @ acts[: len(own) - at])
    power = sum(float(x @ x) for x in e) * sum(float(x @ x) for x in u)
    if not power > 0:
        return float("nan")
    rows = sum(len(x) for x in e)
    statistic = rows * float(np.sum(products**2)) / power
    return float(chi2.sf(statistic, max(lags - cause.free, 1)))


def _whitened(series: list[Array]) -> list[Array]:
    """Each run through the AR model of least AIC that all together have."""
    most = min(LONGEST, min(len(x) for x in series) // 5)
    if most < 1 or not any(np.any(x) for x in series):
        return series
    table = burg(error_record(series), most)
    polynomial = np.concatenate([[1.0], -table.coefficients[table.best]])
    return [np.asarray(lfilter(polynomial, [1.0], x)) for x in series]
