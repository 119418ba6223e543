"""Readings that are noisier in a state, or than at the calibration, whatever the model leaves."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.diagnosis.action import action_of
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.noisy_states import noisy_states
from thermaltool.diagnosis.state import WITHIN_CALIBRATION
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

HEAT, FAN, BED, SIGMA = "Q_main_W", "x_fan_1", "T_bed_degC", 0.05
TIME = 10.0 * np.arange(900)
MODEL = Model(
    drives=(Drive(HEAT, "zero", 0.0, (0.0, 100.0)),),
    outputs=(Output(BED, "sensor", 20.0, (0.0, 20.0), {"rmse": SIGMA, "noise": SIGMA}),),
    terms=(Term(HEAT, BED, Rational1(0.2, 500.0)),),
    sample_period=10.0,
)


def read(*, always: float = 1.0, with_fan: float = 1.0, period: float = 10.0, seed: int = 1):
    """A log whose readings have so many times the noise of the calibration, always or with a fan.

    Of a shorter period than the calibration's readings are means of fewer.
    """
    heat = 100.0 * np.repeat([0.0, 1.0, 0.0, 1.0, 1.0, 0.0], 150)
    fan = np.repeat([0.0, 1.0, 0.0], 300)
    kept, bed = np.exp(-period / 500.0), [0.0]
    for each in heat[:-1]:
        bed.append(kept * bed[-1] + (1 - kept) * 0.2 * each)
    noise = np.random.default_rng(seed).standard_normal(len(TIME))
    size = SIGMA * always * np.where(fan > 0, with_fan, 1.0)
    columns = {HEAT: heat, FAN: fan, BED: 20.0 + np.array(bed) + size * noise}
    return Record(TIME * period / 10.0, columns, digest="log")


def found(log: Record):
    return noisy_states(Hypothesis.of(MODEL, [log], MODEL, WITHIN_CALIBRATION))


def test_readings_that_are_noisier_than_at_the_calibration():
    (cause,) = found(read(always=6.0))
    assert (cause.effect.channel, cause.effect.partner) == (BED, None)
    assert cause.effect.parameters["quiet"] == pytest.approx(SIGMA)
    assert cause.effect.parameters["loud"] == pytest.approx(6 * SIGMA, rel=0.1)
    action = action_of(cause.effect, cause.severity, {BED: SIGMA})
    assert "and was 0.05 °C at the calibration" in action


@pytest.mark.parametrize("times", [0.5, 1.0, 2.5])
def test_a_little_more_noise_is_none(times):
    assert found(read(always=times)) == []


def test_readings_that_are_taken_more_often_are_means_of_fewer():
    assert found(read(always=6.0, period=2.0)) == []
    assert found(read(always=20.0, period=2.0)) != []


def test_a_state_that_the_noise_follows_says_more():
    (cause,) = found(read(with_fan=8.0))
    assert cause.effect.partner == FAN
    (cause,) = found(read(always=6.0, with_fan=3.0))
    assert cause.effect.partner == FAN


def test_a_misfit_is_no_noise():
    """Another gain is in the residual, step by step, and not in the scatter of the readings."""
    log = read()
    columns = {**log.columns, BED: log.columns[BED] + 3.0 * (log.columns[HEAT] > 0)}
    assert found(Record(log.time, columns, digest="jumps")) == []
