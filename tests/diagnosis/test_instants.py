"""The instant from which a drive is weaker, where it is off for long beside that."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.experiments import _recurs
from thermaltool.effects import effect_class
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

HEAT, BEND, DT, TAU, GAIN, NOISE = "Q_main_W", "d_z_um", 20.0, 900.0, 0.4, 0.02
TIME = DT * np.arange(900)


def weakened(begins=0.0, gain=0.8):
    """A model, and a log in which the drive is weaker from 9400 s on, after a standstill."""
    heat = np.select([TIME < 2000, TIME < 5500, TIME < 9300, TIME < 14000], [60, 90, 0, 80], 40)
    acting = heat * np.where(TIME >= 9400, gain, 1.0)
    bend, kept = np.zeros(len(TIME)), np.exp(-DT / TAU)
    for k in range(1, len(TIME)):
        bend[k] = kept * bend[k - 1] + GAIN * (1 - kept) * acting[k - 1]
    bend += NOISE * np.random.default_rng(20261125).standard_normal(len(TIME))
    output = Output(BEND, "deflection", 0.0, (0.0, 40.0), {"rmse": NOISE})
    term = Term(HEAT, BEND, Rational1(GAIN, TAU))
    model = Model((Drive(HEAT, "zero", 0.0, (0.0, 100.0)),), (output,), (term,), DT)
    return model, Record(begins + TIME, {HEAT: heat.astype(float), BEND: bend}, digest="log")


@pytest.mark.slow
def test_an_instant_behind_a_standstill():
    # While the drive is off, all instants are as good as one another.
    model, log = weakened()
    found = diagnose(model, [log])
    assert [cause.effect.name for cause in found.causes] == ["drive_gain_step"]
    parameters = found.causes[0].effect.parameters
    assert parameters["gain"] == pytest.approx(0.8, abs=0.005)
    assert parameters["time"] == pytest.approx(9400.0, abs=DT)


@pytest.mark.slow
def test_instants_are_told_from_the_first_row_where_the_clock_counts_from_1970():
    model, log = weakened(begins=1.772e9)
    frame = pd.DataFrame({"time_s": log.time, **log.columns})
    found = tt.diagnose(model, frame)
    (cause,) = found.document()["causes"]
    # The file keeps the time of the clock, which `simulate` goes by.
    assert cause["parameters"]["time"]["value"] == pytest.approx(1.772e9 + 9400.0, abs=DT)
    assert "from 157 min into the log it acts" in cause["action"]
    worst = found.document()["residuals"][BEND]["worst"]
    assert 9400.0 <= worst["start"] < worst["stop"] <= TIME[-1]
    assert re.search(r"\btime 9(39|40)\d s", found.table())
    assert re.search(r"worst from 2\.\d+ to \d\.\d+ h", found.table())


@pytest.mark.slow
@pytest.mark.parametrize("begins", [0.0, 1.772e9])
@pytest.mark.parametrize("since", [0.0, 7200.0])
def test_a_drift_is_told_from_the_instant_at_which_it_begins(begins, since):
    model, log = weakened(begins, gain=1.0)
    creeps = 0.5 * np.maximum(TIME - since, 0.0) / 3600.0
    found = diagnose(model, [log.with_columns({BEND: log.columns[BEND] + creeps})])
    (cause,) = found.causes
    assert cause.effect.name == "sensor_drift"
    low, high = cause.intervals["rate"]
    assert low < 0.5 < high
    assert high - low < 0.1
    assert ("start" in cause.effect.parameters) == (since > 0)
    if since:
        low, high = cause.intervals["start"]
        assert low < begins + since < high


def test_a_drift_that_began_in_one_log_does_not_begin_in_another():
    drift = effect_class("sensor_drift")
    assert _recurs(drift(BEND, {"rate": 1.0}, "log"))
    assert not _recurs(drift(BEND, {"rate": 1.0, "start": 7200.0}, "log"))
