"""One rule for what a channel counts from, in every command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import (
    Drive,
    Model,
    ModelRecursion,
    Output,
    Term,
    agreements,
    drive_rests,
    dumps,
    excursions,
    loads,
    rest_shifts,
    started_outputs,
)
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

SIGMA = 0.5
TIME = 10.0 * np.arange(600)
Z = "d_z_um"


def heated(seed, zero=300.0, on_at=0):
    """A growth of 40 um with a time constant of 900 s; the heat is on from row `on_at`."""
    heat = np.where(np.arange(len(TIME)) < on_at, 0.0, 1.0)
    grown = -40.0 * np.expm1(-np.maximum(TIME - TIME[on_at], 0.0) / 900.0)
    noise = SIGMA * np.random.default_rng(seed).standard_normal(len(TIME))
    return Record(TIME, {"Q_main_1": heat, Z: zero + grown + noise}, digest="h")


MODEL = Model(
    (Drive("Q_main_1", "zero", 0.0, (0.0, 1.0)),),
    (Output(Z, "deflection", "first", (0.0, 40.0)),),
    (Term("Q_main_1", Z, Rational1(40.0, 900.0)),),
    10.0,
)


@pytest.mark.parametrize("on_at", [0, 200])
def test_a_zero_is_better_than_one_reading(on_at):
    """The model's own motion is no rest, also where the heat is on from the first row."""
    found = [zeros(MODEL, heated(seed, on_at=on_at))[Z].value for seed in range(60)]
    assert np.sqrt(np.mean((np.array(found) - 300.0) ** 2)) < 0.4 * SIGMA


def zeros(model, record):
    found = started_outputs(model, record, model.simulate(record), "rest")
    return {channel: each.zero for channel, each in found.items()}


def test_a_first_reading_that_is_wrong_changes_nothing():
    log = heated(1)
    wrong = log.columns[Z].copy()
    wrong[0] = -180.0
    bad = replace(log, columns={**log.columns, Z: wrong})
    assert zeros(MODEL, bad)[Z].value == pytest.approx(zeros(MODEL, log)[Z].value, abs=0.1)


def test_a_model_that_is_wrong_moves_the_zero_little():
    """Half the gain is missing, 20 um: over 30 rows the model moves by 28 %; half of that shows."""
    half = replace(MODEL, terms=(Term("Q_main_1", Z, Rational1(20.0, 900.0)),))
    assert zeros(half, heated(2))[Z].value == pytest.approx(300.0, abs=0.2 * 20.0)
    assert agreements(half, [heated(2)])[Z].mean > 10.0


def test_a_log_of_one_row_or_none():
    log = heated(4)
    assert zeros(MODEL, log.rows(slice(0, 1)))[Z].rows == 1
    holed = replace(log, columns={**log.columns, Z: np.full(len(TIME), np.nan)})
    assert zeros(MODEL, holed)[Z].rows == 0


def test_a_jump_of_the_first_minute_does_not_shift_the_log():
    log = heated(4, on_at=60)
    jumped = log.columns[Z] + np.where(TIME < 60, -25.0, 0.0)
    assert zeros(MODEL, replace(log, columns={**log.columns, Z: jumped}))[Z].value == pytest.approx(
        300.0, abs=SIGMA
    )


def test_a_measured_drive_counts_from_the_level_of_its_first_rows():
    drive = Drive("T_bed_degC", "first", "first", (0.0, 80.0))
    model = replace(MODEL, drives=(drive,), terms=(Term(drive.channel, Z, Rational1(1.0, 900.0)),))
    found = []
    for seed in range(60):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(len(TIME))
        bed = np.where(TIME < 600, 21.0, 101.0 - 80.0 * np.exp(-(TIME - 600) / 400)) + noise
        found.append(drive_rests(model, Record(TIME, {drive.channel: bed}))[drive.channel])
    assert np.sqrt(np.mean((np.array(found) - 21.0) ** 2)) < 0.15


def test_a_command_counts_from_its_first_value():
    drive = Drive("Q_main_1", "zero", "first", (0.0, 1.0))
    heat = np.append(0.2, np.random.default_rng(0).uniform(0.0, 1.0, 99))
    rests = drive_rests(replace(MODEL, drives=(drive,)), Record(TIME[:100], {"Q_main_1": heat}))
    assert rests == {"Q_main_1": 0.2}


def frame_of(log):
    return pd.DataFrame({"time_s": log.time, **log.columns})


def test_calibrate_simulate_and_diagnose_tell_the_same_fit():
    log = frame_of(heated(7, on_at=30))
    fit = tt.calibrate(log, "Q_main_1", deflections=Z, kinds={Z: "rational1"})
    told = fit.model.outputs[0].fit
    run = tt.simulate(fit, log)
    assert run.agreements[Z].fit_percent == pytest.approx(told["fit_percent"], abs=1e-9)
    assert run.agreements[Z].rmse == pytest.approx(told["rmse"], rel=1e-9)
    assert told["zeros"][0]["zero"] == pytest.approx(run.zeros[Z].value, abs=1e-9)
    assert told["rmse_zero_free"] <= told["rmse"] * (1 + 1e-6)
    written = tt.diagnose(fit, log).document()["written"]
    assert written[0]["rmse"] == pytest.approx(told["rmse"], rel=1e-9)


