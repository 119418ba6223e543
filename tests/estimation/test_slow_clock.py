"""The alarm of a machine that is read every ten minutes: few rows are half an hour."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.innovation_test import InnovationTest, record_alarm
from thermaltool.responses.modes import Modes

LAGS, GAINS, ROWS = (900.0, 4000.0, 12000.0), (3.0, 2.0, 1.5), 150
DRIFT, DRIFT_TIME = 0.4, 9000.0


def readings(period, noise, generator, loss=0.0):
    """Three lags under a heat that steps and stays, from rest; `loss` adds to each rate [1/s]."""
    found = np.zeros((ROWS, len(LAGS)))
    temperatures = np.zeros(len(LAGS))
    rates = 1 / np.array(LAGS) + loss
    stays = np.exp(-rates * period)
    last = np.array(GAINS) / np.array(LAGS) / rates
    drift = DRIFT * noise * generator.normal(size=len(LAGS))
    keeps = np.exp(-period / DRIFT_TIME)
    heat, until = 0.0, 3
    for k in range(ROWS):
        found[k] = temperatures + drift + noise * generator.normal(size=len(LAGS))
        if k == until:
            heat, until = generator.uniform() * (generator.uniform() < 0.75), k + 4
            until += int(generator.integers(10))
        temperatures = stays * temperatures + (1 - stays) * last * heat
        drift = keeps * drift + DRIFT * noise * np.sqrt(1 - keeps**2) * generator.normal(size=3)
    return found


def alarms(period, noise, loss=0.0):
    """Words of ten logs."""
    terms = tuple(
        (k, 0, Modes(np.array([-1 / lag + 0j]), np.array([gain / lag + 0j])))
        for k, (lag, gain) in enumerate(zip(LAGS, GAINS, strict=True))
    )
    kalman = KalmanEstimator(
        ("dT_a_K", "dT_b_K", "dT_c_K"), ("Q_main_W",), (), terms, (),
        (0.005,), (SensorNoise(noise, DRIFT * noise, DRIFT_TIME),) * 3,
    )  # fmt: skip
    words = []
    for seed in range(10):
        read = readings(period, noise, np.random.default_rng(seed), loss)
        test = InnovationTest(kalman, period, [noise / 4] * 3, [0.01] * 3)
        words.append(record_alarm(test, period * np.arange(ROWS), read).word)
    return words


@pytest.mark.parametrize("noise", [0.02, 0.2])
@pytest.mark.parametrize("period", [300.0, 600.0])
def test_a_sound_machine_has_no_alarm(period, noise):
    assert alarms(period, noise) == ["quiet"] * 10


def test_a_machine_that_loses_more_heat_has_one():
    assert alarms(600.0, 0.02, loss=0.5 / LAGS[-1]).count("parted") >= 9
