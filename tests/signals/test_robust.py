"""Standard deviation from the median of sizes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtri

from thermaltool.signals.robust import MAD_TO_SIGMA, robust_std


def test_the_constant_is_that_of_the_normal_distribution():
    assert pytest.approx(1 / ndtri(0.75), rel=1e-5) == MAD_TO_SIGMA


def test_outliers_move_it_by_little():
    x = 2.0 * np.random.default_rng(1).standard_normal(20000)
    assert robust_std(x) == pytest.approx(2.0, rel=0.03)
    x[::20] = 1e6
    assert robust_std(x) == pytest.approx(2.0, rel=0.1)
