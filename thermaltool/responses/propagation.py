"""One mode over a stretch of input, in closed form, and from one stretch to the next."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.units import Hold

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


def propagate(p: Complex, dt: float | Float, hold: Hold) -> tuple[Complex, Complex, Complex]:
    """State of x' = p x + u over one sample: (e^(p dt), weight of u_before, weight of u_now).

    Parameters
    ----------
    p : ndarray, any shape [1/s]
    dt : float or ndarray [s]
        Broadcast against `p`.
    hold : "zero" or "first"
    """
    z = p * dt
    whole = dt * _phi(1, z)
    now = np.zeros_like(whole) if hold == "zero" else dt * _phi(2, z)
    return np.exp(z), whole - now, now


def propagate_double(p: Float, dt: float | Float, hold: Hold) -> tuple[Float, Float]:
    """Input weights of the second state, x2' = p x2 + x1 (the derivative of `propagate` by p).

    Parameters
    ----------
    p : ndarray, any shape [1/s]
    dt : float or ndarray [s]
        Broadcast against `p`.
    hold : "zero" or "first"
    """
    z = p * dt
    whole = dt**2 * (_phi(1, z) - _phi(2, z))
    now = np.zeros_like(whole) if hold == "zero" else dt**2 * (_phi(2, z) - 2 * _phi(3, z))
    return whole - now, now


def recursion_of(factor: Any, added: Any) -> Any:
    """x_(k+1) = factor_k x_k + added_k from rest, the state at rest first, shape (n + 1,).

    Parameters
    ----------
    factor, added : ndarray, shape (n,), real or complex
    """
    if not len(factor):
        return np.zeros(1)
    # Imported on use: the stream goes row by row and needs neither.
    if not np.ptp(factor):
        from scipy.signal import lfilter

        return np.append(0.0, lfilter([1.0], [1.0, -factor[0]], added))
    from scipy.linalg.lapack import dtbtrs, ztbtrs

    # A triangle of two diagonals, the main one of ones: forward substitution.
    bands = np.stack([np.ones_like(factor), -np.append(factor[1:], 0.0)])
    substituted = ztbtrs if np.iscomplexobj(added) else dtbtrs
    x, _ = substituted(bands, added, uplo="L", diag="U")
    return np.append(0.0, x)


def _phi(order: int, z: Any) -> Any:
    """φ1 = (e^z − 1)/z, φ_(k+1) = (φ_k − 1/k!)/z; by series where that would cancel."""
    small = np.abs(z) < (1e-8, 0.02, 0.1)[order - 1]
    safe = np.where(small, 1.0, z)
    value, factorial = np.expm1(safe) / safe, 1.0
    for k in range(1, order):
        factorial *= k
        value = (value - 1 / factorial) / safe
    series, term = np.zeros_like(z), np.ones_like(z) / math.factorial(order)
    for k in range(1, 9):
        series = series + term
        term = term * z / (order + k)
    return np.where(small, series, value)
