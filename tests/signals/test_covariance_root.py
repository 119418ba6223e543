"""Roots of covariances against NumPy's own products."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.signals.covariance_root import covariance_root


def test_small_parameters_keep_their_digits():
    """Of 1e9 and 1e-9: a common unit would lose the second to rounding."""
    size = np.array([1e9, 1.0, 1e-9])
    correlation = np.array([[1.0, 0.9, -0.5], [0.9, 1.0, -0.2], [-0.5, -0.2, 1.0]])
    root = covariance_root(correlation * np.outer(size, size))
    assert root @ root.T / np.outer(size, size) == pytest.approx(correlation, rel=1e-12)


def test_a_parameter_that_is_known_stays_known():
    root = covariance_root(np.diag([0.0, 4.0]))
    assert root @ root.T == pytest.approx(np.diag([0.0, 4.0]))


def test_a_difference_of_covariances_keeps_its_positive_part():
    turn = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
    root = covariance_root(turn @ np.diag([3.0, -1.0]) @ turn)
    assert root @ root.T == pytest.approx(turn @ np.diag([3.0, 0.0]) @ turn)
