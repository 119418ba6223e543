"""The alarm of a log that begins warm where rest was expected: its start is no contradiction."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt

PERIOD, NOISE = 20.0, 0.02
LAGS, RISES = np.array([300.0, 900.0, 2500.0]), np.array([5.0, 4.0, 3.0])
SENSORS = ["T_a_degC", "T_b_degC", "T_c_degC"]


def log(heat, generator, loss=0.0):
    """Three lags in air of 20 degC; `loss` adds to each rate [1/s]."""
    rates = 1 / LAGS + loss
    stays, last = np.exp(-rates * PERIOD), RISES / LAGS / rates
    rise = np.zeros((len(heat), len(LAGS)))
    for k, q in enumerate(heat[:-1]):
        rise[k + 1] = stays * rise[k] + (1 - stays) * last * q
    read = 20.0 + rise + NOISE * generator.normal(size=rise.shape)
    table = pd.DataFrame({"time_s": PERIOD * np.arange(len(heat)), "Q_main_1": heat})
    return table.assign(**dict(zip(SENSORS, read.T, strict=True)))


@pytest.fixture(scope="module")
def design():
    generator = np.random.default_rng(11)
    heat = np.repeat([0.0, 1.0, 0.0, 0.6, 0.2], [20, 180, 120, 100, 80])
    fit = tt.calibrate(log(heat, generator), ["Q_main_1"], sensors=SENSORS, initial="rest",
                       kinds=dict.fromkeys(SENSORS, "rational1"), linear=True, starts=1,
                       warn=str)  # fmt: skip
    return tt.regularize(fit, tt.noise(log(0 * heat, generator), warn=str), form="kalman", warn=str)


def alarm(design, how, loss=0.0):
    """Of a log whose machine has stood warm before its first row."""
    heat = np.repeat([0.8, 0.8, 0.1, 0.9], [150, 40, 100, 60])
    whole = log(heat, np.random.default_rng(12), loss).drop(columns="Q_main_1")
    found = tt.estimate(design, whole.iloc[150:], warn=str, **how).found
    assert found.not_at_rest
    return found.alarm.word


@pytest.mark.parametrize("how", [{"smooth": True}, {"bands": True}, {"lag": 60.0, "bands": True}])
def test_a_warm_start_is_no_alarm(design, how):
    assert alarm(design, how) == "quiet"


def test_a_warm_machine_that_loses_more_heat_has_one(design):
    assert alarm(design, {"smooth": True}, loss=0.5 / LAGS[-1]) == "parted"
