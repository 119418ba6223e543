"""Random stable systems of second order with delay, and records of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter


@dataclass(frozen=True)
class Case:
    """A system, its input and its outputs without and with noise."""

    B: np.ndarray
    F: np.ndarray
    nk: int
    u: np.ndarray
    x: np.ndarray
    y: np.ndarray
    stiff: bool


def case(seed, rows, noise=0.1, offset=3.0):
    """Every fourth is stiff (ratio of time constants 200 to 800); delays are 1, 4 and 7 samples."""
    rng = np.random.default_rng(seed)
    stiff, nk = seed % 4 == 3, 1 + 3 * (seed % 3)
    if stiff:
        poles = np.exp(-1 / np.array([2.5, rng.uniform(500, 2000)]))
    elif rng.integers(3) == 0:
        poles = np.exp(-1 / np.exp(rng.uniform(np.log(2), np.log(60), 2)))
    else:
        radius, angle = rng.uniform(0.6, 0.97), rng.uniform(0.05, 1.2)
        poles = radius * np.exp(1j * angle * np.array([1, -1]))
    F = np.poly(poles).real
    B = rng.standard_normal(2)
    B *= rng.uniform(0.5, 3) * F.sum() / B.sum()
    held = 50 if stiff else 1 + 4 * (seed % 2)
    u = np.repeat(rng.standard_normal(rows // held + 1), held)[:rows]
    x = lfilter(np.r_[np.zeros(nk), B], F, u)
    y = x + noise * x.std() * rng.standard_normal(rows) + offset
    return Case(B, F, nk, u, x, y, stiff)


def fit_percent(truth, computed):
    return 100 * (1 - np.linalg.norm(truth - computed) / np.linalg.norm(truth - truth.mean()))
