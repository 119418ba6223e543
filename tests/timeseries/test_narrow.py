"""Narrow lines: what is promised for them is what the exact likelihood gains."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import climb, start
from thermaltool.timeseries.narrow import narrow_factors, with_line
from thermaltool.timeseries.runs import even_record
from thermaltool.timeseries.starts import all_starts

NONE = np.empty(0)


def base_of(x, ar=NONE, ma=NONE):
    likelihood = ArmaLikelihood(even_record(x), 0)
    fit = climb(likelihood, start(likelihood, ar, ma), 60, 1e-4)[0]
    return likelihood, fit, likelihood.innovations(fit.ar, fit.ma, fit.at.coefficients)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("size", "near"), [(301, 0.2), (1000, 0.05)])
def test_the_gain_of_a_line_is_that_of_the_exact_likelihood(seed, size, near):
    # But for how the two roots of a pair act on each other: less in long records.
    x = np.random.default_rng([seed, size]).standard_normal(size)
    likelihood, base, e = base_of(x)
    lines = [line for line in narrow_factors(e) if line.ar.size == 2][:4]
    assert len(lines) == 4
    for line in lines:
        there = start(likelihood, *with_line(base.ar, base.ma, line))
        assert base.deviance - there.deviance == pytest.approx(line.gain, rel=near, abs=0.3)


def test_lines_come_best_first_and_apart():
    x = np.random.default_rng(8).standard_normal(800)
    lines = narrow_factors(x - x.mean())
    gains = [line.gain for line in lines]
    assert gains == sorted(gains, reverse=True)
    assert all(gain > 0.0 for gain in gains)


@pytest.mark.parametrize("angle", [0.4, 1.7, 2.9])
def test_a_line_is_found_at_its_angle(angle):
    rng = np.random.default_rng([3, int(10 * angle)])
    t = np.arange(1000)
    phase = angle * t + 0.02 * np.cumsum(rng.standard_normal(t.size))
    line = narrow_factors(rng.standard_normal(t.size) + 0.6 * np.sin(phase))[0]
    assert line.gain > 50.0
    assert line.angle == pytest.approx(angle, abs=0.02)


def test_innovations_begin_from_the_most_likely_state():
    # An MA root on the circle forgets nothing: a zero past would leave its mark on all samples.
    e = np.random.default_rng(5).standard_normal(401)
    _, fit, found = base_of(np.diff(e), ma=np.array([-0.9]))
    assert fit.ma[0] < -0.98
    assert np.sum((found - e[1:]) ** 2) < 0.03 * np.sum(e**2)
    assert np.sum(found**2) <= fit.at.square * (1.0 + 1e-9)


def test_starts_of_a_series_that_is_a_difference():
    # The MA root at 1, which a regression on lags leaves far away.
    e = np.random.default_rng(11).standard_normal(241)
    likelihood, best, _ = base_of(np.diff(e), ma=np.array([-0.98]))
    nearest = min(all_starts(likelihood, 0, 1), key=lambda each: each.deviance)
    assert nearest.deviance < best.deviance + 1.0
