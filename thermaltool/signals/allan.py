"""Overlapping Allan deviation with confidence from equivalent degrees of freedom.

A sensor reading plays the part of the clock's fractional frequency: white reading noise is "white
FM" (deviation falls as τ^-1/2), a random walk of the reading is "random walk FM" (τ^+1/2).

Sources: W. J. Riley, D. A. Howe, Handbook of Frequency Stability Analysis, NIST SP 1065 (2008);
C. A. Greenhall, W. J. Riley, Uncertainty of stability variances based on finite differences, 35th
PTTI (2003).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]

WHITE, FLICKER, RANDOM_WALK = 0, -1, -2
CONFIDENCE = 0.95  # probability inside the limits
MIN_AVERAGES = 30  # means: with fewer, the lag-1 identification of the noise kind is not reliable


@dataclass(frozen=True)
class AllanDeviation:
    """Overlapping Allan deviation of evenly sampled readings.

    Attributes
    ----------
    tau : ndarray (k,)
        Averaging time [s].
    deviation, low, high : ndarray (k,)
        Deviation and its two-sided confidence limits [unit of the readings].
    edf : ndarray (k,)
        Equivalent degrees of freedom of the variance.
    kind : ndarray (k,) of int
        Exponent α of the noise that dominates at `tau`: 0 white, -1 flicker, -2 random walk.
    """

    tau: Array
    deviation: Array
    low: Array
    high: Array
    edf: Array
    kind: NDArray[np.int64]


def allan_deviation(
    values: ArrayLike, period: float, factors: ArrayLike | None = None
) -> AllanDeviation:
    """Overlapping Allan deviation (NIST SP 1065, eq. 10) with χ² limits (eq. 45).

    Parameters
    ----------
    values : array_like (n,)
        Readings at an even `period`, without NaN [unit].
    period : float
        Sample period [s].
    factors : array_like of int, optional
        Averaging factors m = τ / period; four per octave up to n / 4 by default.

    Raises
    ------
    ValueError
        Fewer than 3 readings, NaN among them, or a factor outside 1 … (n − 1) // 2.
    """
    y = np.asarray(values, dtype=float)
    n = y.size
    if n < 3 or not np.isfinite(y).all():
        raise ValueError(f"Allan deviation needs at least 3 finite readings, got {n}")
    m = default_factors(n) if factors is None else np.asarray(factors, dtype=int)
    if m.size == 0 or m.min() < 1 or m.max() > n // 2:
        raise ValueError(f"averaging factors must lie in 1 … {n // 2} for {n} readings")
    # Sum of readings: "phase" in units of the period. The mean is taken off to keep digits.
    x = np.concatenate(([0.0], np.cumsum(y - y.mean())))
    deviation, edf, kinds = np.empty(m.size), np.empty(m.size), np.empty(m.size, dtype=np.int64)
    kind = WHITE
    for i, factor in enumerate(m):
        z = x[2 * factor :] - 2.0 * x[factor:-factor] + x[: -2 * factor]
        deviation[i] = np.sqrt(np.mean(z * z) / 2.0) / factor
        if n // factor >= MIN_AVERAGES:
            kind = noise_kind(y, int(factor))
        kinds[i] = kind
        edf[i] = equivalent_dof(n + 1, int(factor), kind)
    tail = (1.0 - CONFIDENCE) / 2.0
    low = deviation * np.sqrt(edf / chdtri(edf, tail))
    high = deviation * np.sqrt(edf / chdtri(edf, 1.0 - tail))
    return AllanDeviation(np.asarray(m * period, dtype=float), deviation, low, high, edf, kinds)


def default_factors(n: int) -> NDArray[np.int64]:
    """Averaging factors, four per octave, from 1 to n / 4."""
    octaves = np.log2(max(n // 4, 1))
    return np.unique(np.round(2.0 ** np.arange(0.0, octaves + 1e-9, 0.25)).astype(np.int64))


def noise_kind(values: Array, factor: int) -> int:
    """Dominant noise at an averaging factor by lag-1 autocorrelation (SP 1065, §5.5.5).

    Returns
    -------
    int
        `WHITE`, `FLICKER` or `RANDOM_WALK`; anything whiter counts as white, redder as walk.
    """
    n = values.size // factor
    z = values[: n * factor].reshape(n, factor).mean(axis=1)
    differences = 0
    while True:
        z = z - z.mean()
        power = np.dot(z, z)
        r1 = np.dot(z[1:], z[:-1]) / power if power > 0 else 0.0
        delta = r1 / (1.0 + r1)
        if delta < 0.25 or differences == 1:
            break
        z, differences = np.diff(z), differences + 1
    return int(np.clip(-np.round(2.0 * delta) - 2 * differences, RANDOM_WALK, WHITE))


@lru_cache(maxsize=1024)
def equivalent_dof(n_phase: int, factor: int, kind: int) -> float:
    """Degrees of freedom of the overlapping Allan variance (Greenhall and Riley 2003).

    The variance is a mean of M = n_phase − 2m squares of a stationary Gaussian difference with
    autocorrelation ρ_k, so edf = M / (1 + 2 Σ (1 − k/M) ρ_k²).

    Parameters
    ----------
    n_phase : int
        Number of phase points, one more than of readings.
    factor : int
        Averaging factor m.
    kind : int
        `WHITE`, `FLICKER` or `RANDOM_WALK`.
    """
    terms = n_phase - 2 * factor
    # Exactly uncorrelated beyond 2m (white), or negligible beyond 8m (the others).
    lags = np.arange(0.0, min(terms, 8 * factor))
    s = {WHITE: _white, FLICKER: _flicker, RANDOM_WALK: _random_walk}[kind]
    m = float(factor)
    covariance = (
        6.0 * s(lags) - 4.0 * (s(lags + m) + s(lags - m)) + s(lags + 2.0 * m) + s(lags - 2.0 * m)
    )
    rho = covariance / covariance[0]
    return float(terms / (1.0 + 2.0 * np.sum((1.0 - lags[1:] / terms) * rho[1:] ** 2)))


# Generalized autocovariances of the phase for each kind, up to factors and to polynomials that
# the fourth difference takes away.
def _white(t: Array) -> Array:
    return -np.abs(t)


def _flicker(t: Array) -> Array:
    return t * t * np.log(np.maximum(np.abs(t), 1e-300))


def _random_walk(t: Array) -> Array:
    return np.abs(t) ** 3
