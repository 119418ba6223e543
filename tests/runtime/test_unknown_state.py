"""What a stream says of itself while its estimate is still on its way."""

import math

import numpy as np
import pytest

from thermaltool.estimation.estimator import load_estimator
from thermaltool.estimation.settling_time import settling_time
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.stepper import Stepper
from thermaltool.runtime.unknown_state import UnknownState


def lags(*taus, dt=1.0, weights=None):
    F = np.diag(np.exp(-dt / np.array(taus)))
    G = (1 - np.diag(F))[:, None]
    weights = np.ones(len(taus)) if weights is None else np.array(weights)
    return Recursion(F, G, np.zeros_like(G), weights[None, :])


@pytest.mark.parametrize("tau", [20.0, 3600.0, 1e6])
def test_a_first_order_lag_settles_in_three_time_constants(tau):
    assert settling_time(lags(tau), 1.0) == pytest.approx(math.log(20) * tau, abs=1.0)


def test_a_mode_of_little_weight_counts_little():
    weighty, light = lags(10.0, 1000.0), lags(10.0, 1000.0, weights=[1.0, 0.02])
    assert settling_time(weighty, 1.0) > 2000
    assert settling_time(light, 1.0) < 60


def test_what_never_decays_never_settles():
    growing = Recursion(np.array([[1.01]]), np.ones((1, 1)), np.zeros((1, 1)), np.ones((1, 1)))
    integrating = Recursion(np.eye(1), np.ones((1, 1)), np.zeros((1, 1)), np.ones((1, 1)))
    assert settling_time(growing, 1.0) == math.inf
    assert settling_time(integrating, 1.0) == math.inf


def test_the_estimate_of_a_warm_machine_is_right_when_its_time_is_over(model):
    estimator = load_estimator(dict(model.design))
    cold, warm = Stepper(estimator, 0.5), Stepper(estimator, 0.5)
    reading = [3.0]
    cold.start(reading)
    right = np.array(warm.start(reading, settled=True))[1:]
    wrong = [
        np.max(np.abs((np.array(cold.step(round(0.5 / CLOCK_STEP), reading))[1:] - right) / right))
        for _ in range(2 * math.ceil(cold.settling_time / 0.5))
    ]
    over = math.ceil(cold.settling_time / 0.5)
    assert max(wrong[over:]) <= 0.05
    assert max(wrong[: round(0.9 * over)][-5:]) > 0.05


def test_a_pause_costs_as_much_as_the_machine_can_do_in_it():
    state = UnknownState(math.log(20) * 100.0)
    state.blind(10.0)
    assert state.unknown == pytest.approx(1 - math.exp(-0.1))
    assert state.lasts
    state.reads(state.left)
    assert state.unknown == pytest.approx(0.05)
    state.reads(0.01)
    assert not state.lasts


def states(compensator, times, readings):
    found = []
    for time, reading in zip(times, readings, strict=True):
        fault = "" if math.isfinite(reading) else "empty"
        compensator.take(Row(float(time), [float(reading)], (fault,)))
        found.append(compensator.status)
    return found


def after(times, words, since):
    """How long the estimate has settled for, from a time on."""
    return times[words.index("ok", int(np.searchsorted(times, since)) + 2)] - since


def test_a_warm_start_settles_for_the_settling_time(compensator):
    each = compensator()
    times = 0.5 * np.arange(2 * math.ceil(each.stepper.settling_time / 0.5))
    # Below 6 K, what the calibration has seen, and away from the model's rest.
    words = states(each, times, np.full(len(times), 3.0))
    assert words[0] == "settles"
    assert after(times, words, 0.0) == pytest.approx(each.stepper.settling_time, abs=3.0)


def test_a_cold_start_does_not(compensator):
    assert set(states(compensator(), 0.5 * np.arange(200), np.zeros(200))) == {"ok"}


@pytest.mark.parametrize("readings", ["none", "bad"])
def test_nothing_read_for_long_settles(compensator, readings):
    """Whether no line came, or lines without a reading."""
    each, whole = compensator(), compensator().stepper.settling_time
    gap, beyond = 0.5 * math.ceil(0.4 * whole), 4 * whole
    times = np.arange(0.0, 100.0 + gap + beyond, 0.5)
    lost = (times > 100.0) & (times < 100.0 + gap)
    values = np.where(lost, np.nan, 0.0)
    if readings == "none":
        times, values = times[~lost], values[~lost]
    words = states(each, times, values)
    # The share that may be unknown after a pause, and how long it takes to fall to a twentieth.
    unknown = 1 - 0.05 ** ((gap - each.patience) / whole)
    expected = whole * (1 - math.log(unknown) / math.log(0.05))
    assert after(times, words, 100.0 + gap) == pytest.approx(expected, abs=5.0)


def test_a_restart_goes_on_settling(compensator):
    first, second = compensator(), compensator()
    times = 0.5 * np.arange(40)
    states(first, times, np.full(40, 3.0))
    second.resume(first.state(), 1.0)
    words = states(second, 20.0 + times, np.full(40, 3.0))
    assert set(words) == {"settles"}
