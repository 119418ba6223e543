"""Values with intervals, of 95 % by default: normal in the value, or in its logarithm."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Half the width of a 95 % interval in standard errors.
NORMAL_95 = 1.959963984540054
# Beyond this, exp overflows: an interval that ends at infinity says that nothing is known.
_MAX_EXPONENT = 700.0


@dataclass(frozen=True)
class Estimate:
    """A value with its interval, 95 % where nothing else is asked for.

    Attributes
    ----------
    value, low, high : float [unit]
    unit : str
        As `thermaltool.units` writes it; empty where the context says it.
    """

    value: float
    low: float
    high: float
    unit: str = ""

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.value:.5g} ({self.low:.4g} to {self.high:.4g}){unit}"


def normal_estimate(value: float, error: float, unit: str = "") -> Estimate:
    """A value and its standard error, normal.

    Parameters
    ----------
    value, error : float [unit]
    """
    half = NORMAL_95 * error
    return Estimate(value, value - half, value + half, unit)


def log_normal_estimate(
    value: float, error: float, unit: str = "", quantile: float = NORMAL_95
) -> Estimate:
    """A positive value, normal in the logarithm.

    Parameters
    ----------
    value : float [unit]
    error : float
        Standard error of ln(value).
    quantile : float
        Half the width of the interval in standard errors.
    """
    spread = math.exp(min(quantile * error, _MAX_EXPONENT))
    return Estimate(value, value / spread, value * spread, unit)


def standard_error(slope: Array, covariance: Array) -> float:
    """Standard error of a function of parameters, to first order.

    Parameters
    ----------
    slope : ndarray, shape (p,)
        Derivative in each parameter.
    covariance : ndarray, shape (p, p)
    """
    return math.sqrt(max(float(slope @ covariance @ slope), 0.0))
