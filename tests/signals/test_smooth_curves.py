import numpy as np
import pytest

from thermaltool.signals.smooth_curves import curve_draws

TIME = np.arange(0.0, 14400.0, 30.0)


def warm_up(rng):
    """Two time constants, of which one is fast: no one smoothness fits in plain time."""
    fast, slow = rng.uniform(-10, 10, 2)
    return fast * -np.expm1(-TIME / 300) + slow * -np.expm1(-TIME / 5000)


@pytest.mark.parametrize("drift", [0.0, 0.1])
def test_curves_vary_as_they_miss_the_truth(drift):
    rng = np.random.default_rng(1)
    inside, errors = [], []
    for _ in range(6):
        true, noise = warm_up(rng), 0.05 * rng.standard_normal(len(TIME))
        keeps, state = np.exp(-30.0 / 1500), drift * rng.standard_normal()
        for k in range(len(TIME)):
            noise[k] += state
            state = keeps * state + drift * np.sqrt(1 - keeps**2) * rng.standard_normal()
        found = curve_draws(
            TIME, true + noise, np.ones(len(TIME)), 0.05, [(drift, 1500.0)], 300, rng
        )
        low, high = np.quantile(found, [0.025, 0.975], axis=0)
        inside.append(np.mean((low <= true) & (true <= high)))
        errors.append(np.sqrt(np.mean((found.mean(axis=0) - true) ** 2)))
    assert 0.85 <= np.mean(inside) <= 1.0, inside
    # Without drift most of the noise is gone; a drift is of the kind of the signal.
    assert np.mean(errors) < (0.8 * drift if drift else 0.015)


def test_readings_that_are_missing_are_bridged():
    rng = np.random.default_rng(2)
    true = warm_up(rng)
    counts = np.ones(len(TIME))
    counts[200:300] = 0.0
    values = true + 0.05 * rng.standard_normal(len(TIME))
    values[200:300] = 99.0
    found = curve_draws(TIME, values, counts, 0.05, (), 200, rng)
    assert np.abs(found.mean(axis=0) - true).max() < 0.2
    assert found[:, 250].std() > 1.5 * found[:, 100].std()


def test_without_noise_curves_are_the_values():
    rng = np.random.default_rng(3)
    step = 10.0 * (TIME > 60)
    for values in (step, np.full(len(TIME), 3.0)):
        found = curve_draws(TIME, values, np.ones(len(TIME)), 0.0, (), 20, rng)
        np.testing.assert_allclose(found, np.tile(values, (20, 1)), atol=1e-3)
    short = curve_draws(TIME[:2], step[:2], np.ones(2), 0.1, (), 20, rng)
    assert short.shape == (20, 2)
