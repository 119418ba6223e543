"""Readings that are noisier in a state, or than at the calibration, whatever the model leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.diagnosis.action import action_of
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.long_logs import averaged_logs
from thermaltool.diagnosis.noisy_states import noisy_states
from thermaltool.diagnosis.state import WITHIN_CALIBRATION
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1
from thermaltool.signals.resolution import reading_sigma

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


def found(*logs: Record):
    return noisy_states(Hypothesis.of(MODEL, logs, MODEL, WITHIN_CALIBRATION))


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


def test_readings_on_another_clock_may_have_another_noise():
    for period in (2.0, 50.0):
        assert found(read(always=6.0, period=period)) == []
        assert found(read(always=20.0, period=period)) != []


def test_one_noisy_log_among_sound_ones():
    sound = [replace(read(seed=k), digest=f"sound {k}") for k in (2, 3)]
    (cause,) = found(sound[0], read(always=10.0), sound[1])
    assert cause.effect.partner is None
    assert cause.effect.parameters["loud"] == pytest.approx(10 * SIGMA, rel=0.1)


def test_noise_that_a_filter_has_slowed_is_not_louder_in_means():
    """Of a log that is averaged the noise of a reading is that of its readings."""
    time = np.arange(300000.0)
    kept, noise = np.exp(-1 / 10.0), np.random.default_rng(5).standard_normal(len(time))
    slow = lfilter([np.sqrt(1 - kept**2)], [1.0, -kept], noise)
    still = {HEAT: np.zeros(len(time)), FAN: np.zeros(len(time)), BED: 20.0 + SIGMA * slow}
    log = Record(time, still, digest="log")
    (output,) = MODEL.outputs
    quiet = reading_sigma(still[BED])
    known = replace(output, fit={"rmse": SIGMA, "noise": quiet})
    model = replace(MODEL, outputs=(known,), sample_period=1.0)
    model, ((averages,),) = averaged_logs(model, [(log,)])
    assert averages.row_readings > 5
    assert noisy_states(Hypothesis.of(model, [averages], model, WITHIN_CALIBRATION)) == []
    # Single readings that are not there are none that agree.
    gaps = np.where(np.arange(900) % 3 == 2, np.nan, 0.0)
    loud = read(always=10.0)
    with_gaps = Record(TIME, {**loud.columns, BED: loud.columns[BED] + gaps}, digest="log")
    assert found(with_gaps) != []


def test_a_state_that_the_noise_follows_says_more():
    (cause,) = found(read(with_fan=8.0))
    assert cause.effect.partner == FAN
    (cause,) = found(read(always=6.0, with_fan=3.0))
    assert cause.effect.partner == FAN


def test_a_misfit_is_no_noise():
    """What is steep is in differences of the residual, and not in the scatter of the readings."""
    log = read()
    saw = 0.5 * np.abs(np.arange(900) % 200 - 100)
    steep = {**log.columns, BED: log.columns[BED] + saw}
    assert found(Record(log.time, steep, digest="log")) == []
