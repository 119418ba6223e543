"""What happened in one log, in others: it lasts, it happens again, or it is another trouble."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.diagnosis.lasting import Recurrence, recurrences
from thermaltool.effects.sensor_drift import SensorDrift
from thermaltool.effects.sensor_offset_step import SensorOffsetStep
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

TIME = 10.0 * np.arange(600)
HEAT = np.where(TIME > 500, 100.0, 0.0)
SENSOR, SIGMA = "T_frame_degC", 0.05
MODEL = Model(
    drives=(Drive("Q_motor_W", "zero", 0.0, (0.0, 100.0)),),
    outputs=(Output(SENSOR, "sensor", 20.0, (0.0, 30.0)),),
    terms=(Term("Q_motor_W", SENSOR, Rational1(0.2, 800.0)),),
    sample_period=10.0,
)
JUMP = SensorOffsetStep(SENSOR, {"step": 0.6, "time": 2000.0}, "first")


def log(change, seed=0):
    """First-order rise by the law itself; readings off by `change`."""
    rise = np.where(TIME > 500, -20.0 * np.expm1(-(TIME - 500.0) / 800.0), 0.0)
    noise = SIGMA * np.random.default_rng(seed).standard_normal(len(TIME))
    return Record(TIME, {"Q_motor_W": HEAT, SENSOR: 20.0 + rise + change + noise}, digest="other")


def found(change, effect=JUMP):
    extended = MODEL if effect is None else Model(
        MODEL.drives, MODEL.outputs, MODEL.terms, MODEL.sample_period, (effect,)
    )  # fmt: skip
    return recurrences(extended, effect, [log(change)], {SENSOR: SIGMA}, {})


@pytest.mark.parametrize("size", [0.5, 0.7])
def test_it_lasts(size):
    assert found(size) == (Recurrence("other", None),)


def test_it_happens_again():
    (again,) = found(0.6 * (TIME > 3500))
    assert again.time == pytest.approx(3500, abs=TIME[-1] / 24)


@pytest.mark.parametrize("change", [0.0, -0.6, 1.5, 0.2, 0.6 * np.sin(TIME / 300)])
def test_other_trouble_or_none(change):
    assert found(change) == ()


def test_what_has_no_instant_is_not_asked():
    drift = SensorDrift(SENSOR, {"rate": 1e-4}, "first")
    assert found(0.6, drift) == ()
