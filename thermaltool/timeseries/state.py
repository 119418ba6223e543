"""State of an ARMA process in prediction form: its transition, its covariance, its expectation.

The state c of max(p, q, 1) numbers is what the past adds to the future, θ(B) a = φ(B) x - c:
c_{t+1} = T c_t + (ar + ma) a_t. Covariances are in units of σ².

Own sums by doubling: `scipy.linalg.solve_discrete_lyapunov` takes 2 to 3.5 times as long at 2 to 10
states, and every likelihood and gradient asks for one.

Source: G. Gardner, A. C. Harvey, G. D. A. Phillips, Appl. Statist. 29 (1980) 311.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermaltool.signals.covariance_root import covariance_root
from thermaltool.timeseries.lagged import lagged_gram
from thermaltool.timeseries.polynomials import decayed_response

Array = NDArray[np.float64]

MAX_STATE_VARIANCE = 1e13  # [σ²]; above, rounding cannot tell the process from no stationary one
MAX_DOUBLINGS = 60  # 2^60 terms: beyond, every sum has settled or grown without bound


def padded(ar: Array, ma: Array) -> tuple[Array, Array]:
    """1 - ar B..., 1 + ma B..., both of max(p, q, 1) + 1 coefficients."""
    order = max(ar.size, ma.size, 1)
    phi, theta = np.zeros(order + 1), np.zeros(order + 1)
    phi[0] = theta[0] = 1.0
    phi[1 : ar.size + 1], theta[1 : ma.size + 1] = -ar, ma
    return phi, theta


def companion(ar: Array) -> Array:
    """T of c_{t+1} = T c_t + (ar + ma) a_t."""
    T = np.eye(ar.size, k=1)
    T[:, 0] = ar
    return T


def state_covariance(ar: Array, ma: Array) -> Array:
    """Ω of the stationary state, in units of σ², ndarray (r, r).

    Parameters
    ----------
    ar, ma : ndarray (r,)
        Padded with zeros to one length.

    Raises
    ------
    numpy.linalg.LinAlgError
        Variance above what rounding can tell from that of no stationary process.
    """
    drive = ar + ma
    covariance = accumulated(companion(ar), drive[:, None] * drive)
    if not np.abs(covariance).max() < MAX_STATE_VARIANCE:
        raise np.linalg.LinAlgError("roots on the unit circle")
    return covariance


def accumulated(T: Array, M: Array) -> Array:
    """Σ_k T^k M T'^k, by doubling the number of terms; stops where it grows without bound."""
    total, power = M, T
    for _ in range(MAX_DOUBLINGS):
        total = total + power @ total @ power.T
        power = power @ power
        if not 1e-18 < float(np.vdot(power, power)) < 1e60:
            break
    return total


def predicted(
    phi: Array, theta: Array, mean: Array, covariance: Array, gap: int
) -> tuple[Array, Array]:
    """State and covariance after `gap` samples that nobody saw, by squaring."""
    T, drive = companion(-phi[1:]), theta[1:] - phi[1:]
    power, noise = np.eye(drive.size), np.zeros_like(covariance)
    square, added = T, np.outer(drive, drive)
    while gap:
        if gap & 1:
            noise = noise + power @ added @ power.T
            power = power @ square
        added = added + square @ added @ square.T
        square = square @ square
        gap >>= 1
    return power @ mean, power @ covariance @ power.T + noise


def root_of(covariance: Array) -> Array:
    """L with L L' = covariance, which may be singular."""
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=float)
    except np.linalg.LinAlgError:
        return covariance_root(covariance)


def expected_gram(ar: Array, ma: Array) -> Array:
    """Information of one sample on (ar, ma), ndarray (p + q, p + q).

    Covariances of a/φ(B) and a/θ(B) at unit variance (Box, Jenkins, Time Series Analysis, 7.2).
    """
    u = decayed_response(np.concatenate(([1.0], -ar)), 100_000)
    v = decayed_response(np.concatenate(([1.0], ma)), 100_000)
    size = max(u.size, v.size) + ar.size + ma.size
    return lagged_gram(
        np.pad(u, (0, size - u.size)), np.pad(v, (0, size - v.size)), ar.size, ma.size
    )


def transition(ar: Array, ma: Array) -> Array:
    """T, ndarray (r, r), of the expected state from one sample to the next."""
    return companion(-padded(ar, ma)[0][1:])
