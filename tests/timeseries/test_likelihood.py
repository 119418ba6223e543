"""The exact likelihood against a Kalman filter, its gradient, its maximum, and its cost."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from statsmodels.tsa.statespace.sarimax import SARIMAX

from thermaltool.errors import FitError
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import climb, start
from thermaltool.timeseries.runs import NEW_START, difference, even_record, gaps, pieces, runs

MODELS = [
    ([0.75, -0.68], [0.27]),
    ([0.9], [0.5, 0.3, 0.2]),
    ([], [0.9]),
    ([0.5, 0.2, 0.1], []),
    ([], []),
    ([0.3], [-0.97]),
    ([1.95, -0.951], [0.2]),
]


def simulated(ar, ma, size, seed=0, mean=3.0):
    noise = np.random.default_rng(seed).standard_normal(size + 200)
    return mean + lfilter(np.r_[1.0, ma], np.r_[1.0, -np.array(ar)], noise)[200:]


def differences(likelihood, ar, ma):
    both, out = np.r_[ar, ma], []
    for k in range(both.size):
        step = 1e-5 * np.eye(both.size)[k]
        ends = [np.split(both + s, [len(ar)]) for s in (step, -step)]
        out.append((likelihood.at(*ends[0]).deviance - likelihood.at(*ends[1]).deviance) / 2e-5)
    return np.array(out)


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize(("ar", "ma"), MODELS)
def test_agrees_with_a_kalman_filter_also_over_holes(ar, ma, missing):
    ar, ma = np.array(ar), np.array(ma)
    x = simulated(ar, ma, 80)
    if missing:
        x[[10, 11, 12, 20, 25, 27, 79]] = np.nan
    likelihood = ArmaLikelihood(even_record(x), 0)
    at = likelihood.at(ar, ma)
    judge = SARIMAX(x, order=(ar.size, 0, ma.size), exog=np.ones(80))
    parameters = np.r_[at.coefficients + likelihood.offset, ar, ma, at.sigma2]
    assert -0.5 * at.deviance == pytest.approx(judge.loglike(parameters), abs=1e-8)
    # Mean and variance are at their best.
    for k, step in ((0, 1e-3), (-1, 1e-3)):
        moved = parameters.copy()
        moved[k] += step
        assert judge.loglike(moved) < judge.loglike(parameters)


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize(("ar", "ma"), [m for m in MODELS if sum(map(len, m))])
def test_gradient_is_that_of_the_likelihood(ar, ma, missing):
    ar, ma = np.array(ar), np.array(ma)
    x = simulated(ar, ma, 300)
    if missing:
        x[[50, 51, 200]] = np.nan
    likelihood = ArmaLikelihood(even_record(x), 0)
    expected = differences(likelihood, ar, ma)
    got = likelihood.slope(ar, ma).gradient
    np.testing.assert_allclose(got, expected, rtol=2e-4, atol=2e-3 if not missing else 2e-2)


def test_segments_stand_for_themselves():
    x = simulated([0.8], [0.3], 200)
    both = even_record(x, (slice(0, 120), slice(120, 200)))
    assert gaps(both, runs(both)) == [NEW_START, NEW_START]
    ar, ma = np.array([0.8]), np.array([0.3])
    apart = [ArmaLikelihood(even_record(part), -1).at(ar, ma) for part in (x[:120], x[120:])]
    together = ArmaLikelihood(both, -1).at(ar, ma)
    assert together.square == pytest.approx(sum(each.square for each in apart), rel=1e-12)
    assert together.logdet == pytest.approx(sum(each.logdet for each in apart), rel=1e-12)


def test_maximum_is_where_the_gradient_vanishes():
    ar, ma = np.array([1.2, -0.8, 0.3]), np.array([0.5, 0.4])
    likelihood = ArmaLikelihood(even_record(simulated(ar, ma, 400)), 0)
    best, _ = climb(likelihood, start(likelihood, np.zeros(3), np.zeros(2)))
    assert best.converged
    assert np.abs(differences(likelihood, best.ar, best.ma)).max() < 0.05
    assert best.deviance < likelihood.at(ar, ma).deviance


def test_difference_of_a_record_with_holes():
    x = np.arange(10.0) ** 2
    x[4] = np.nan
    record = difference(even_record(x), 1)
    assert [run.tolist() for run in pieces(record)] == [[1.0, 3.0, 5.0], [11.0, 13.0, 15.0, 17.0]]
    rows = runs(record)
    assert [run.start for run in rows] == [1, 6]
    assert gaps(record, rows) == [NEW_START, 2]
    with pytest.raises(FitError):
        difference(even_record([1.0, np.nan, 2.0]), 1)
    with pytest.raises(FitError):
        runs(even_record([np.nan, np.nan]))