def test_simulate_says_from_what_a_zero_was_taken():
    run = tt.simulate(MODEL, frame_of(heated(3)))
    (note,) = run.notes
    assert f"{Z}: counts from the median of measured minus simulated over the first" in note
    document = run.document()[Z]
    assert document["zero"] == pytest.approx(300.0, abs=SIGMA)
    # The model has moved by a tenth after 95 s: a twentieth of the log counts.
    assert document["zero_rows"] == 30
    stated = replace(MODEL, outputs=(replace(MODEL.outputs[0], offset=300.0),))
    assert not tt.simulate(stated, frame_of(heated(3))).notes


# ---------------------------------------------------------------- a room that is another one

ROOM, BODY = "T_room_degC", "T_body_degC"


def in_a_room(first, seed, noise=0.02):
    """A body of 400 s that follows its room and a heater, at rest with the room at `first`."""
    generator = np.random.default_rng(seed)
    time = 10.0 * np.arange(900)
    room = first + 1.5 * np.sin(2 * np.pi * time / 5000)
    heat = np.repeat(generator.choice([0.0, 20.0, 50.0], 15), 60)
    heat[:60] = 0.0
    body = np.empty(len(time))
    body[0] = first
    for k in range(len(time) - 1):
        kept = np.exp(-10.0 / 400.0)
        body[k + 1] = kept * body[k] + (1 - kept) * (room[k] + 0.1 * heat[k])
    columns = {ROOM: room, "Q_heater_W": heat, BODY: body}
    columns[BODY] = columns[BODY] + noise * generator.standard_normal(len(time))
    return Record(time, columns, digest=f"{first} {seed}")


@pytest.mark.parametrize("rooms", [(20.0,), (18.0, 22.0)])
@pytest.mark.slow
def test_a_machine_at_rest_is_as_warm_as_its_room(rooms):
    plan = CalibrationPlan((ROOM, "Q_heater_W"), (BODY,), choose=True)
    model = calibrate([in_a_room(first, k) for k, first in enumerate(rooms)], plan)
    room = next(d for d in model.drives if d.channel == ROOM)
    assert room.rest == pytest.approx(20.0, abs=0.1)
    assert model.outputs[0].fit["rmse"] < 0.05
    colder = in_a_room(13.0, 7)
    left = colder.columns[BODY] - model.outputs[0].offset - model.simulate(colder)[BODY]
    assert float(np.sqrt(np.mean(left**2))) < 0.1
    assert not excursions(model, {BODY: colder.columns[BODY], ROOM: colder.columns[ROOM]})
    assert loads(dumps(model)).drives == model.drives


@pytest.mark.slow
def test_rest_that_the_records_deny_does_not_move():
    """A cooled machine whose zero goes against the room: a gain of the swing says nothing of it."""
    logs = [in_a_room(first, k) for k, first in enumerate((18.0, 22.0))]
    kept = [
        log.with_columns({BODY: log.columns[BODY] - 2.0 * (log.columns[ROOM][0] - 20.0)})
        for log in logs
    ]
    plan = CalibrationPlan((ROOM, "Q_heater_W"), (BODY,), choose=True)
    assert all(d.rest is None for d in calibrate(kept, plan).drives)


@pytest.mark.parametrize("gain", [-0.5, 0.4, 7.5])
def test_nothing_passive_is_warmer_than_all_that_warms_it(gain):
    model = Model(
        (Drive(ROOM, "first", "first", (-5.0, 5.0), 20.0),),
        (Output(BODY, "sensor", 20.0, (-5.0, 5.0)),),
        (Term(ROOM, BODY, Rational1(gain, 400.0)),),
        10.0,
    )
    assert rest_shifts(model, {ROOM: 16.0}) == {BODY: pytest.approx(-4.0 * min(max(gain, 0), 1))}


def test_a_stream_begins_where_its_room_is():
    model = Model(
        (Drive(ROOM, "first", "first", (-5.0, 5.0), 20.0),),
        (Output(BODY, "sensor", 20.0, (-5.0, 5.0)), Output(Z, "deflection", "first", (0.0, 9.0))),
        (Term(ROOM, BODY, Rational1(0.9, 400.0)), Term(ROOM, Z, Rational1(5.0, 900.0))),
        10.0,
    )
    log = in_a_room(13.0, 7)
    whole = model.simulate(log)
    stream = ModelRecursion(model, rests=drive_rests(model, log))
    rows = [{ROOM: float(value)} for value in log.columns[ROOM]]
    found = [stream.start(0.0, rows[0])]
    found += [stream.step(float(t), row) for t, row in zip(log.time[1:], rows[1:], strict=True)]
    assert whole[BODY][0] == pytest.approx(0.9 * (13.0 - 20.0), abs=0.2)
    for output, values in whole.items():
        np.testing.assert_allclose([row[output] for row in found], values, atol=1e-9)
