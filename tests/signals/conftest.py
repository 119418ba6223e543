"""Simulated readings, made with numpy alone."""

import numpy as np
import pytest


def _drifting(rng, time, white, sigma, tau):
    """White noise plus Ornstein-Uhlenbeck drift at any increasing times, by exact transitions."""
    steps = np.diff(time)
    decay = np.exp(-steps / tau)
    kicks = sigma * np.sqrt(-np.expm1(-2.0 * steps / tau)) * rng.standard_normal(steps.size)
    x = np.empty(time.size)
    x[0] = sigma * rng.standard_normal()
    for i in range(steps.size):
        x[i + 1] = decay[i] * x[i] + kicks[i]
    return x + white * rng.standard_normal(time.size)


def _warm_up(time, start, amplitude=8.0, tau=900.0):
    return amplitude * -np.expm1(-np.maximum(time - start, 0.0) / tau)


@pytest.fixture
def drifting():
    return _drifting


@pytest.fixture
def warm_up():
    return _warm_up
