"""An identified ARMA model, and its JSON document."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.documents import ARMA, Part, above_zero, finite, items, mapping, to_json
from thermaltool.documents import text as text_of
from thermaltool.errors import ModelError
from thermaltool.timeseries.criteria import OrderCriteria
from thermaltool.timeseries.polynomials import is_stationary

Array = NDArray[np.float64]

MAX_DIFFERENCE = 3  # higher ones only enlarge the noise


@dataclass(frozen=True)
class ArmaModel:
    """x_t - m_t = Σ ar_i (x_{t-i} - m_{t-i}) + a_t + Σ ma_j a_{t-j}, of the d-th difference.

    Attributes
    ----------
    channel : str
    period_s : float
        Sample period [s].
    difference : int
        d; the equation holds for the d-th difference of the channel.
    ar, ma : ndarray (p,), (q,)
    trend : tuple of float
        Mean [unit], and slope [unit/sample]; m_t counts from the first sample of the fit.
    trend_covariance : ndarray (k, k)
    sigma2 : float
        Variance of the innovations a [unit²].
    covariance : ndarray (p + q, p + q) or None
        Of (ar, ma); None where the likelihood does not determine them.
    entry : OrderCriteria
        Orders, deviance and criteria by exact likelihood, whatever the method.
    method : str
    provenance : mapping
    """

    channel: str
    period_s: float
    difference: int
    ar: Array
    ma: Array
    trend: tuple[float, ...]
    trend_covariance: Array
    sigma2: float
    covariance: Array | None
    entry: OrderCriteria
    method: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def mean(self) -> float:
        """Mean at the first sample [unit]; 0 where none was fitted."""
        return self.trend[0] if self.trend else 0.0

    @property
    def errors(self) -> Array:
        """Standard errors of (ar, ma), ndarray (p + q,); NaN where undetermined."""
        if self.covariance is None:
            return np.full(self.ar.size + self.ma.size, np.nan)
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))


def to_document(model: ArmaModel) -> dict[str, Any]:
    """The model as plain data."""
    entry = model.entry
    return ARMA.wrap(
        {
            "channel": model.channel,
            "period_s": model.period_s,
            "difference": model.difference,
            "ar": model.ar.tolist(),
            "ma": model.ma.tolist(),
            "trend": list(model.trend),
            "trend_covariance": model.trend_covariance.tolist(),
            "sigma2": model.sigma2,
            "covariance": None if model.covariance is None else model.covariance.tolist(),
            "fit": {
                "method": model.method,
                "samples": entry.size,
                "loglik": -0.5 * entry.deviance,
                "square_sum": entry.sigma2 * entry.size,
                "aic": entry.criteria.aic,
                "aicc": entry.criteria.aicc,
                "bic": entry.criteria.bic,
            },
            "provenance": dict(model.provenance),
        }
    )


def dumps(model: ArmaModel) -> str:
    """JSON text, sorted keys, no NaN."""
    return to_json(to_document(model))


def loads(text: str, name: str = "<model>") -> ArmaModel:
    """The model in a JSON text.

    Raises
    ------
    ModelError
        Not such a document, a newer version, or numbers that do not fit together; each names the
        source and the field.
    """
    document = ARMA.loads(text, name)
    try:
        return _model_of(Part(document))
    except ModelError as error:
        raise ModelError(f"{name}: not {ARMA.noun}: {error}") from error


def _model_of(part: Part) -> ArmaModel:
    """The model in the fields of a document."""
    ar, ma = part.read("ar", _stationary), part.read("ma", _invertible)
    trend, size = part.read("trend", _vector), ar.size + ma.size
    fit = part.part("fit")
    samples = fit.read("samples", _whole(1))
    return ArmaModel(
        channel=part.read("channel", text_of),
        period_s=part.read("period_s", above_zero),
        difference=part.read("difference", _whole(0, MAX_DIFFERENCE)),
        ar=ar,
        ma=ma,
        trend=tuple(trend.tolist()),
        trend_covariance=part.read("trend_covariance", _square(trend.size)),
        sigma2=part.read("sigma2", above_zero),
        covariance=part.read("covariance", _square(size), None),
        entry=OrderCriteria(
            ar.size,
            ma.size,
            -2.0 * fit.read("loglik", finite),
            fit.read("square_sum", finite) / samples,
            samples,
            trend.size,
            True,
        ),
        method=fit.read("method", text_of),
        provenance=part.read("provenance", mapping, {}),
    )


def _vector(values: Any) -> Array:
    return np.array([finite(value) for value in items(values)], dtype=float)


def _stationary(values: Any) -> Array:
    ar = _vector(values)
    if not is_stationary(ar):
        raise ModelError("not stationary")
    return ar


def _invertible(values: Any) -> Array:
    ma = _vector(values)
    if not is_stationary(-ma):
        raise ModelError("not invertible")
    return ma


def _square(size: int) -> Callable[[Any], Array]:
    """A reader of a matrix, ndarray (size, size)."""

    def reader(rows: Any) -> Array:
        matrix = np.array([_vector(row) for row in items(rows)], dtype=float)
        if matrix.size != size**2:
            raise ModelError(f"not a matrix of {size} rows and columns")
        return matrix.reshape(size, size)

    return reader


def _whole(low: int, high: int | None = None) -> Callable[[Any], int]:
    """A reader of a whole number within bounds."""

    def reader(value: Any) -> int:
        number = finite(value)
        if number != int(number) or number < low or (high is not None and number > high):
            raise ModelError(f"not a whole number from {low} to {'any' if high is None else high}")
        return int(number)

    return reader
