"""One ARMA model of given order by any of the methods, judged by the exact likelihood."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.record import Record
from thermaltool.signals.whiteness import PortmanteauTest, ljung_box
from thermaltool.timeseries.ar import ArOrders, burg, least_squares, yule_walker
from thermaltool.timeseries.criteria import OrderCriteria
from thermaltool.timeseries.hannan import hannan_rissanen
from thermaltool.timeseries.innovations import innovations
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import Maximum, climb, information
from thermaltool.timeseries.model import ArmaModel
from thermaltool.timeseries.polynomials import is_stationary, is_stationary_and_invertible
from thermaltool.timeseries.runs import difference as differences
from thermaltool.timeseries.runs import runs
from thermaltool.timeseries.starts import all_starts

Array = NDArray[np.float64]

# Orders q = 0 alone, all of them in one pass.
_AR_ONLY: Mapping[str, Callable[[Record, int], ArOrders]] = {
    "burg": burg,
    "yule-walker": yule_walker,
    "least-squares": least_squares,
}
AR_METHODS = tuple(_AR_ONLY)
METHODS = ("ml", *AR_METHODS, "hannan-rissanen", "innovations")
# Lags of the innovations that are tested together, or a fifth of the samples.
MAX_LAGS = 25

# Rounds of the search from several starts: how many go on, and their steps. Most starts lead to
# the same maximum, and most of the others fall behind soon.
SEARCH_ROUNDS = ((8, 5), (3, 45))
ROUND_TOLERANCE = 1e-3  # [deviance] of these rounds; the last climb goes on to its own


def fit_arma(
    record: Record,
    p: int,
    q: int,
    *,
    method: str = "ml",
    degree: int = 0,
    difference: int = 0,
    period_s: float | None = None,
    long_order: int | None = None,
    correct: bool = True,
    begin: Maximum | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> ArmaModel:
    """ARMA(p, q) model of the `difference`-th difference of a record.

    Parameters
    ----------
    record : Record
        Even, of one channel, not yet differenced.
    p, q : int
    method : one of `METHODS`
        "ml" is exact maximum likelihood; burg, yule-walker and least-squares take q = 0.
    degree : int
        Of the trend: 0 mean, 1 line, -1 none. "ml" estimates it jointly, the others first.
    difference : int
    period_s : float, optional
        Sample period [s]; that of the record by default.
    long_order : int, optional
        Of the long AR model of hannan-rissanen, or of the predictor of innovations.
    correct : bool
        Third regression of hannan-rissanen.
    begin : Maximum, optional
        A start for "ml" besides its own.
    provenance : mapping, optional
        Inputs and command, for the document.

    Returns
    -------
    ArmaModel
        Its likelihood and criteria are exact for every method.

    Raises
    ------
    FitError
        Too few samples, a constant series, an order that the method cannot fit, an estimate that
        is not stationary and invertible.
    """
    (channel,) = record.columns
    changed = differences(record, difference)
    likelihood = ArmaLikelihood(changed, degree)
    size = likelihood.size
    if size <= p + q + degree + 2:
        raise FitError(f"{size} samples are too few for ({p}, {q}) and {degree + 1} trends")
    if method == "ml":
        best = _maximum(likelihood, p, q, begin)
    else:
        ar, ma = _estimate(likelihood.detrended, p, q, method, long_order, correct)
        best = _judged(likelihood, ar, ma)
    at = best.at
    scale = np.array([1.0, 1.0 / likelihood.duration])[: degree + 1]
    spread = at.sigma2 * np.linalg.inv(at.precision) * scale[:, None] * scale
    return ArmaModel(
        channel=channel,
        period_s=record.period if period_s is None else period_s,
        difference=difference,
        ar=best.ar,
        ma=best.ma,
        trend=_trend(at.coefficients * scale, likelihood.offset),
        trend_covariance=spread,
        sigma2=at.sigma2,
        covariance=_covariance(likelihood, best),
        entry=OrderCriteria(p, q, best.deviance, at.sigma2, size, degree + 1, True),
        method=method,
        provenance=provenance or {},
    )


def _trend(coefficients: Array, offset: float) -> tuple[float, ...]:
    """Mean and slope; the mean counts from what was taken off first."""
    first = [float(c) + offset for c in coefficients[:1]]
    return (*first, *coefficients[1:].tolist())


def _estimate(
    centred: Record, p: int, q: int, method: str, long_order: int | None, correct: bool
) -> tuple[Array, Array]:
    """`ar` and `ma` of the methods without a likelihood."""
    if method in _AR_ONLY:
        if q:
            raise FitError(f"{method} fits AR models only: q must be 0, not {q}")
        return _AR_ONLY[method](centred, p).coefficients[p], np.empty(0)
    if method == "innovations":
        return innovations(centred, p, q, long_order)
    fit = hannan_rissanen(centred, p, q, long_order, correct)
    return fit.ar, fit.ma


def _maximum(likelihood: ArmaLikelihood, p: int, q: int, begin: Maximum | None) -> Maximum:
    """The best of the maxima from several starts: the likelihood can have more than one."""
    begins = all_starts(likelihood, p, q)
    if begin is not None:
        begins.append(replace(begin, converged=p + q == 0))
    for count, steps in SEARCH_ROUNDS:
        begins = sorted(begins, key=lambda each: each.deviance)[:count]
        begins = [climb(likelihood, each, steps, ROUND_TOLERANCE)[0] for each in begins]
    best = min(begins, key=lambda each: each.deviance)
    return climb(likelihood, replace(best, converged=p + q == 0))[0]


def _judged(likelihood: ArmaLikelihood, ar: Array, ma: Array) -> Maximum:
    """Likelihood of an estimate that was not made by it."""
    if not is_stationary_and_invertible(ar, ma):
        what = "stationary" if not is_stationary(ar) else "invertible"
        raise FitError(f"the estimate is not {what}: --method ml keeps inside, or --difference 1")
    return Maximum(ar, ma, likelihood.at(ar, ma), False)


def _covariance(likelihood: ArmaLikelihood, best: Maximum) -> Array | None:
    """Inverse of the observed information; None where it is not positive definite."""
    if not best.ar.size + best.ma.size:
        return np.empty((0, 0))
    try:
        observed = information(likelihood, best)
        np.linalg.cholesky(observed)
        return np.asarray(np.linalg.inv(observed), dtype=float)
    except np.linalg.LinAlgError:
        return None


def whiteness(model: ArmaModel, changed: Record, degree: int = 0) -> PortmanteauTest:
    """Ljung-Box test of a model's innovations, over runs and segments as they are.

    Parameters
    ----------
    model : ArmaModel
    changed : Record
        What it was fitted to, differenced.
    degree : int
        Of its trend.
    """
    likelihood = ArmaLikelihood(changed, degree)
    at = likelihood.at(model.ar, model.ma)
    errors = likelihood.innovations(model.ar, model.ma, at.coefficients)
    edges = np.cumsum([run.stop - run.start for run in runs(changed)])[:-1]
    parts = np.split(errors, edges)
    lags = max(min(MAX_LAGS, likelihood.size // 5), 1)
    fitted = model.ar.size + model.ma.size
    return ljung_box(parts, lags, fitted)
