"""Denominators in the shift operator: F(q) = 1 + f1 q^-1 + ... + fn q^-n, as (1, f1, ..., fn)."""

from __future__ import annotations

from collections.abc import Iterable
from math import comb

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Poles are kept inside this radius, so that a simulation over any record stays finite.
MAX_POLE_RADIUS = 1 - 1e-6


def stabilized(F: Array) -> Array:
    """Poles outside the unit circle reflected into it."""
    if _inside(F, MAX_POLE_RADIUS):
        return F
    poles = np.roots(F)
    size = np.abs(poles)
    poles = np.where(size > 1, poles / np.maximum(size, 1e-300) ** 2, poles)
    size = np.abs(poles)
    poles = np.where(size > MAX_POLE_RADIUS, poles / size * MAX_POLE_RADIUS, poles)
    return np.asarray(np.poly(poles).real)


def _inside(F: Array, radius: float) -> bool:
    """Whether all poles are inside this radius: all reflection coefficients below one (Jury)."""
    f = [float(c) / radius**k for k, c in enumerate(F)][1:]
    while f:
        last = f.pop()
        if not abs(last) < 1:
            return False
        f = [(a - last * b) / (1 - last * last) for a, b in zip(f, f[::-1], strict=True)]
    return True


def difference_basis(n: int) -> Array:
    """Row j: (1 − q^-1)^j in powers of q^-1, shape (n, n).

    Slow poles make the lags of a signal nearly equal; its differences are not, and the normal
    equations in them stay well conditioned at fast sampling.
    """
    rows = np.zeros((n, n))
    for j in range(n):
        rows[j, : j + 1] = [(-1) ** k * comb(j, k) for k in range(j + 1)]
    return rows


def from_real_roots(roots: Array) -> Array:
    """Coefficients of Π(x − root), as `numpy.poly`; without its checks, for searches call it often.

    Parameters
    ----------
    roots : ndarray, shape (n,)

    Returns
    -------
    coefficients : ndarray, shape (n + 1,)
    """
    f = np.zeros(len(roots) + 1)
    f[0] = 1.0
    for k, root in enumerate(roots.tolist()):
        f[1 : k + 2] -= root * f[: k + 1]
    return f


def from_lags(tau: Array) -> Array:
    """The denominator with real poles exp(−1/τ), τ in samples."""
    return from_real_roots(np.exp(-1.0 / np.asarray(tau, float)))


def partial_fractions(roots: Array, powers: Iterable[int]) -> Array:
    """Residues of x^k / Π(x − root) at distinct roots, for powers k below their count.

    Parameters
    ----------
    roots : ndarray, shape (..., n)
    powers : iterable of int, m of them

    Returns
    -------
    residues : ndarray, shape (..., m, n)
    """
    between = roots[..., :, None] - roots[..., None, :] + np.eye(roots.shape[-1])
    return np.stack([roots**k for k in powers], axis=-2) / np.prod(between, axis=-1)[..., None, :]
