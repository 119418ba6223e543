"""Sensor noise and heat inputs: their statistics, and that a seed repeats them."""

import numpy as np
import pytest

from thermaltool.plants.excitation import INPUTS, duty, hold, sample_times, step, triangle
from thermaltool.plants.noise import Sensor, ornstein_uhlenbeck, read_sensors

SENSORS = {"K": Sensor(0.02, 0.008), "um": Sensor(0.2, decimals=2)}
TRUTH = {"dT_pair1_K": np.zeros(5000), "dT_pair2_K": np.ones(5000), "d_x_um": np.zeros(5000)}


def test_a_seed_repeats_the_readings_and_another_does_not():
    first, again, other = (read_sensors(TRUTH, SENSORS, 0.5, seed) for seed in (3, 3, 4))
    for name in TRUTH:
        np.testing.assert_array_equal(first[name], again[name])
        assert np.mean(first[name] == other[name]) < 0.2


def test_a_shorter_log_begins_the_longer_one():
    short = {name: values[:700] for name, values in TRUTH.items()}
    readings, longer = (read_sensors(truth, SENSORS, 0.5, 3) for truth in (short, TRUTH))
    for name in TRUTH:
        np.testing.assert_array_equal(readings[name], longer[name][:700])


def test_channels_are_independent_and_know_nothing_of_each_other():
    readings = read_sensors(TRUTH, SENSORS, 0.5, 3)
    alone = read_sensors({"d_x_um": TRUTH["d_x_um"]}, SENSORS, 0.5, 3)
    np.testing.assert_array_equal(alone["d_x_um"], readings["d_x_um"])
    white = [np.diff(readings[name]) for name in TRUTH]
    correlation = np.corrcoef(white) - np.eye(3)
    assert np.abs(correlation).max() < 5 / np.sqrt(5000)


def test_white_part_has_its_deviation_and_the_converter_its_steps():
    n = 20000
    reading = Sensor(0.02).read(np.zeros(n), 0.5, np.random.default_rng(0))
    expected = np.hypot(0.02, 0.001 / np.sqrt(12))
    assert reading.std() == pytest.approx(expected, rel=5 / np.sqrt(2 * n))
    np.testing.assert_array_equal(reading, np.round(reading, 3))


def test_channels_without_a_sensor_are_exact():
    truth = {"T_air_degC": np.array([20.123456])}
    assert read_sensors(truth, SENSORS, 0.5, 1)["T_air_degC"][0] == 20.123456


def test_drift_is_stationary_with_exponential_autocovariance():
    # Many short paths: ensemble moments at the first sample and one time constant later.
    generator, paths = np.random.default_rng(0), 20000
    ends = np.array(
        [ornstein_uhlenbeck(11, 90.0, 2.0, 900.0, generator)[[0, -1]] for _ in range(paths)]
    )
    covariance = np.cov(ends.T)
    tolerance = 5 * 4.0 * np.sqrt(2 / paths)
    expected = 4.0 * np.array([[1.0, np.exp(-1)], [np.exp(-1), 1.0]])
    np.testing.assert_allclose(covariance, expected, atol=tolerance)


def test_shapes():
    time = sample_times(800.0, 0.1) - 50.0
    assert np.all(INPUTS["idle"](time, 1) == 0.0)
    np.testing.assert_array_equal(step(time, 1), time >= 0.0)
    at = np.array([-10.0, 0.0, 150.0, 300.0, 450.0, 600.0, 700.0])
    np.testing.assert_allclose(triangle(at, 1), [0.0, 0.0, 0.5, 1.0, 0.5, 0.0, 0.0])


def test_duty_is_seeded_and_within_range():
    time = sample_times(9000.0, 0.5) - 60.0
    heat = duty(time, 5)
    np.testing.assert_array_equal(heat, duty(time, 5))
    assert np.any(heat != duty(time, 6))
    assert np.all(heat[time < 0.0] == 0.0)
    levels = np.unique(heat)
    assert levels[0] == 0.0
    assert levels.size > 3
    assert np.all((levels[1:] >= 0.2) & (levels[1:] <= 1.0))


def test_hold_keeps_each_value_until_the_next():
    held = hold(
        np.array([0.0, 1.0, 1.9, 2.0, 9.0]), np.array([1.0, 2.0]), np.array([5.0, 7.0]), 3.0
    )
    np.testing.assert_array_equal(held, [3.0, 5.0, 5.0, 7.0, 7.0])


def test_times_carry_no_rounding_noise():
    assert sample_times(1.0, 0.1).tolist() == [
        0.0,
        0.1,
        0.2,
        0.3,
        0.4,
        0.5,
        0.6,
        0.7,
        0.8,
        0.9,
        1.0,
    ]
