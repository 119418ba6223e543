"""Sensors that answer in other ratios than the model's: the score test and its limit."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from thermaltool.estimation.bands import MIN_GAIN_ERROR, SIGNAL_SHARE, gain_errors, model_errors
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.gain_test import FIRST_SILENCE, chi_squared_limit
from thermaltool.estimation.innovation_test import WALK_FACTOR, InnovationTest, record_alarm
from thermaltool.responses.modes import Modes
from thermaltool.responses.sample_clock import CLOCK_STEP

DT = 10.0
ERRORS = [0.003, 0.004, 0.005]


def lag(time_constant, gain=1.0):
    return Modes(np.array([-1 / time_constant + 0j]), np.array([gain / time_constant + 0j]))


def estimator():
    terms = (lag(60.0, 3.0), lag(200.0, 2.0), lag(600.0, 1.0))
    return KalmanEstimator(
        ("dT_a_K", "dT_b_K", "dT_c_K"),
        ("Q_main_W",),
        (),
        tuple((k, 0, each) for k, each in enumerate(terms)),
        (),
        (0.02,),
        (SensorNoise(0.02, 0.005, 600.0),) * 3,
    )


def readings(generator, gains=(1.0, 1.0, 1.0), rows=600):
    """Of the very state space of the test's filter, the sensors with gains of their own."""
    kalman = estimator()
    space = kalman.state_space(DT)
    process = np.sqrt(np.diag(space.Q))
    process[kalman.modal] *= WALK_FACTOR
    x, out = np.zeros(len(process)), []
    for _ in range(rows):
        heat = space.H[:, : kalman.modal] @ x[: kalman.modal]
        slow = space.H[:, kalman.modal + 1 :] @ x[kalman.modal + 1 :]
        out.append(np.array(gains) * heat + slow + 0.02 * generator.normal(size=3))
        x = space.F @ x + process * generator.normal(size=len(x))
    return np.array(out)


def run_through(y, errors=ERRORS):
    test = InnovationTest(estimator(), DT, [0.0] * 3, errors)
    test.start(y[0])
    values = []
    for row in y[1:]:
        test.step(round(DT / CLOCK_STEP), row)
        values.append(test._gains.value)
    return test, np.array(values)


def test_the_limit_is_that_of_chi_squared():
    for freedom in (1, 2, 3, 7):
        for above in (1e-2, 8e-4):
            exact = chi2.isf(above, freedom)
            assert chi_squared_limit(freedom, above) == pytest.approx(exact, rel=0.06)


@pytest.mark.slow
def test_gains_as_far_off_as_the_calibration_leaves_them_are_chi_squared():
    generator, last = np.random.default_rng(11), []
    for _ in range(60):
        gains = 1 + np.array(ERRORS) * generator.normal(size=3)
        test, values = run_through(readings(generator, gains, 400))
        assert not values[: round(FIRST_SILENCE / DT) - 1].any()
        last.append(values[-1])
    assert test._gains.limit > max(last)
    # Two degrees of freedom: sensors less drives.
    assert np.mean(last) == pytest.approx(2.0, abs=4 * 2 / np.sqrt(60))
    assert np.mean(np.array(last) > chi2.isf(0.2, 2)) == pytest.approx(0.2, abs=0.16)


def test_a_machine_that_idles_answers_in_no_ratio():
    """Sensors near the source, of which a heat that may change fast takes up the noise."""
    sensed = tuple((k, 0, lag(time, 3.0 - k)) for k, time in enumerate((3.0, 10.0, 30.0)))
    kalman, dt, generator = (
        replace(estimator(), sensed=sensed, walk=(1.0,)),
        2.0,
        np.random.default_rng(14),
    )
    stays, slow = np.exp(-dt / 600.0), 0.005 * generator.normal(size=3)
    idle = np.empty((3600, 3))
    for row in idle:
        row[:] = slow + 0.02 * generator.normal(size=3)
        slow = stays * slow + 0.005 * np.sqrt(1 - stays**2) * generator.normal(size=3)
    test = InnovationTest(kalman, dt, [0.0] * 3, ERRORS)
    assert record_alarm(test, dt * np.arange(3600), idle).row is None


def test_a_ratio_that_has_changed_is_an_alarm_that_says_which():
    generator = np.random.default_rng(12)
    y = readings(generator, (1.0, 1.0, 1.05), 600)
    test = InnovationTest(estimator(), DT, [0.0] * 3, ERRORS)
    row = record_alarm(test, DT * np.arange(600), y).row
    assert row is not None
    assert test.reason.startswith("the sensors' ratios differ from the model's (dT_a_K -")
    assert "dT_c_K +" in test.reason
    gains = run_through(y)[0]._gains.gains()
    assert gains[2] - gains[:2].mean() == pytest.approx(0.05, abs=0.01)
    # What all sensors have in common is another heat.
    common = readings(np.random.default_rng(12), (1.2, 1.2, 1.2), 600)
    test = InnovationTest(estimator(), DT, [0.0] * 3, ERRORS)
    assert record_alarm(test, DT * np.arange(600), common).row is None


def test_it_goes_on_after_a_restart():
    y = readings(np.random.default_rng(13), (1.0, 1.0, 1.02), 400)
    whole, _ = run_through(y)
    test = InnovationTest(estimator(), DT, [0.0] * 3, ERRORS)
    test.start(y[0])
    for k, row in enumerate(y[1:]):
        test.step(round(DT / CLOCK_STEP), row)
        if k == 205:
            kept = json.loads(json.dumps(test.state()))
            test = InnovationTest(estimator(), DT, [0.0] * 3, ERRORS)
            test.resume(kept)
    assert test.state() == whole.state()
    with pytest.raises(ValueError, match="not a state of this test"):
        InnovationTest(estimator(), DT, [0.0] * 3).resume(kept)
    kept[-1][0] = [[1.0]]
    with pytest.raises(ValueError, match="not a state of this test"):
        test.resume(kept)


def test_a_sensor_of_which_nothing_was_left_counts_as_the_others():
    channels = ("dT_a_K", "dT_b_K", "dT_c_K")
    fits = ({"rmse": 0.05, "noise": 0.03}, {"rmse": 0.02, "noise": 0.02}, {})
    outputs = [
        SimpleNamespace(channel=name, fit=fit, range=(0.0, 10.0))
        for name, fit in zip(channels, fits, strict=True)
    ]
    model, kalman = SimpleNamespace(outputs=outputs), SimpleNamespace(sensors=channels)
    own = 0.04 / (SIGNAL_SHARE * 10.0)
    assert gain_errors(model, kalman) == pytest.approx([own, *(own / np.sqrt(3),) * 2])
    assert model_errors(model, kalman) == pytest.approx([0.04, *(0.04 / np.sqrt(3),) * 2])
    for each in outputs:
        each.fit = {}
    assert gain_errors(model, kalman) == [MIN_GAIN_ERROR] * 3
