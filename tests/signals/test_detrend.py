import numpy as np
import pytest
from scipy.signal import savgol_filter

from thermaltool.signals.detrend import (
    cutoff_per_sample,
    difference_sigma,
    find_outliers,
    longest_level_stretch,
    separate,
)
from thermaltool.signals.resolution import resolution_step


def test_difference_sigma_ignores_signal_steps_and_spikes(warm_up):
    t = np.arange(5000.0)
    y = 0.02 * np.random.default_rng(1).standard_normal(5000) + warm_up(t, 500.0)
    y[3000:] += 2.0
    y[[100, 200]] += 5.0
    assert difference_sigma(y) == pytest.approx(0.02, rel=0.05)


def test_separation_leaves_the_noise_and_no_step(warm_up):
    t = np.arange(3000.0)
    noise = 0.02 * np.random.default_rng(2).standard_normal(3000)
    y = warm_up(t, 500.0) + noise
    y[2000:] += 3.0
    part = separate(y, 33)
    kept = np.isfinite(part.residual)
    assert kept.mean() > 0.9
    assert not kept[1990:2010].any()
    # A local cubic in 33 points takes 7 % of the white variance with it.
    assert part.residual[kept].std() == pytest.approx(0.02 * np.sqrt(0.93), rel=0.05)
    np.testing.assert_allclose((part.slow + part.residual)[kept], y[kept])


@pytest.mark.parametrize("window", [5, 7, 33])
def test_a_cubic_is_slow_to_its_ends(window):
    time = np.linspace(-1.0, 1.0, 101)
    cubic = 1e6 + 3 * time - 2 * time**2 + 5 * time**3
    np.testing.assert_allclose(separate(cubic, window).slow, cubic, rtol=0, atol=1e-8)
    noisy = cubic + np.random.default_rng(window).standard_normal(101)
    expected = savgol_filter(noisy, window, 3)
    np.testing.assert_allclose(separate(noisy, window).slow, expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("window", [1, 3, 4, 8])
def test_a_window_that_holds_no_cubic_is_refused(window):
    with pytest.raises(ValueError, match="odd window of 5"):
        separate(np.arange(20.0), window)


def test_cutoff_is_where_half_the_power_is_lost():
    f = cutoff_per_sample(33)
    t = np.arange(2000.0)
    slow = separate(np.sin(2 * np.pi * f * t), 33).slow[100:-100]
    assert np.sqrt(2.0) * slow.std() == pytest.approx(np.sqrt(0.5), abs=0.03)


def test_outliers_are_spikes_and_not_steps():
    y = 0.02 * np.random.default_rng(3).standard_normal(2000)
    y[1000:] += 4.0
    assert not find_outliers(y, 0.02).any()
    y[[300, 1500]] += [0.4, -0.4]
    assert np.flatnonzero(find_outliers(y, 0.02)).tolist() == [300, 1500]


def test_longest_level_stretch():
    y = np.concatenate((np.zeros(400), np.linspace(0.0, 50.0, 300), np.full(900, 50.0)))
    stretch = longest_level_stretch(y, 0.5, 33)
    assert stretch.start > 690
    assert stretch.stop == 1600
    assert longest_level_stretch(np.zeros(500), 0.5, 33) == slice(0, 500)


@pytest.mark.parametrize("step", [0.1, 0.244, 1.0, 0.0625, 1e-4])
def test_resolution_of_rounded_readings(step):
    y = 25.0 + np.random.default_rng(4).standard_normal(3000)
    assert resolution_step(np.round(y / step) * step) == pytest.approx(step, rel=1e-6)
    single = (np.round(y / step) * step).astype(np.float32).astype(float)
    assert resolution_step(single) == pytest.approx(step, rel=1e-3)


def test_resolution_with_codes_missing_and_without_any():
    assert resolution_step([0.0, 0.4, 1.0, 0.4]) == pytest.approx(0.2)
    assert resolution_step(np.random.default_rng(5).standard_normal(3000)) is None
    assert resolution_step(np.ones(10)) is None
    assert resolution_step([np.nan, np.nan]) is None
