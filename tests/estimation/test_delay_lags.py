"""Estimators of responses with a dead time: lags that come near it."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.errors import ModelError
from thermaltool.estimation.delay_lags import LARGEST_ERROR, SMALL_ERROR, with_lags
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.estimator import SensorNoise
from thermaltool.estimation.smoother import smooth
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.rational import rational_by_name

DT, ROWS, WHITE = 2.0, 600, 0.02
SLOW = {"K1": 5.0, "tau1": 876.0, "K2": 1.0, "tau2": 238.0, "K3": -0.6, "tau3": 53.0}


def problem(**values):
    response = rational_by_name("rational3")(**SLOW | values)
    model = Model(
        (Drive("Q_a_W", "zero", 0.0, (0.0, 1.0)),),
        (Output("dT_a_K", "sensor", 0.0, (0.0, 6.0)),),
        (Term("Q_a_W", "dT_a_K", response),),
        DT,
    )
    return response, DesignModel.of(model, {"dT_a_K": SensorNoise(WHITE)}, DT)


@pytest.mark.parametrize("delay", [0.7, 4.75, 40.0])
def test_steps_are_followed_as_near_as_is_told(delay):
    modes = rational_by_name("rational3")(**SLOW, delay=delay).modes(DT)
    found, error = with_lags(modes)
    t = np.concatenate([np.linspace(0.0, 5 * delay, 997), np.geomspace(delay, 9e3, 500)])
    away = np.max(np.abs(found.step(t) - modes.step(t))) / modes.dc_gain()
    assert away <= 1.1 * error
    assert error <= max(SMALL_ERROR, 1e-4 * delay)
    assert found.dc_gain() == pytest.approx(modes.dc_gain(), rel=1e-9)
    assert np.all(found.poles.real < 0)


def test_a_dead_time_that_is_all_there_is_is_refused():
    one = DelayedModes(np.array([-0.2 + 0j]), np.array([0.2 + 0j]), delay=60.0)
    with pytest.raises(ModelError, match="60 s, too long beside the response"):
        with_lags(one)
    twice = DelayedModes(one.poles, one.weights, np.array([0.1]), delay=1e-3)
    with pytest.raises(ModelError, match="too long"):
        with_lags(twice)
    with pytest.raises(ModelError, match=r"Q_a_W → dT_a_K has a dead time of 900 s.*--measured"):
        problem(delay=900.0, tau1=20.0, tau2=15.0, tau3=11.0)
    assert 0 < SMALL_ERROR < LARGEST_ERROR


def test_bands_hold_behind_a_dead_time():
    response, machine = problem(delay=4.75)
    assert "dT_a_K answers Q_a_W 4.75 s late" in machine.notes[-1]
    kalman, walk = machine.kalman((0.05,)), 0.05
    generator, time = np.random.default_rng(44), DT * np.arange(ROWS)
    impulse = np.diff(response.step(time), prepend=0.0)
    inside, squares = [], []
    for _ in range(10):
        heat = walk * np.sqrt(DT) * np.cumsum(generator.normal(size=ROWS))
        clean = np.convolve(impulse, heat)[:ROWS, None]
        found = smooth(kalman, time, clean + WHITE * generator.normal(size=(ROWS, 1)), (1.0,))
        away = (found.estimates[:, 0] - heat)[20:-20] / found.sigma[20:-20, 0]
        inside.append(np.abs(away) < 1.96)
        squares.append(away**2)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)
