"""A machine of three bodies, in Euler steps, that loses more heat than its model."""

from __future__ import annotations

import json

import numpy as np
import pytest

from thermaltool.estimation import loss_test
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.innovation_test import InnovationTest, record_alarm
from thermaltool.estimation.loss_test import loss_rate, slowest_rate
from thermaltool.responses.modes import Modes
from thermaltool.responses.sample_clock import CLOCK_STEP

DT, ROWS, WHITE, LEVEL = 10.0, 400, 0.02, 100.0
CAPACITY, LINKS, LOSSES = (
    np.array([2e3, 4e3, 8e3]),
    np.array([20.0, 15.0]),
    np.array([1.0, 4.0, 9.0]),
)
MODEL_ERROR, GAIN_ERROR = [0.005] * 3, [0.004] * 3


def matrix(losses):
    A = np.diag(-losses)
    for k, link in enumerate(LINKS):
        A[k, k] -= link
        A[k + 1, k + 1] -= link
        A[k, k + 1] += link
        A[k + 1, k] += link
    return A / CAPACITY[:, None]


def estimator():
    rates, vectors = np.linalg.eig(matrix(LOSSES))
    into = np.linalg.solve(vectors, np.array([1 / CAPACITY[0], 0.0, 0.0]))
    sensed = tuple(
        (k, 0, Modes(rates.astype(complex), (vectors[k] * into).astype(complex))) for k in range(3)
    )
    noise = (SensorNoise(WHITE),) * 3
    return KalmanEstimator(
        ("dT_a_K", "dT_b_K", "dT_c_K"), ("Q_main_W",), (), sensed, (), (3.0,), noise
    )


def readings(more, seed, rows=ROWS, substeps=4):
    generator = np.random.default_rng(seed)
    A, body, out = matrix(more * LOSSES), np.zeros(3), np.empty((rows, 3))
    heat = np.repeat(LEVEL * generator.uniform(0.0, 1.0, rows // 20 + 1), 20)
    for k in range(rows):
        out[k] = body
        for _ in range(substeps):
            change = A @ body
            change[0] += heat[k] / CAPACITY[0]
            body = body + DT / substeps * change
    return out + WHITE * generator.standard_normal(out.shape)


def alarm(y, gain_error=GAIN_ERROR):
    test = InnovationTest(estimator(), DT, MODEL_ERROR, gain_error, [LEVEL])
    return record_alarm(test, DT * np.arange(len(y)), y)


def test_a_loss_is_told_before_the_ratios_show_it(monkeypatch):
    found = [alarm(readings(1.3, seed)) for seed in range(4)]
    assert all(each.row is not None for each in found)
    assert any("loses more heat" in each.reason for each in found)
    monkeypatch.setattr(loss_test, "MIN_LIKELIER", np.inf)
    later = [alarm(readings(1.3, seed)).row or ROWS for seed in range(4)]
    assert sum(each.row or 0 for each in found) < 0.8 * sum(later)


def test_machines_that_lose_what_they_did_or_nearly_are_quiet():
    for more, seed in ((1.0, 5), (1.0, 6), (1.02, 7), (0.98, 8)):
        assert alarm(readings(more, seed, 1200)).row is None


def test_a_model_whose_gains_are_less_known_needs_a_larger_loss():
    kalman = estimator()
    rates = [loss_rate(kalman, [error] * 3) for error in (0.001, 0.004, 0.05)]
    assert rates[0] == pytest.approx(0.35 * slowest_rate(kalman.sensed))
    assert rates[2] > 2 * rates[0]
    assert loss_rate(kalman, [1.0] * 3) is None


def test_it_goes_on_after_a_restart():
    y = readings(1.3, 2)
    whole, kept = (
        InnovationTest(estimator(), DT, MODEL_ERROR, GAIN_ERROR, [LEVEL]) for _ in range(2)
    )
    whole.start(y[0], "free")
    kept.start(y[0], "free")
    for k, row in enumerate(y[1:]):
        whole.step(round(DT / CLOCK_STEP), row)
        kept.step(round(DT / CLOCK_STEP), row)
        if k in (0, 150):
            state = json.loads(json.dumps(kept.state()))
            kept = InnovationTest(estimator(), DT, MODEL_ERROR, GAIN_ERROR, [LEVEL])
            kept.resume(state)
    assert kept.state() == whole.state()
    assert whole.state()[-1]["loss"][0] > loss_test.MIN_LIKELIER
    with pytest.raises(ValueError, match="not a state of this test"):
        kept.resume([each for each in state if not isinstance(each, dict)])


def sum_of(test):
    parts = [each for each in test.state() if isinstance(each, dict) and "loss" in each]
    return parts[0]["loss"][0] if parts else 0.0


def summed(more, seed):
    test = InnovationTest(estimator(), DT, MODEL_ERROR, GAIN_ERROR, [LEVEL])
    y = readings(more, seed)
    test.start(y[0], "free")
    largest = 0.0
    for row in y[1:]:
        test.step(round(DT / CLOCK_STEP), row)
        largest = max(largest, sum_of(test))
    return test, y[-1], largest


def test_the_sum_of_a_loss_that_a_calibration_may_miss_is_no_alarm():
    _, _, largest = summed(1.1, 11)
    assert 10 < largest < 20 < loss_test.MIN_LIKELIER


def test_the_sum_forgets_over_a_pause():
    test, last, _ = summed(1.2, 11)
    before = sum_of(test)
    test.step(round(loss_test.MEMORY / CLOCK_STEP), last)
    assert sum_of(test) == pytest.approx(before / np.e)
    assert before > loss_test.MIN_LIKELIER
