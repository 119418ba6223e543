"""Residual tests against statsmodels and against what independent noise gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest
from statsmodels.stats.diagnostic import acorr_ljungbox

from thermaltool.signals.whiteness import (
    correlation_function,
    cross_correlation,
    cumulated_periodogram,
    ljung_box,
)


@pytest.mark.parametrize("fitted", [0, 3])
def test_one_piece_agrees_with_statsmodels(fitted: int) -> None:
    x = np.random.default_rng(1).normal(size=300)
    x[1:] += 0.2 * x[:-1]
    x -= x.mean()
    ours = ljung_box([x], 12, fitted)
    theirs = acorr_ljungbox(x, lags=[12], model_df=fitted).iloc[0]
    assert ours.statistic == pytest.approx(theirs["lb_stat"], rel=1e-10)
    assert ours.p_value == pytest.approx(theirs["lb_pvalue"], rel=1e-10)


def test_pairs_do_not_reach_across_pieces() -> None:
    x = np.random.default_rng(2).normal(size=(40, 50))
    x[:, [0, -1]] = 4.0
    one = ljung_box(list(x), 5)
    assert ljung_box(list(x[::-1]), 5).statistic == pytest.approx(one.statistic, rel=1e-12)
    assert one.p_value > 0.01
    assert acorr_ljungbox(np.concatenate(x), lags=[5]).iloc[0]["lb_pvalue"] < 1e-6


def test_p_values_of_white_noise_are_uniform() -> None:
    rng = np.random.default_rng(3)
    p = [ljung_box([rng.normal(size=200) for _ in range(4)], 10).p_value for _ in range(400)]
    assert kstest(p, "uniform").pvalue > 0.01


def test_p_values_of_independent_series_are_uniform() -> None:
    rng = np.random.default_rng(4)
    p = [
        cross_correlation([rng.normal(size=500)], [rng.normal(size=500)], 10, 2).p_value
        for _ in range(400)
    ]
    assert kstest(p, "uniform").pvalue > 0.01


def test_an_input_that_acts_late_is_found_from_its_delay_on() -> None:
    rng = np.random.default_rng(5)
    u = rng.normal(size=400)
    e = rng.normal(size=400)
    e[3:] += 0.4 * u[:-3]
    assert cross_correlation([e], [u], 5, 3).p_value < 1e-6
    assert cross_correlation([e], [u], 5, 4).p_value > 1e-3


def test_what_does_not_vary_is_white_and_has_no_correlation() -> None:
    assert ljung_box([np.zeros(50)], 5).p_value == 1.0
    assert np.isnan(cross_correlation([np.zeros(50)], [np.ones(50)], 5).p_value)


def test_pieces_shorter_than_a_lag_count_for_the_lags_that_they_have() -> None:
    x = np.random.default_rng(6).normal(size=100)
    found = ljung_box([x, np.array([1.0, -1.0]), np.array([0.5])], 10)
    power, rows, lag = x @ x + 2.25, 103, np.arange(1, 11)
    r = np.array([x[k:] @ x[:-k] - (k == 1) for k in lag]) / power
    assert found.statistic == pytest.approx(rows * (rows + 2) * np.sum(r**2 / (rows - lag)))


def test_cumulated_periodogram_is_true_to_its_size_and_sees_colour():
    """2000 white series at 5 %: 3.5 to 6.5 % is three standard deviations."""
    rng = np.random.default_rng(8)
    white = [cumulated_periodogram(rng.standard_normal(101)).p_value for _ in range(2000)]
    assert 0.035 < np.mean(np.array(white) < 0.05) < 0.065
    coloured = lfilter([1.0], [1.0, -0.5], rng.standard_normal(200))
    assert cumulated_periodogram(coloured).p_value < 1e-3


def test_cumulated_periodogram_by_hand():
    """Powers 1, 0, 0 at three frequencies: the sums stand at 1 where a line is at 1/2."""
    wave = np.cos(2 * np.pi * np.arange(7) / 7)
    found = cumulated_periodogram(wave)
    assert found.frequencies == 2
    assert found.distance == pytest.approx(1.0 * (1 + 0.12 / 2**0.5 + 0.11 / 2))
    assert np.isnan(cumulated_periodogram(np.zeros(9)).distance)


def test_correlation_function_is_the_sum_that_defines_it() -> None:
    rng = np.random.default_rng()
    pieces = [rng.standard_normal(40), rng.standard_normal(25)]
    others = [rng.standard_normal(40), rng.standard_normal(25)]
    found, _ = correlation_function(pieces, others, 6)
    power = np.sqrt(sum(a @ a for a in pieces) * sum(b @ b for b in others))
    for lag in range(-6, 7):
        products = sum(
            a[t] * b[t - lag]
            for a, b in zip(pieces, others, strict=True)
            for t in range(len(a))
            if 0 <= t - lag < len(b)
        )
        assert found[6 + lag] == pytest.approx(products / power, abs=1e-12)


def test_bound_of_a_correlation_holds_for_signals_that_are_slow_themselves() -> None:
    """Two independent AR(1) signals: 95 % of their correlations at lag 0 are within the bound."""
    rng = np.random.default_rng()
    inside = 0
    for _ in range(400):
        a, b = (lfilter([1.0], [1.0, -0.9], rng.standard_normal(1000)) for _ in range(2))
        found, deviation = correlation_function([a - a.mean()], [b - b.mean()], 60)
        inside += abs(found[60]) < 1.96 * deviation
    # White signals' bound would hold about half of them; 400 draws are sure to 2 %.
    assert 0.88 < inside / 400 < 1.0


def test_a_signal_that_does_not_vary_has_no_correlation() -> None:
    found, deviation = correlation_function([np.zeros(9)], [np.arange(9.0) - 4], 2)
    assert np.isnan(found).all()
    assert np.isnan(deviation)
