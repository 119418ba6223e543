"""An identified ARMA model, and its JSON document."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import ModelError
from thermaltool.timeseries.criteria import Entry
from thermaltool.timeseries.polynomials import is_stationary

Array = NDArray[np.float64]

FORMAT, VERSION = "thermaltool-arma", 1


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
    entry : Entry
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
    entry: Entry
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
    return {
        "format": FORMAT,
        "version": VERSION,
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


def dumps(model: ArmaModel) -> str:
    """JSON text, sorted keys, no NaN."""
    return json.dumps(to_document(model), sort_keys=True, indent=1, allow_nan=False) + "\n"


def loads(text: str, name: str = "<model>") -> ArmaModel:
    """The model in a JSON text.

    Raises
    ------
    ModelError
        Not such a document, a newer version, or numbers that do not fit together.
    """
    try:
        document = json.loads(text)
        if document["format"] != FORMAT:
            raise ModelError(f"{name}: format {document['format']!r} is not {FORMAT}")
        if document["version"] > VERSION:
            raise ModelError(
                f"{name}: version {document['version']} is newer than this thermaltool"
            )
        return _load(document)
    except (json.JSONDecodeError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"{name}: not what thermaltool fit -o writes: {error}") from error


def _load(document: Mapping[str, Any]) -> ArmaModel:
    ar, ma = _vector(document["ar"]), _vector(document["ma"])
    fit, trend = document["fit"], _vector(document["trend"])
    sigma2, period = float(document["sigma2"]), float(document["period_s"])
    if not (sigma2 > 0.0 and np.isfinite(sigma2) and period > 0.0):
        raise ValueError("sigma2 and period_s must be numbers above 0")
    if not (is_stationary(ar) and is_stationary(-ma)):
        raise ValueError("ar is not stationary, or ma not invertible")
    covariance = document["covariance"]
    size = int(fit["samples"])
    if size < 1 or document["difference"] not in range(4):
        raise ValueError("samples must be above 0, difference 0 to 3")
    return ArmaModel(
        channel=str(document["channel"]),
        period_s=period,
        difference=int(document["difference"]),
        ar=ar,
        ma=ma,
        trend=tuple(trend.tolist()),
        trend_covariance=np.array(document["trend_covariance"], float).reshape(
            trend.size, trend.size
        ),
        sigma2=sigma2,
        covariance=None
        if covariance is None
        else np.array(covariance, float).reshape(ar.size + ma.size, ar.size + ma.size),
        entry=Entry(
            ar.size,
            ma.size,
            -2.0 * float(fit["loglik"]),
            float(fit["square_sum"]) / size,
            size,
            trend.size,
            True,
        ),
        method=str(fit["method"]),
        provenance=document.get("provenance", {}),
    )


def _vector(values: Any) -> Array:
    vector = np.array(values, dtype=float)
    if vector.ndim != 1 or not np.isfinite(vector).all():
        raise ValueError("coefficients must be a list of numbers")
    return vector
