"""Forecasting control on machines that are known exactly, where its answer can be worked out."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from thermaltool.control.fcc import (
    ActuatorModel,
    ActuatorState,
    ForecastingControl,
    ReadingGate,
    second_order,
)
from thermaltool.control.hysteresis import PrandtlIshlinskii

PERIOD = 0.5e-3


def gain(value):
    return PrandtlIshlinskii([0.0], [value])


class Known:
    """Forecasts a signal that it has been told."""

    def __init__(self, signal):
        self.signal, self.at, self.errors = signal, -1, []

    def update(self, error):
        self.at += 1
        self.errors.append(error)

    def miss(self):
        self.at += 1

    def forget_lags(self):
        self.errors.clear()

    def ahead(self, steps):
        return float(self.signal[self.at + steps])


class Silent(Known):
    def ahead(self, steps):
        return None


def closed_loop(model, control, signal, limit=np.inf):
    """Readings of a machine that obeys `model`, and the commands."""
    machine, acts = ActuatorState(model, PERIOD), PrandtlIshlinskii(
        model.hysteresis.thresholds, model.hysteresis.weights
    )  # fmt: skip
    command, readings, commands = 0.0, [], []
    for disturbance in signal:
        readings.append(disturbance + machine.take(acts.take(command)))
        command = float(np.clip(control.step(readings[-1], command).wanted, -limit, limit))
        commands.append(command)
    return np.array(readings), np.array(commands)


@pytest.mark.parametrize("damping", [0.3, 0.707, 1.0, 1.5])
def test_second_order_is_the_held_input_discretization(damping):
    (a, b, c, d), (e, f) = second_order(753.0, damping, PERIOD)
    system = ([753.0**2], [1.0, 2 * damping * 753.0, 753.0**2])
    numerator, denominator, _ = cont2discrete(system, PERIOD, "zoh")
    u = np.random.default_rng(1).standard_normal(60)
    expected = lfilter(numerator.ravel(), denominator, u)
    state, got = np.zeros(2), []
    for value in u:
        got.append(state[0])
        state = np.array([[a, b], [c, d]]) @ state + np.array([e, f]) * value
    np.testing.assert_allclose(got, expected, atol=1e-9)


@pytest.mark.parametrize("delay", [0.0, 1.3e-3, 2.5e-3])
def test_what_comes_ahead_is_what_comes(delay):
    state = ActuatorState(ActuatorModel(gain(1.0), delay, 753.0, 0.5), PERIOD)
    rng = np.random.default_rng(2)
    for value in rng.standard_normal(30):
        state.take(value)
    expected = state.held(0.7, state.ahead(9))
    for _ in range(9):
        state.take(0.7)
    assert state.position == pytest.approx(expected, abs=1e-12)


def test_a_known_error_is_cancelled_but_for_the_delay():
    """With the delay alone and a perfect forecast nothing is left once the action has come."""
    signal = np.random.default_rng(3).standard_normal(300)
    model = ActuatorModel(gain(1.5), 4 * PERIOD)
    control = ForecastingControl(model, Known(signal), PERIOD)
    assert control.horizon == 5
    readings, _ = closed_loop(model, control, signal[:290])
    np.testing.assert_allclose(readings[5:], 0.0, atol=1e-12)
    np.testing.assert_allclose(readings[:5], signal[:5])


def test_the_error_without_the_action_is_reconstructed():
    signal = np.sin(np.arange(400) / 9) + 3
    hysteresis = PrandtlIshlinskii([0.0, 0.5, 1.0], [1.0, 0.4, 0.2])
    model = ActuatorModel(hysteresis, 1.2e-3, 753.0)
    forecaster = Known(signal)
    control = ForecastingControl(model, forecaster, PERIOD)
    _, commands = closed_loop(model, control, signal[:380], limit=2.0)
    # also where the command stands at its limit
    assert np.ptp(commands) > 0.5
    assert commands.min() == -2.0
    np.testing.assert_allclose(forecaster.errors, signal[:380], atol=1e-9)


def test_a_constant_error_goes_whatever_the_gain_of_the_model():
    truth, signal = ActuatorModel(gain(1.0), 3 * PERIOD, 753.0), np.full(600, 5.0)
    for believed in (0.7, 1.0, 1.6):
        model = ActuatorModel(gain(believed), 3 * PERIOD, 753.0)
        control = ForecastingControl(model, Silent(signal), PERIOD)
        readings, _ = closed_loop(truth, control, signal)
        assert abs(readings[-1]) < 1e-3


def test_the_inverse_of_the_hysteresis_takes_it_out():
    signal = 4 * np.sin(np.arange(800) / 12)
    hysteresis = PrandtlIshlinskii([0.0, 0.5, 1.0, 2.0], [1.0, 0.3, 0.3, 0.2])
    truth = ActuatorModel(hysteresis, 2 * PERIOD)
    left = []
    for model in (truth, ActuatorModel(gain(1.8), 2 * PERIOD)):
        control = ForecastingControl(model, Known(signal), PERIOD)
        readings, _ = closed_loop(truth, control, signal[:780])
        left.append(readings[100:].std())
    assert left[0] < 1e-9
    assert left[1] > 0.1


def test_missing_readings_and_gaps():
    model = ActuatorModel(gain(1.0), 2 * PERIOD)
    forecaster = Silent(np.zeros(9))
    control = ForecastingControl(model, forecaster, PERIOD)
    assert control.step(2.0, 0.0).wanted == pytest.approx(-2.0)
    # the error is taken to stay
    assert control.step(None, -2.0).wanted == pytest.approx(-2.0)
    control.forget_lags(-2.0)
    assert forecaster.errors == []
    # the action of -2 has settled: a reading of 0 is an error of 2 without it
    assert control.step(0.0, -2.0) == pytest.approx((-2.0, 2.0, 2.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ActuatorModel(gain(1.0), -1.0), "delay of -1"),
        (lambda: ActuatorModel(gain(1.0), float("nan")), "delay of nan"),
        (lambda: ActuatorModel(gain(1.0), 0.0, -5.0), "low-pass"),
        (
            lambda: ForecastingControl(
                ActuatorModel(gain(1.0), 5 * PERIOD), Silent([]), PERIOD, horizon=4
            ),
            "within the delay: at least 6",
        ),
    ],
)
def test_what_cannot_be(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_gate_follows_a_new_level_and_keeps_out_a_spike():
    gate = ReadingGate()
    errors = np.random.default_rng(3).normal(0, 1, 300)
    assert all(gate.passes(e) for e in errors)
    assert not gate.passes(1e4)
    assert gate.passes(0.5)
    steps = [gate.passes(1e4 + e) for e in errors[:10]]
    assert steps == [False] * 3 + [True] * 7
    assert gate.refused == 4


@pytest.mark.parametrize("delay", [0.0, 0.0012, 0.0025])
@pytest.mark.parametrize("natural", [np.inf, 753.0])
def test_what_comes_is_what_the_samples_bring(delay, natural):
    rng = np.random.default_rng(7)
    state = ActuatorState(ActuatorModel(gain(1.0), delay, natural), PERIOD)
    for action in rng.standard_normal(20):
        state.take(action)
    for steps in (1, 4, 9, 15):
        weights, action = state.ahead(steps), float(rng.standard_normal())
        later = ActuatorState(state.model, PERIOD)
        later.position, later.rate, later.actions = state.position, state.rate, [*state.actions]
        for _ in range(steps):
            brought = later.take(action)
        assert state.held(action, weights) == pytest.approx(brought, abs=1e-12)
    horizon = state.default_horizon()
    assert state.ahead(horizon).fresh >= 0.5 > state.ahead(horizon - 1).fresh
