"""Averages of rows in place of all: the same model, as far as its standard errors tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.fitting import averaging
from thermaltool.fitting.averaging import average, averaged_rows
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Drive, dumps
from thermaltool.record import Record
from thermaltool.signals.resolution import reading_sigma

ROWS, FEW, NOISE, PERIOD = 20_000, 500, 0.05, 2.0
DRIVE, OUTPUT, ROOM = "Q_main_W", "d_z_um", "T_room_degC"
# The faster one is 1.5 stretches long.
GAINS, TAUS = (5.0, 3.0), (120.0, 900.0)
PLAN = CalibrationPlan((DRIVE,), deflections=(OUTPUT,), kinds={OUTPUT: "rational2"})


def duty(time, seed=1):
    """Held levels that switch at any row, off at first."""
    rng = np.random.default_rng(seed)
    switched = rng.random(len(time)) < 1 / 300
    levels = rng.choice([0.0, 0.25, 0.5, 1.0], int(switched.sum()) + 1)
    levels[0] = 0.0
    return levels[np.cumsum(switched)]


def lags(time, u):
    """Two lags of a held input, by their exact recursion from row to row."""
    y = np.zeros(len(time))
    for gain, tau in zip(GAINS, TAUS, strict=True):
        state, kept = 0.0, np.exp(-np.diff(time) / tau)
        for k in range(len(kept)):
            state = kept[k] * state + (1 - kept[k]) * u[k]
            y[k + 1] += gain * state
    return y


def record_of(time, u, seed=2):
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(time))
    return Record(time, {DRIVE: u, OUTPUT: lags(time, u) + noise}, digest="a")


def even():
    time = PERIOD * np.arange(ROWS)
    return record_of(time, duty(time))


def on_from_the_first_row():
    time = PERIOD * np.arange(ROWS)
    return record_of(time, duty(time) + 0.5)


def switched_fast():
    """A heater that is switched by its duty, each time for two averages of ten rows."""
    time = PERIOD * np.arange(ROWS)
    share = (np.arange(ROWS) % 20) / 20
    return record_of(time, (share < duty(time)).astype(float))


def jittered():
    rng = np.random.default_rng(3)
    time = PERIOD * np.cumsum(rng.uniform(0.5, 1.5, ROWS))
    return record_of(time, duty(time))


def paused():
    time = PERIOD * np.arange(ROWS)
    time[ROWS // 3 :] += 700.0
    time[ROWS // 2 :] += 90.0
    record = record_of(time, duty(time))
    cuts = [0, ROWS // 3, ROWS // 2, ROWS]
    return replace(record, segments=tuple(map(slice, cuts[:-1], cuts[1:])))


def with_missing_readings():
    record = even()
    values = record.columns[OUTPUT].copy()
    rng = np.random.default_rng(4)
    values[rng.random(ROWS) < 0.3] = np.nan
    values[3000:3700] = np.nan
    return record.with_columns({OUTPUT: values})


def with_single_bad_readings():
    record = even()
    values = record.columns[OUTPUT].copy()
    values[np.random.default_rng(5).choice(ROWS, 40, replace=False)] += 100.0
    return record.with_columns({OUTPUT: values})


def parameters(model):
    """Time constants and gains, and their standard errors, the faster lag first."""
    (term,) = model.terms
    names = list(term.covariance_names)
    order = ("1", "2") if term.response.tau1 < term.response.tau2 else ("2", "1")
    wanted = [name + k for name in ("tau", "K") for k in order]
    values = [getattr(term.response, name) for name in wanted]
    errors = [term.covariance[names.index(name), names.index(name)] ** 0.5 for name in wanted]
    return np.array(values), np.array(errors)


@pytest.mark.parametrize(
    "log",
    [
        even,
        on_from_the_first_row,
        jittered,
        paused,
        with_missing_readings,
        with_single_bad_readings,
    ],
)
def test_averages_tell_what_all_rows_tell(log, monkeypatch):
    record = log()
    whole, error = parameters(calibrate([record], PLAN))
    monkeypatch.setattr(averaging, "MAX_ROWS", FEW)
    model = calibrate([record], PLAN)
    found, own_error = parameters(model)
    assert model.outputs[0].fit["averaged_rows"] == [ROWS // FEW]
    assert np.all(np.abs(found - whole) < error)
    assert np.all(np.abs(found - [*TAUS, *GAINS]) < 4 * own_error)
    # No more is lost than what is faster than an average.
    assert np.all(own_error < 1.5 * error)


@pytest.mark.slow
def test_a_drive_that_switches_all_the_time_is_followed_within_averages(monkeypatch):
    record = switched_fast()
    whole, error = parameters(calibrate([record], PLAN))
    monkeypatch.setattr(averaging, "MAX_ROWS", ROWS // 10)
    found, _ = parameters(calibrate([record], PLAN))
    assert np.all(np.abs(found - whole) < error)
    # Of rows at the averages alone this would be missed by far.
    monkeypatch.setattr(averaging, "PARTS", 1)
    assert abs(parameters(calibrate([record], PLAN))[0][0] - whole[0]) > 3 * error[0]


@pytest.mark.slow
def test_kinds_are_chosen_alike(monkeypatch):
    record, plan = even(), replace(PLAN, kinds={}, choose=True)
    whole = calibrate([record], plan)
    monkeypatch.setattr(averaging, "MAX_ROWS", FEW)
    found = calibrate([record], plan)
    assert [t.response.kind for t in found.terms] == [t.response.kind for t in whole.terms]
    assert found.drives == whole.drives
    assert found.effects == whole.effects == ()
    values, error = parameters(whole)
    assert np.all(np.abs(parameters(found)[0] - values) < error)


def test_figures_are_those_of_readings(monkeypatch):
    record = even()
    whole = calibrate([record], PLAN)
    monkeypatch.setattr(averaging, "MAX_ROWS", FEW)
    found = calibrate([record], PLAN)
    assert found.sample_period == whole.sample_period == PERIOD
    (fit,), (usual,) = ([o.fit for o in model.outputs] for model in (found, whole))
    noise = reading_sigma(record.column(OUTPUT))
    assert (fit["rows"], fit["noise"]) == (usual["rows"], usual["noise"]) == (ROWS, noise)
    assert fit["discrepancy"]["white_sigma"] == pytest.approx(NOISE, rel=0.03)
    for name in ("rmse", "rmse_zero_free", "max_error", "fit_percent"):
        assert fit[name] == pytest.approx(usual[name], rel=2e-3)


def test_a_free_start_is_told_with_the_noise_of_readings(monkeypatch):
    monkeypatch.setattr(averaging, "MAX_ROWS", FEW)
    record = even().rows(slice(5000, ROWS))
    fit = calibrate([record], replace(PLAN, initial="free")).outputs[0].fit
    assert fit["rmse_zero_free"] == pytest.approx(NOISE, rel=0.02)


def test_a_measured_drive_is_averaged_as_its_output(monkeypatch):
    time = PERIOD * np.arange(ROWS)
    room = 20.0 + 3.0 * np.sin(time / 3000.0) + np.sin(time / 700.0)
    noise = 0.01 * np.random.default_rng(6).standard_normal(ROWS)
    columns = {ROOM: room, OUTPUT: lags(time, room - room[0]) + noise}
    plan = replace(PLAN, drives=(ROOM,), kinds={OUTPUT: "rational1"})
    record = Record(time, columns, digest="room")
    whole = calibrate([record], plan).terms[0]
    monkeypatch.setattr(averaging, "MAX_ROWS", FEW)
    found = calibrate([record], plan).terms[0]
    errors = np.sqrt(np.diag(whole.covariance))
    for name, error in zip(whole.covariance_names, errors, strict=True):
        assert abs(getattr(found.response, name) - getattr(whole.response, name)) < error


def test_up_to_the_limit_nothing_changes(monkeypatch):
    record = even().rows(slice(0, 3000))
    usual = dumps(calibrate([record], PLAN))
    monkeypatch.setattr(averaging, "MAX_ROWS", 3000)
    assert dumps(calibrate([record], PLAN)) == usual
    monkeypatch.setattr(averaging, "MAX_ROWS", 2999)
    assert dumps(calibrate([record], PLAN)) != usual


def test_logs_of_other_periods_are_averaged_over_the_same_time(monkeypatch):
    monkeypatch.setattr(averaging, "MAX_ROWS", 1000)
    fast, slow = np.arange(100_000) * 0.1, np.arange(400) * 60.0
    assert averaged_rows([Record(fast, {}), Record(slow, {})]) == [167, 1]
    assert averaged_rows([Record(fast[:600], {}), Record(slow, {})]) == [1, 1]
    # One row of each is left where not even that is enough.
    monkeypatch.setattr(averaging, "MAX_ROWS", 1)
    assert averaged_rows([Record(fast, {}), Record(slow, {})]) == [100_000, 400]


def test_the_average_of_a_step_is_a_ramp(monkeypatch):
    monkeypatch.setattr(averaging, "MAX_ROWS", 10)
    time = np.arange(100.0)
    u = np.where(time < 43, 0.0, 2.0)
    drive = Drive(DRIVE, "zero", 0.0, (0.0, 2.0))
    (record,), (own,) = average([Record(time, {DRIVE: u, OUTPUT: time})], [drive], [OUTPUT])
    assert (own.hold, own.reference) == ("first", 0.0)
    # Ten rows to each average, whose middle is between rows; a row more at each end of the ramp.
    there = np.isfinite(record.column(OUTPUT))
    assert record.time[there] == pytest.approx(np.arange(10) * 10 + 4.5)
    assert record.column(OUTPUT)[there] == pytest.approx(record.time[there])
    assert {38.0, 48.0} <= set(record.time[~there].tolist())
    ramp = np.clip((record.time - 38.0) / 10.0, 0.0, 1.0)
    assert record.column(DRIVE) == pytest.approx(2.0 * ramp)
    assert record.segments == (slice(0, len(record.time)),)


def test_a_pause_has_the_drive_alone(monkeypatch):
    monkeypatch.setattr(averaging, "MAX_ROWS", 10)
    time = np.arange(100.0) + np.where(np.arange(100) < 50, 0.0, 300.0)
    u = np.ones(100)
    parts = (slice(0, 50), slice(50, 100))
    drive = Drive(DRIVE, "zero", 0.0, (0.0, 1.0))
    log = Record(time, {DRIVE: u, OUTPUT: time}, parts)
    (record,), _ = average([log], [drive], [OUTPUT])
    within = (record.time > 50.0) & (record.time < 349.0)
    assert np.isnan(record.column(OUTPUT)[within]).all()
    assert record.column(DRIVE)[record.time > 5.0] == pytest.approx(1.0)
    assert [int(np.isfinite(record.column(OUTPUT)[part]).sum()) for part in record.segments] == [
        5,
        5,
    ]


def test_it_is_told(monkeypatch):
    monkeypatch.setattr(averaging, "MAX_ROWS", FEW)
    record = even()
    frame = pd.DataFrame({"time_s": record.time, **record.columns})
    said = []
    tt.calibrate(
        frame, [DRIVE], deflections=[OUTPUT], kinds=dict(PLAN.kinds), linear=True, warn=said.append
    )
    assert said == ["<frame>: 20 000 rows: every 40 are averaged for the fit"]


def test_the_noise_of_an_average_is_that_of_its_readings(monkeypatch):
    record, drive = even(), Drive(DRIVE, "zero", 0.0, (0.0, 1.0))
    sigma = reading_sigma(record.column(OUTPUT))
    assert averaging.row_noise(record, OUTPUT) == sigma
    assert averaging.known_noise([record], OUTPUT) is None
    monkeypatch.setattr(averaging, "MAX_ROWS", FEW)
    (averages,), _ = average([record], [drive], [OUTPUT])
    own = averaging.row_noise(averages, OUTPUT)
    assert own == pytest.approx(sigma / np.sqrt(ROWS / FEW))
    # Differences of averages are largely those of the signal.
    assert reading_sigma(averages.column(OUTPUT)) > 1.5 * own
    assert averaging.known_noise([averages.with_columns({})], OUTPUT) == sigma
