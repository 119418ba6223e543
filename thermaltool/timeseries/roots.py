"""What the roots of an ARMA model say: modes in continuous time, stationarity, cancellation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from thermaltool.signals.intervals import Estimate, log_normal_estimate, standard_error
from thermaltool.timeseries.model import ArmaModel
from thermaltool.timeseries.polynomials import characteristic_roots

Array = NDArray[np.float64]

# 5 % points of samples times (root - 1) for long records: W. A. Fuller, Introduction to Statistical
# Time Series (1976), table 8.5.1, by the degree of the trend.
UNIT_ROOT_LIMITS = {-1: -8.1, 0: -14.1, 1: -21.8}


@dataclass(frozen=True)
class Mode:
    """A real root, or a conjugate pair, of the AR part and its equivalent in continuous time.

    Attributes
    ----------
    root : complex
        λ, with imaginary part >= 0.
    natural : Estimate or None
        Natural frequency ω_n = |ln λ| / Δ of a pair [rad/s].
    damping : Estimate or None
        ξ = -Re ln λ / |ln λ| of a pair.
    time_constant : Estimate
        -Δ / ln|λ| [s]. A negative real root alternates: it has no such equivalent, and this is the
        decay of its amplitude.
    """

    root: complex
    natural: Estimate | None
    damping: Estimate | None
    time_constant: Estimate

    @property
    def alternates(self) -> bool:
        """A real root below 0: no process in continuous time has it."""
        return self.root.imag == 0.0 and self.root.real < 0.0


def modes(model: ArmaModel, level: float = 0.95) -> tuple[Mode, ...]:
    """The AR roots of a model as modes, slowest first; intervals by the delta method.

    ln λ changes with the coefficients by ∂λ/∂ar_i = λ^(p-i) / P'(λ), P the characteristic
    polynomial. The intervals are NaN where the coefficients are undetermined or a root is double.
    """
    p = model.ar.size
    polynomial = np.concatenate(([1.0], -model.ar))
    covariance = np.full((p, p), np.nan)
    if model.covariance is not None:
        covariance = model.covariance[:p, :p]
    quantile = float(ndtri(0.5 + 0.5 * level))

    def positive(value: float, gradient: Array, unit: str) -> Estimate:
        error = standard_error(gradient, covariance) / value
        return log_normal_estimate(value, error, unit, quantile)

    found = []
    for root in characteristic_roots(model.ar):
        if root.imag < 0.0 or root == 0.0:
            continue
        slope = np.polyval(np.polyder(polynomial), root)
        with np.errstate(divide="ignore", invalid="ignore"):
            ds = root ** np.arange(p - 1.0, -1.0, -1.0) / slope / root / model.period_s
        s = complex(np.log(root) / model.period_s)
        size, natural, damping = abs(s), None, None
        time_constant = positive(-1.0 / s.real, ds.real / s.real**2, "s")
        if root.imag != 0.0:
            d_size = (s.real * ds.real + s.imag * ds.imag) / size
            natural = positive(size, d_size, "rad/s")
            damping = positive(-s.real / size, s.real * d_size / size**2 - ds.real / size, "")
        found.append(Mode(complex(root), natural, damping, time_constant))
    return tuple(sorted(found, key=lambda mode: -abs(mode.root)))


def near_unit(ar: Array, size: int, degree: int = 0) -> bool:
    """Whether a real AR root is not told from 1 by so many samples: a random walk.

    By its distance from 1 in units of 1/size (Fuller's coefficient test).
    """
    roots = characteristic_roots(ar)
    limit = max(1.0 + UNIT_ROOT_LIMITS[degree] / size, 0.0)
    return bool(np.any((roots.imag == 0.0) & (roots.real > limit)))
