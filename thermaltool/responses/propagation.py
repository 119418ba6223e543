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
    """x_(k+1) = factor_k x_k + added_k from rest, the state at rest first, shape (m, n + 1).

    Parameters
    ----------
    factor, added : ndarray, shape (m, n), real or complex
        One recursion in each row; what is not finite in one is none in those that follow.
    """
    m, n = added.shape
    found = np.zeros((m, n + 1), np.result_type(factor, added))
    if not n:
        return found
    # Imported on use: the stream goes row by row and does not need it. `scipy.signal` would take
    # longer to import, and longer for each recursion.
    from scipy.linalg.lapack import dtbtrs, ztbtrs

    # A triangle of two diagonals, the main one of ones: forward substitution. All recursions are
    # one triangle, for a call costs as much as a thousand rows; the last row of each passes nothing
    # on that is finite.
    below = np.zeros((m, n), found.dtype)
    np.negative(factor[:, 1:], out=below[:, :-1])
    bands = np.empty((2, m * n), found.dtype, order="F")
    bands[0], bands[1] = 1.0, below.ravel()
    substituted = ztbtrs if np.iscomplexobj(found) else dtbtrs
    x, _ = substituted(bands, added.ravel(), uplo="L", diag="U")
    found[:, 1:] = x.reshape(m, n)
    return found


def _phi(order: int, z: Any) -> Any:
    """φ1 = (e^z − 1)/z, φ_(k+1) = (φ_k − 1/k!)/z; by series where that would cancel."""
    small = np.abs(z) < (1e-8, 0.02, 0.1)[order - 1]
    some = bool(np.any(small))
    safe = np.where(small, 1.0, z) if some else z
    value, factorial = np.expm1(safe) / safe, 1.0
    for k in range(1, order):
        factorial *= k
        value = (value - 1 / factorial) / safe
    if not some:
        return value
    near = np.extract(small, z)
    series, term = np.zeros_like(near), np.ones_like(near) / math.factorial(order)
    for k in range(1, 9):
        series = series + term
        term = term * near / (order + k)
    value = np.array(value)
    value[small] = series
    return value
