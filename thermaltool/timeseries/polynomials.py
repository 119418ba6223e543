"""AR and MA polynomials: stationarity, partial autocorrelations, impulse responses.

Sign convention of the whole package: x_t = Σ ar_i x_{t-i} + a_t + Σ ma_j a_{t-j}. Box, Jenkins and
Gao (2000) write -θ for `ma`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

# Of roots in the unit circle; nearer ones leave a narrow line alone.
MAX_CANCELLING_DISTANCE = 0.1
MAX_PARTIAL = 1.0 - 5e-7  # partial autocorrelation: nearer to 1, the state's variance is rounding
MAX_DECAYED = 1e-10  # of a response that begins at 1: its square is rounding
MAX_MADE_PARTIAL = 0.995  # of a model that had to be made stationary: well inside, to climb from


def characteristic_roots(ar: Array) -> NDArray[np.complex128]:
    """Roots λ of λ^p - ar_1 λ^(p-1) - ... - ar_p; inside the unit circle when stationary.

    The MA roots are those of ``-ma``.
    """
    return (
        np.roots(np.concatenate(([1.0], -ar))).astype(complex) if ar.size else np.empty(0, complex)
    )


def reflected(ar: Array) -> Array:
    """`ar` with every root outside the unit circle moved to its mirror image inside.

    On white innovations both give the same autocorrelation; on the circle itself nothing changes.
    """
    roots = characteristic_roots(ar)
    outside = np.abs(roots) > 1.0
    if not outside.any():
        return ar
    roots[outside] = 1.0 / np.conj(roots[outside])
    return -np.real(np.poly(roots))[1:]


def to_partial(ar: Array) -> Array:
    """Partial autocorrelations of `ar` by the step-down recursion; all below 1 when stationary."""
    phi, partial = ar.copy(), np.empty(ar.size)
    for k in range(ar.size - 1, -1, -1):
        r = partial[k] = phi[k]
        if abs(r) >= 1.0:
            partial[:k] = np.inf
            return partial
        phi = (phi[:k] + r * phi[:k][::-1]) / (1.0 - r * r)
    return partial


def from_partial(partial: NDArray[Any]) -> NDArray[Any]:
    """`ar` of partial autocorrelations, shape (..., p), by the Levinson-Durbin recursion."""
    phi = partial.copy()
    for k in range(1, partial.shape[-1]):
        before = phi[..., :k]
        phi[..., :k] = before - partial[..., k : k + 1] * before[..., ::-1]
    return phi


def is_stationary(ar: Array) -> bool:
    """All characteristic roots inside the unit circle."""
    return bool(np.all(np.abs(to_partial(ar)) < 1.0))


def is_stationary_and_invertible(ar: Array, ma: Array) -> bool:
    """All AR and MA roots inside the unit circle."""
    return is_stationary(ar) and is_stationary(-ma)


def to_free(ar: Array) -> Array:
    """Unbounded coordinates u of a stationary `ar`, r = u / sqrt(1 + u²) its partials (Monahan).

    Roots outside are reflected first; what is too near the circle is drawn in.

    Source: J. F. Monahan, Biometrika 71 (1984) 403.
    """
    partial, limit = to_partial(ar), MAX_PARTIAL
    if not np.all(np.abs(partial) < 1.0):
        partial, limit = to_partial(reflected(ar)), MAX_MADE_PARTIAL
        partial = np.nan_to_num(partial, posinf=limit)
    partial = np.minimum(np.maximum(partial, -limit), limit)
    return partial / np.sqrt(1.0 - partial**2)


def from_free(free: Array) -> Array:
    """The stationary `ar` of unbounded coordinates."""
    return from_partial(free / np.sqrt(1.0 + free**2))


def free_jacobian(free: Array) -> Array:
    """d ar_i / d u_j, ndarray (p, p), by complex steps (exact to rounding)."""
    step = 1e-30
    moved = free + 1j * step * np.eye(free.size)
    return np.asarray(from_partial(moved / np.sqrt(1.0 + moved**2)).imag.T / step)


def impulse_response(ar: Array, ma: Array, size: int) -> Array:
    """ψ weights ψ_0 = 1, ψ_1, ... of (1 + ma B...)/(1 - ar B...), ndarray (size,)."""
    pulse = np.zeros(size)
    pulse[0] = 1.0
    top, bottom = np.concatenate(([1.0], ma)), np.concatenate(([1.0], -ar))
    return np.asarray(lfilter(top, bottom, pulse))


def decayed_response(denominator: Array, limit: int) -> Array:
    """Impulse response of 1/(1 + d_1 B + ...) until it has decayed, at most `limit` long."""
    size, order = 64, denominator.size - 1
    while True:
        size = min(size, limit)
        pulse = np.zeros(size)
        pulse[0] = 1.0
        h = np.asarray(lfilter([1.0], denominator, pulse))
        if size == limit or np.abs(h[-order - 1 :]).max() < MAX_DECAYED:
            return h
        size *= 4


def cancelling(
    ar: Array, ma: Array, distance: float = MAX_CANCELLING_DISTANCE
) -> list[tuple[complex, complex]]:
    """Pairs of an AR and an MA root nearer than `distance`; of conjugates one."""
    pairs = []
    free = list(characteristic_roots(-ma))
    for root in characteristic_roots(ar):
        if root.imag < 0.0 or not free:
            continue
        alike = [other for other in free if (other.imag > 0.0) == (root.imag > 0.0)]
        nearest = min(alike, key=lambda other: abs(other - root), default=None)
        if nearest is not None and abs(nearest - root) < distance:
            pairs.append((complex(root), complex(nearest)))
            free.remove(nearest)
    return pairs


def root_factor(root: complex) -> Array:
    """1 - root B of a real root, else the factor of it and its conjugate, ndarray (2,) or (3,)."""
    if root.imag == 0.0:
        return np.array([1.0, -root.real])
    return np.array([1.0, -2.0 * root.real, abs(root) ** 2])


def without_root(ar: Array, root: complex) -> Array:
    """`ar` without `root`, and without its conjugate."""
    factor = root_factor(root)
    # The first terms of the power series are the quotient.
    quotient = lfilter([1.0], factor, np.concatenate(([1.0], -ar)))
    return -np.asarray(quotient[1 : ar.size + 2 - factor.size], dtype=float)
