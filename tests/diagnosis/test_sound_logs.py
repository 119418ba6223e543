"""A log from before the machine has changed says nothing against what is wrong now."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.diagnosis.sound_logs import are_silent
from thermaltool.effects import effect_class
from thermaltool.record import Record

PERIOD, ROWS = 30.0, 600


def machine(seed, lag=0.0, gain=1.0, power=1.0):
    """A log of two outputs by exact steps of their lags; the thermometer answers late by `lag`.

    `gain` is the thermometer's, `power` the part of the heat that is used.
    """
    rng = np.random.default_rng(seed)
    heat = power * np.repeat(rng.choice([0.0, 60.0, 120.0, 200.0], ROWS // 20), 20)
    # By seconds: a lag that another one feeds by rows would be half a period late.
    seconds = np.repeat(heat, int(PERIOD))

    def late(series, tau):
        kept = np.exp(-1.0 / tau)
        return lfilter([0.0, 1 - kept], [1.0, -kept], series)

    read = 0.05 * late(seconds, 900.0)
    read = gain * (late(read, lag) if lag else read)
    return pd.DataFrame({
        "time_s": PERIOD * np.arange(ROWS),
        "Q_heater_W": heat,
        "T_column_degC": 20 + read[:: int(PERIOD)] + 0.02 * rng.standard_normal(ROWS),
        "d_z_um": 0.2 * late(seconds, 2400.0)[:: int(PERIOD)] + 0.2 * rng.standard_normal(ROWS),
    })  # fmt: skip


@pytest.fixture(scope="module")
def model():
    return tt.calibrate(
        machine(1), ["Q_heater_W"], sensors=["T_column_degC"], deflections=["d_z_um"]
    ).model


@pytest.mark.slow
def test_a_sound_log_does_not_speak_against_what_is_new(model):
    found = tt.diagnose(model, machine(2, lag=240.0), validate=[machine(3)])
    assert [c.effect.name for c in found.diagnosis.causes] == ["sensor_lag"]
    (cause,) = found.diagnosis.causes
    assert abs(cause.effect.parameters["time_constant"] - 240.0) < PERIOD / 3
    assert any("the machine has changed between the logs" in n for n in found.diagnosis.notes)
    # Gains are those of the log that shows it; the written model would harm the sound one.
    assert cause.gain["T_column_degC"].useful
    assert "T_column_degC" in found.diagnosis.spoiled
    document = found.document()
    assert document["validated_on"] == []
    assert len(document["sound"]) == 1


@pytest.mark.slow
def test_a_log_in_which_a_cause_is_never_there_says_nothing_of_it(model):
    frame = machine(3)
    pump = effect_class("second_source")("U_pump_1", {"gain[d_z_um]": 5.0, "time_constant": 600.0})
    law = effect_class("drive_nonlinearity")("Q_heater_W", {"exponent": 1.2, "level": 200.0})

    def silent(pumped, *known):
        effects = (*known, pump)
        search = SimpleNamespace(
            causes=[SimpleNamespace(effect=pump)],
            hypothesis=SimpleNamespace(
                model=replace(model, effects=effects), white=lambda output: 0.1,
                groups=dict.fromkeys(["T_column_degC", "d_z_um"]),
            ),
        )  # fmt: skip
        columns = {name: frame[name].to_numpy(float) for name in frame if name != "time_s"}
        return are_silent(search, Record(frame["time_s"].to_numpy(), {**columns, **pumped}))

    off, on = {"U_pump_1": np.zeros(ROWS)}, {"U_pump_1": (np.arange(ROWS) > 300).astype(float)}
    assert silent(off)
    assert not silent(on)
    # What the model came with acts there, and is none of the causes.
    assert silent(off, law)
    # Without the column nothing says that it was off.
    assert not silent({})


@pytest.mark.slow
def test_a_log_that_shows_the_same_stays_a_veto(model):
    found = tt.diagnose(model, machine(2, lag=240.0), validate=[machine(3, lag=240.0)])
    assert [c.effect.name for c in found.diagnosis.causes] == ["sensor_lag"]
    assert found.diagnosis.spoiled is None
    assert found.document()["sound"] == []


@pytest.mark.slow
def test_what_one_log_shows_too_faintly_the_others_tell(model):
    faint = machine(2, gain=1.04, power=0.1)
    assert not tt.diagnose(model, faint).diagnosis.causes
    found = tt.diagnose(model, faint, validate=[machine(3, gain=1.04)])
    assert [c.effect.name for c in found.diagnosis.causes] == ["sensor_gain"]
    assert any("told by the unseen logs" in note for note in found.diagnosis.notes)
    (cause,) = found.diagnosis.causes
    # The parameter is the faint log's; what it is worth is seen in the other.
    assert abs(cause.effect.parameters["gain"] - 1.04) < 0.02
    assert cause.gain["T_column_degC"].useful
    assert not tt.diagnose(model, faint, validate=[machine(3)]).diagnosis.causes


@pytest.mark.slow
def test_an_unseen_log_that_is_wrong_is_told_where_the_diagnosed_one_is_not(model):
    found = tt.diagnose(model, machine(2), validate=[machine(3, lag=240.0)])
    assert not found.diagnosis.causes
    assert any("is wrong: T_column_degC is off by" in note for note in found.diagnosis.notes)
