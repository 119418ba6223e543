"""The colour of the noise from what a fit has left of it."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from thermaltool.fitting.joint import (
    ProjectedOutput,
    Sensitivities,
    criterion,
    joint_covariances,
)


def projected(columns, y, slopes):
    """One output by least squares on `columns`, shape (l, n); nothing is searched but a scale."""
    gram = columns @ columns.T
    linear = np.linalg.solve(gram, columns @ y)
    left = slopes - slopes @ columns.T @ np.linalg.solve(gram, columns)
    error = y - linear @ columns
    by_searched = np.linalg.solve(gram, columns @ slopes.T)
    return ProjectedOutput(
        linear, float(error @ error), len(y), by_searched, gram, left @ left.T, left @ error
    ), error, left  # fmt: skip


def test_errors_of_linear_parameters_hold_in_slow_noise():
    """Twelve slow columns in AR(1) noise of 0.8: the fit absorbs a tenth of it, all of it slow."""
    rng = np.random.default_rng(81)
    n, size = 1000, 12
    columns = np.array([np.cos(np.pi * k * np.arange(n) / n) for k in range(size)])
    slopes = rng.standard_normal((1, n))
    found, stated = [], []
    for _ in range(150):
        white = rng.standard_normal(n + 300)
        y = np.asarray(lfilter([1.0], [1.0, -0.8], white))[300:]
        output, error, left = projected(columns, y, slopes)
        record = Sensitivities(np.arange(size), [left], [columns])
        (covariance,), _ = joint_covariances([output], [[error]], lambda: [record], size)  # noqa: B023
        found.append(output.linear)
        stated.append(np.diag(covariance)[1:])
    # The mean over columns of truth and statement; 150 · 12 values tell it to 4 %.
    ratio = np.mean(np.mean(stated, axis=0)) / np.mean(np.var(found, axis=0))
    assert 0.9 < ratio < 1.15


def test_no_noise_and_no_rows_are_no_trouble():
    assert criterion([(1.0, 0)]) == 0.0
    columns = np.vstack([np.ones(200), np.linspace(-1, 1, 200)])
    y = 3 * columns[1] + 1e-14 * np.sin(np.arange(200))
    output, error, left = projected(columns, y, np.linspace(0, 1, 200)[None] ** 3)
    record = Sensitivities(np.arange(2), [left], [columns])
    (covariance,), (variance,) = joint_covariances([output], [[error]], lambda: [record], 2)
    assert np.isfinite(covariance).all()
    assert variance < 1e-25
