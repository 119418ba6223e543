"""Tests of residuals: white, and independent of an input.

Own sums, because `statsmodels.stats.diagnostic.acorr_ljungbox` takes one series without a hole:
laid end to end, the last residuals of a piece would count against the first of the next. On one
piece both agree to rounding.

Sources: G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297; L. Ljung, System Identification
(1999), 16.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, kolmogorov

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PortmanteauTest:
    """A sum of squared correlations against its χ² distribution.

    Attributes
    ----------
    statistic : float
    lags : int
        Lags that were summed.
    dof : int
        Degrees of freedom of the χ² distribution.
    """

    statistic: float
    lags: int
    dof: int

    @property
    def p_value(self) -> float:
        """Probability of so large a statistic without correlation."""
        return float(chdtrc(self.dof, self.statistic))


def ljung_box(pieces: Sequence[Array], lags: int, fitted: int = 0) -> PortmanteauTest:
    """Whiteness of residuals: N (N + 2) Σ r_k² / (N - k) (Ljung and Box 1978, eq. 1.3).

    Residuals of zero count as white.

    Parameters
    ----------
    pieces : sequence of ndarray, shape (n_i,)
        Residuals without their mean; pairs do not reach across pieces.
    lags : int
        Largest lag.
    fitted : int
        Parameters that were fitted to the correlation of these residuals.
    """
    rows = sum(len(piece) for piece in pieces)
    power = sum(float(piece @ piece) for piece in pieces)
    lag = np.arange(1, lags + 1)
    products = [sum(_lagged(e, k) for e in pieces) for k in lag.tolist()]
    correlation = np.array(products) / (power or 1.0)
    statistic = rows * (rows + 2) * float(np.sum(correlation**2 / (rows - lag)))
    return PortmanteauTest(statistic, lags, max(lags - fitted, 1))


@dataclass(frozen=True)
class PeriodogramTest:
    """The largest distance of a cumulated periodogram from that of white noise.

    Attributes
    ----------
    distance : float
        Between 0 and 1; NaN below six samples.
    frequencies : int
        Ordinates that were summed.
    """

    distance: float
    frequencies: int

    @property
    def p_value(self) -> float:
        """Probability of so large a distance of white noise (Kolmogorov)."""
        return float(kolmogorov(np.sqrt(self.frequencies) * self.distance))


def cumulated_periodogram(residuals: Array) -> PeriodogramTest:
    """Whiteness of residuals: their spectrum's sums against a straight line.

    M. S. Bartlett, J. R. Stat. Soc. B 16 (1954) 296, with Stephens' correction for few ordinates
    (J. Am. Stat. Assoc. 69 (1974) 730).

    Parameters
    ----------
    residuals : ndarray, shape (n,)
        One stretch, on a clock that is nearly even.
    """
    power = np.abs(np.fft.rfft(residuals - np.mean(residuals)))[1 : (len(residuals) + 1) // 2] ** 2
    count = len(power) - 1
    if count < 1 or not power.sum() > 0:
        return PeriodogramTest(float("nan"), max(count, 0))
    sums = np.cumsum(power)[:-1] / power.sum()
    steps = np.arange(1, count + 1) / count
    distance = float(np.max(np.maximum(steps - sums, sums - steps + 1 / count)))
    root = np.sqrt(count)
    return PeriodogramTest(distance * (root + 0.12 + 0.11 / root) / root, count)


def correlation_function(
    first: Sequence[Array], second: Sequence[Array], lags: int
) -> tuple[Array, float]:
    """Correlation of one signal with another that is earlier by −lags … lags samples.

    Parameters
    ----------
    first, second : sequence of ndarray, shape (n_i,)
        Both without their mean; pairs do not reach across pieces.
    lags : int

    Returns
    -------
    correlation : ndarray, shape (2 lags + 1,)
        NaN where one of the two does not vary.
    deviation : float
        Standard deviation of each where the two are independent, whatever their own correlation:
        √(Σ ρ₁ ρ₂ / N) (M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536).
    """
    rows = sum(len(each) for each in first)
    products, own, other = (
        np.sum([_products(a, b, lags) for a, b in zip(x, y, strict=True)], axis=0)
        for x, y in ((first, second), (first, first), (second, second))
    )
    power = np.sqrt(own[lags] * other[lags])
    if not power > 0:
        return np.full(2 * lags + 1, np.nan), float("nan")
    # The sum of noise is noise, too: it is not let fall below that of white signals.
    spread = max(float(np.sum(own * other)) / power**2, 1.0)
    return products / power, float(np.sqrt(spread / rows))


def _products(a: Array, b: Array, lags: int) -> Array:
    """Σ a_{t} b_{t−k} for k from −lags to lags, by way of the spectra."""
    size = 1 << (len(a) + lags).bit_length()
    whole = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    return np.asarray(np.concatenate([whole[size - lags :], whole[: lags + 1]]))


def _lagged(e: Array, lag: int) -> float:
    return float(e[lag:] @ e[: len(e) - lag]) if lag < len(e) else 0.0


def cross_correlation(
    residuals: Sequence[Array], inputs: Sequence[Array], lags: int, delay: int = 0
) -> PortmanteauTest:
    """Independence of residuals from an input's past: N Σ r_k² (Ljung 1999, 16.6).

    The χ² distribution holds where both are white. Parameters that were fitted make the sum
    smaller, by how much depends on how slow they are: the test is a little cautious. The statistic
    is NaN where one of the two does not vary.

    Parameters
    ----------
    residuals, inputs : sequence of ndarray, shape (n_i,)
        Both without their mean and prewhitened.
    lags : int
        Number of lags.
    delay : int
        First lag.
    """
    products = np.zeros(lags)
    for e, u in zip(residuals, inputs, strict=True):
        for k in range(min(lags, max(len(e) - delay, 0))):
            products[k] += float(e[delay + k :] @ u[: len(e) - delay - k])
    power = sum(float(e @ e) for e in residuals) * sum(float(u @ u) for u in inputs)
    rows = sum(len(e) for e in residuals)
    statistic = rows * float(products @ products) / power if power > 0 else float("nan")
    return PortmanteauTest(statistic, lags, lags)
