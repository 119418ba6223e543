"""Direct forecasts of what can be forecast exactly, and of what theory bounds."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.timeseries.recursive.direct import DirectForecast


def errors_of(model, x):
    """Errors of the forecasts, None where there was none."""
    forecasts = []
    for value in x:
        model.update(float(value))
        forecasts.append(model.ahead(model.horizon))
    h = model.horizon
    return [None if f is None else y - f for f, y in zip(forecasts[:-h], x[h:], strict=True)]


def test_sums_of_sinusoids_are_forecast_whole():
    t = np.arange(4000)
    x = 3 + np.sin(0.05 * t) + 0.5 * np.sin(0.21 * t + 1)
    errors = np.abs(errors_of(DirectForecast(9, lags=6), x)[500:])
    # the start's weight fades with the forgetting
    assert np.max(errors[-500:]) < 1e-3
    assert np.max(errors[-500:]) < 0.2 * np.max(errors[:500])


def test_what_turns_with_the_spindle_is_forecast_where_lags_cannot():
    """Harmonics in noise: the lags see too much of it, the angle none."""
    turn = 2 * math.pi / 200
    t = np.arange(12000)
    rng = np.random.default_rng(1)
    x = 5 + np.cos(2 * turn * t + 1) + 0.7 * np.cos(3 * turn * t) + 0.3 * rng.standard_normal(12000)
    left = [
        np.std(errors_of(DirectForecast(9, harmonics=k, turn=turn, forgetting=0.9995), x)[6000:])
        for k in (0, 4)
    ]
    # the least: what the noise of two samples and of their mean leaves, 0.3 to 0.3 √2
    assert left[1] < 0.4
    assert left[0] > 1.1 * left[1]


def test_a_first_order_process_is_forecast_as_well_as_it_can_be():
    rng = np.random.default_rng(2)
    a = rng.standard_normal(30000)
    x = lfilter([1], [1, -0.97], a)
    errors = errors_of(DirectForecast(5, lags=5, forgetting=0.9998), x)[10000:]
    least = math.sqrt(sum(0.97 ** (2 * k) for k in range(5)))
    # only differences enter: the last value is forecast with weight 1 instead of 0.97^5
    persistence = math.sqrt(2 * (1 - 0.97**5) / (1 - 0.97**2))
    assert 0.97 * least < np.std(errors) < 1.02 * persistence


def test_a_constant_is_forecast_exactly_from_the_first_forecast_on():
    errors = errors_of(DirectForecast(4, harmonics=2, turn=0.1), np.full(500, 7.0))
    assert all(error in (None, 0.0) for error in errors)


def test_nothing_is_said_before_enough_is_learnt():
    model = DirectForecast(5, lags=3)
    rng = np.random.default_rng(3)
    said = []
    for value in rng.standard_normal(100):
        model.update(float(value))
        said.append(model.ahead(5) is not None)
    assert not any(said[:30])
    assert all(said[60:])


def test_missing_samples_and_gaps_teach_nothing():
    model = DirectForecast(5, lags=3)
    x = np.sin(0.1 * np.arange(500))
    errors_of(model, x)
    theta = list(model.theta)
    model.miss()
    model.update(math.nan)
    model.update(1e300)
    assert model.ahead(5) is not None
    assert model.theta == theta
    model.forget_lags()
    assert model.ahead(5) is None
    assert model.theta == theta


def test_constant_and_huge_input_stay_finite():
    rng = np.random.default_rng(4)
    model = DirectForecast(5, lags=3, harmonics=3, turn=0.05, forgetting=0.98)
    x = np.concatenate(
        [rng.standard_normal(500), np.full(20000, 3.0), 1e50 * rng.standard_normal(500)]
    )
    for value in x:
        model.update(float(value))
        ahead = model.ahead(5)
        assert ahead is None or math.isfinite(ahead)


@pytest.mark.parametrize(
    "wrong", [{"horizon": 0}, {"lags": -1}, {"lags": 0}, {"spacing": -1}, {"harmonics": -1}]
)
def test_what_cannot_be(wrong):
    with pytest.raises(ValueError, match=r"horizon|nothing to forecast from"):
        DirectForecast(**{"horizon": 3, **wrong})
    with pytest.raises(ValueError, match="forecasts 3 steps"):
        DirectForecast(3).ahead(4)
