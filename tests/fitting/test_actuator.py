"""Actuators that are known, found again from a log."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from thermaltool.errors import FitError
from thermaltool.fitting.actuator import identify_actuator

PERIOD = 0.5e-3


def play(x, threshold):
    out, state = [], x[0]
    for value in x:
        state = min(max(state, value - threshold), value + threshold)
        out.append(state)
    return np.array(out)


def log_of(delay, weights=(1.5,), thresholds=(0.0,), natural=np.inf, noise=0.02, drift=0.0):
    rng = np.random.default_rng(12)
    command = np.repeat(rng.uniform(0, 10, 60), 20)
    action = sum(
        w * (play(command, r) - command[0]) for w, r in zip(weights, thresholds, strict=True)
    )
    whole, part = int(delay), delay % 1
    # held: a delay within a sample mixes two
    late = [np.concatenate([np.zeros(k), action])[: len(action)] for k in (whole, whole + 1)]
    action = (1 - part) * late[0] + part * late[1]
    if np.isfinite(natural):
        system = ([natural**2], [1, 2 * 0.707 * natural, natural**2])
        b, a, _ = cont2discrete(system, PERIOD, "zoh")
        action = lfilter(b.ravel(), a, action)
    else:
        action = np.concatenate([[0.0], action[:-1]])
    reading = -7 + drift * np.arange(len(command)) + action
    return command, reading + noise * rng.standard_normal(len(command))


@pytest.mark.parametrize("natural", [np.inf, 753.0])
@pytest.mark.parametrize("delay", [0.0, 3.0, 4.6, 30.25])
def test_delay_and_gain(delay, natural):
    command, reading = log_of(delay, natural=natural, drift=0.001)
    found = identify_actuator(command, reading, PERIOD, natural)
    assert found.delay == pytest.approx(delay * PERIOD, abs=0.02 * PERIOD)
    assert found.weights == pytest.approx((1.5,), rel=2e-3)
    assert found.explained > 0.999
    assert found.residual == pytest.approx(0.02, rel=0.15)


def test_plays():
    thresholds, weights = (0.0, 1.0, 2.0, 3.0, 4.0), (1.0, 0.3, 0.0, 0.2, 0.1)
    command, reading = log_of(2.0, weights, thresholds)
    reach = np.ptp(command)
    thresholds = tuple(0.1 * reach * k for k in range(5))
    command, reading = log_of(2.0, weights, thresholds)
    found = identify_actuator(command, reading, PERIOD, plays=5)
    got = dict(zip(np.round(found.thresholds, 6), found.weights, strict=True))
    for threshold, weight in zip(thresholds, weights, strict=True):
        assert got.get(round(threshold, 6), 0.0) == pytest.approx(weight, abs=0.02)


@pytest.mark.parametrize(
    ("command", "reading", "message"),
    [
        (np.ones(100), np.arange(100.0), "does not move"),
        (np.arange(20.0), np.arange(20.0), "50 or more rows"),
        (np.full(100, np.nan), np.zeros(100), "missing values"),
        (np.repeat([0.0, 1.0, 0.0, 1.0], 100), np.zeros(400), "no answer"),
        (
            np.repeat([0.0, 1.0, 0.0, 1.0], 100),
            np.random.default_rng(5).standard_normal(400),
            "no answer",
        ),
    ],
)
def test_logs_that_do_not_tell(command, reading, message):
    with pytest.raises(FitError, match=message):
        identify_actuator(command, reading, PERIOD)


def test_a_gain_of_the_other_sign_is_no_answer():
    command, reading = log_of(2.0)
    with pytest.raises(FitError, match="no answer"):
        identify_actuator(command, -reading, PERIOD)
