import numpy as np
import pytest

from thermaltool.signals.ranges import (
    REPEATS,
    constant_stretches,
    even_level,
    local_parabolas,
    noise_repeats,
    range_estimate,
)
from thermaltool.signals.smooth_curves import curve_draws


def estimate(level, noise, rng):
    """The range of a level of readings whose noise is 0.1."""
    curves = curve_draws(level.time, level.means, level.counts, 0.1, (), REPEATS, rng)
    return range_estimate(level.level, curves, noise, "um")


@pytest.mark.parametrize("half", [0, 1, 4, 10])
def test_a_parabola_is_what_it_was(half):
    x = 3.0 + 0.5 * np.arange(25.0) - 0.02 * np.arange(25.0) ** 2
    np.testing.assert_allclose(local_parabolas(x, half), x, atol=1e-12)
    both = np.stack([x, -2 * x])
    np.testing.assert_allclose(local_parabolas(both, half), both, atol=1e-12)


def test_a_rise_is_averaged_without_a_lag_on_any_clock():
    rng = np.random.default_rng(2)
    for time in (np.arange(0.0, 4000.0, 7.0), np.sort(rng.uniform(0, 4000, 900))):
        found = even_level(time, 0.01 * time, 60.0)
        np.testing.assert_allclose(found.level, 0.01 * found.time, atol=0.06)
        assert found.level[0] == pytest.approx(0.01 * time[0], abs=0.02)
        assert found.level[-1] == pytest.approx(0.01 * time[-1], abs=0.02)
    with pytest.raises(ValueError, match="fewer than two"):
        even_level(time, np.full(len(time), np.nan), 60.0)


def test_noise_alone_has_a_range_that_may_be_zero():
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 3600.0, 10.0)
    level = even_level(time, 0.1 * rng.standard_normal(len(time)), 60.0)
    noise = noise_repeats(level, 0.1, 0.0, 1.0, rng)
    found = estimate(level, noise, rng)
    assert np.ptp(level.level) > 0.1
    assert found.low == 0
    assert found.value < np.ptp(level.level)


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 0.05, 0.3, 1.0])
def test_intervals_of_ranges_within_the_noise(size):
    """Beside 0.1 of noise: a range of nothing, of half of it, and more."""
    time = np.arange(0.0, 3600.0, 10.0)
    true = size * -np.expm1(-time / 900) / 0.9817
    held = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        level = even_level(time, true + 0.1 * rng.standard_normal(len(time)), 60.0)
        noise = noise_repeats(level, 0.1, 0.0, 1.0, rng)
        found = estimate(level, noise, rng)
        held += found.low <= np.ptp(true) <= found.high
    # Of 40 draws at 0.95: fewer than 33 come once in a thousand.
    assert held >= 33


def test_windows():
    level = np.concatenate([np.zeros(50), np.arange(20.0), np.full(50, 19.0)])
    noise = np.zeros((3, len(level)))
    curves = np.tile(level, (3, 1))
    assert range_estimate(level, curves, noise, "um", 6).value == 5.0
    assert range_estimate(level, curves, noise, "um", 7).value == 6.0
    assert range_estimate(level, curves, noise, "um", 1000).value == 19.0


def test_drift_has_its_size_and_time():
    rng = np.random.default_rng(4)
    level = even_level(np.arange(0.0, 6000.0, 10.0), np.zeros(600), 10.0)
    noise = noise_repeats(level, 0.0, 0.5, 300.0, rng)
    assert noise.std() == pytest.approx(0.5, rel=0.05)
    lag = np.mean(noise[:, :-30] * noise[:, 30:]) / noise.var()
    assert lag == pytest.approx(np.exp(-1), abs=0.05)


@pytest.mark.parametrize("period", [10.0, 15.0, 29.0])
def test_noise_has_the_size_that_averaging_leaves(period):
    """Where bins and readings do not match, levels lie on lines between bins: smoother."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 32400.0, period)
    levels = [even_level(time, rng.standard_normal(len(time)), 60.0) for _ in range(20)]
    noise = noise_repeats(levels[0], 1.0, 0.0, 1.0, rng)
    found = np.std([each.level for each in levels])
    assert noise.std() == pytest.approx(found, rel=0.03)


def test_stretches_of_one_speed():
    speed = np.array([0, 0, np.nan, 0, 5, 5, 5, 5, 7, 5, 5, 5, 5], float)
    assert constant_stretches(speed, 4) == [slice(0, 4), slice(4, 8), slice(9, 13)]
