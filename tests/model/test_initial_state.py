"""How a log begins: at rest, or on a machine that its own lags, computed here, leave warm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.effects import effect_class
from thermaltool.errors import LogError
from thermaltool.model import Drive, Model, Output, Term, agreements, started_outputs
from thermaltool.record import Record
from thermaltool.responses import response_class
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.rational import Rational1, Rational2

SIGMA = 0.02
TIME = 10.0 * np.arange(1200)
HEAT, ROOM, T, Z = "Q_main_1", "T_room_degC", "T_head_degC", "d_z_um"
LEVELS = np.repeat(np.random.default_rng(20261124).choice([0.0, 0.4, 0.7, 1.0], 40), 30)
LAGS = {T: (8.0, 1500.0), Z: (40.0, 900.0)}
# Of the calibration alone: 5 times as slow as the log.
SLOW = 5.0 * TIME[-1]
MODEL = Model(
    (Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
    (Output(T, "sensor", 20.0, (0.0, 8.0)), Output(Z, "deflection", "first", (0.0, 40.0))),
    tuple(Term(HEAT, output, Rational1(*own)) for output, own in LAGS.items()),
    10.0,
)


SLOWER = replace(
    MODEL,
    terms=tuple(
        Term(HEAT, output, Rational2(height, tau, 0.1 * height, SLOW))
        for output, (height, tau) in LAGS.items()
    ),
)


def lag(u, gain, tau, start):
    y, x = np.empty(len(u)), start
    for k, level in enumerate(u):
        y[k] = x
        x = gain * level + (x - gain * level) * np.exp(-10.0 / tau)
    return y


def log(before=0.0, heat=LEVELS, gain=1.0, slower=1.0, fast=0.1, **more):
    """`before`: how long the heat was at its full level [s]; factors on gains and lags."""
    generator = np.random.default_rng(7)
    columns = {HEAT: heat}
    for output, (height, own) in LAGS.items():
        tau = slower * own
        # Behind a faster lag, which the response to the heat hardly has.
        warm = gain * height * -np.expm1(-before / tau)
        y = lag(heat, gain * height, tau, warm) + fast * warm * np.exp(-TIME / (0.3 * tau))
        y = y + more.get(output, 0.0)
        columns[output] = {T: 20.0, Z: 300.0}[output] + y + SIGMA * generator.standard_normal(1200)
    return Record(TIME, columns, digest="log")


def begins(record, initial="auto", model=MODEL, rows=None):
    found = started_outputs(model, record, model.simulate(record), initial, rows)
    return found, {each.initial for each in found.values()}


def test_a_warm_machine_is_found_and_its_start_estimated():
    warm = log(before=2000.0)
    assert begins(warm)[1] == {"free"}
    for channel, found in agreements(MODEL, [warm]).items():
        assert found.rmse < 1.1 * SIGMA
        assert agreements(MODEL, [warm], initial="rest")[channel].rmse > 20 * SIGMA
    # A zero that the model states is no part of the start.
    assert begins(warm)[0][T].zero.value == 20.0
    assert begins(warm)[0][Z].zero.value == pytest.approx(300.0, abs=0.2)


@pytest.mark.parametrize("before", [250.0, 300.0])
def test_a_first_reading_off_a_known_rest_tells_a_start_beside_another_misfit(before):
    """Beside a swing other responses to the drives explain half of what the start does."""
    swing = np.sin(TIME / 400.0)
    beside = {T: 0.15 * swing, Z: 3.0 * swing}
    assert begins(log(before=before, **beside))[1] == {"free"}
    assert begins(log(**beside))[1] == {"rest"}
    # What stays is a zero of the sensor.
    assert begins(log(**beside | {T: 0.15 * swing + 1.0}))[1] == {"rest"}


@pytest.mark.parametrize("rows", [300, 60, 10])
def test_a_wrong_gain_that_is_read_late_is_no_start(rows):
    heat = np.where(10.0 * rows > TIME, 1.0, 0.0)
    record = log(heat=heat, gain=1.3)
    late = {
        channel: np.where(np.arange(len(TIME)) < rows, np.nan, values)
        for channel, values in record.columns.items()
        if channel != HEAT
    }
    for columns in (record.columns, record.columns | late):
        found, how = begins(replace(record, columns=columns))
        assert how == {"rest"}
        assert np.max(np.abs(found[T].computed)) < 10.0


def test_lags_of_a_source_and_of_a_sensor_have_a_past_too():
    """A pump that was on before the log, and a thermometer that follows late."""
    pump, tau, late = np.repeat([1.0, 0.0, 1.0, 0.0], 300), 5000.0, 400.0
    source = {f"gain[{T}]": 3.0, f"gain[{Z}]": 9.0, "time_constant": tau}
    effects = [effect_class("second_source")("x_pump_1", source)]
    effects += [effect_class("sensor_lag")(T, {"time_constant": late})]
    model = replace(MODEL, effects=tuple(effects))
    columns = {HEAT: LEVELS, "x_pump_1": pump}
    for output, gain in ((T, 3.0), (Z, 9.0)):
        height, own = LAGS[output]
        y = lag(LEVELS, height, own, 0.5 * height) + lag(pump, gain, tau, 0.8 * gain)
        if output == T:
            x, read = np.exp(-10.0 / late), np.array(y)
            for k in range(1, len(y)):
                read[k] = x * read[k - 1] + (1 - x) * 0.5 * (y[k - 1] + y[k])
            y = read
        y = y + SIGMA * np.random.default_rng(5).standard_normal(len(TIME))
        columns[output] = {T: 20.0, Z: 300.0}[output] + y
    warm = Record(TIME, columns, digest="log")
    assert begins(warm, model=model)[1] == {"free"}
    for found in agreements(model, [warm]).values():
        assert found.rmse < 1.15 * SIGMA


def test_a_warm_machine_is_found_by_a_model_with_a_mode_slower_than_the_log():
    warm = log(before=2000.0)
    assert begins(warm, model=SLOWER)[1] == {"free"}
    for channel, found in agreements(SLOWER, [warm]).items():
        assert found.rmse < 0.03 * LAGS[channel][0]
        assert agreements(SLOWER, [warm], initial="rest")[channel].rmse > 3 * found.rmse


@pytest.mark.parametrize(("start", "how"), [(6.0, "free"), (0.0, "rest")])
@pytest.mark.parametrize("period", [2.0, 2.5])
def test_what_decays_at_once_is_a_start_beside_a_room_that_swings(period, start, how):
    model = replace(
        MODEL, outputs=MODEL.outputs[:1], terms=(Term(HEAT, T, Rational1(8.0, 3000.0)),)
    )
    swing = 0.7 * np.sin(2 * np.pi * TIME / (period * TIME[-1]))
    y = lag(LEVELS, 8.0, 3000.0, 0.0) + start * np.exp(-TIME / 150.0) + swing
    y = y + SIGMA * np.random.default_rng(8).standard_normal(1200)
    found = begins(Record(TIME, {HEAT: LEVELS, T: 20.0 + y}, digest="log"), model=model)
    assert found[1] == {how}


@pytest.mark.parametrize("onset", [1600.0, 2000.0, 2500.0])
def test_what_begins_long_after_the_first_row_is_no_start(onset):
    """Heat that comes later and stays: decays and a free zero follow it, and none was there."""
    own = Output(Z, "deflection", "first", (0.0, 40.0))
    model = replace(MODEL, outputs=(own,), terms=(Term(HEAT, Z, Rational1(40.0, 600.0)),))
    y = lag(LEVELS, 40.0, 600.0, 0.0) + lag(np.where(onset < TIME, 1.0, 0.0), 12.0, 600.0, 0.0)
    y = y + SIGMA * np.random.default_rng(9).standard_normal(1200)
    wrong = Record(TIME, {HEAT: LEVELS, Z: y}, digest="log")
    assert begins(wrong, model=model)[1] == {"rest"}
    assert agreements(model, [wrong])[Z].rmse > 0.5 * 12.0


def test_all_outputs_begin_as_the_machine_does():
    hardly = log(before=60.0)
    found, how = begins(hardly.with_columns({T: log(before=2000.0).columns[T]}))
    assert how == {"free"}
    assert found[Z].computed[0] == pytest.approx(40.0 * 60.0 / 900.0 * 1.1, abs=0.2)


@pytest.mark.parametrize(
    "record",
    [
        log(),
        log(gain=1.2),
        # A wrong gain of heat that is switched on once, as the log begins, looks like a start.
        log(heat=np.ones(1200), gain=1.5),
        log(heat=np.ones(1200), gain=1.5, slower=1.3),
        log(heat=np.ones(1200), gain=0.8, slower=0.7),
        # What goes on in the second half is a drift.
        log(**{Z: 5.0 * TIME / TIME[-1], T: 2.0 * TIME / TIME[-1]}),
        # A sensor that was moved.
        log(**{T: 3.0}),
    ],
    ids=["clean", "gain", "one step", "slow step", "quick step", "drift", "offset"],
)
@pytest.mark.parametrize("model", [MODEL, SLOWER], ids=["", "slower mode"])
def test_what_is_no_start_begins_at_rest(record, model):
    found, how = begins(record, model=model)
    assert how == {"rest"}
    rested = begins(record, "rest", model)[0]
    for channel, each in found.items():
        np.testing.assert_array_equal(each.computed, rested[channel].computed)
        assert each.zero == rested[channel].zero


def test_a_log_that_is_too_short_begins_at_rest():
    warm = log(before=2000.0)
    assert begins(warm.rows(slice(0, 60)))[1] == {"rest"}
    assert begins(warm, rows=TIME < 600.0)[1] == {"rest"}
    with pytest.raises(LogError, match="0 readings before the rows that are judged"):
        begins(warm, "free", rows=TIME < 0.0)


def test_few_rows_say_the_state_by_the_modes_of_the_model():
    warm = log(before=2000.0, fast=0.0)
    few = begins(warm, "free", rows=TIME < 600.0)[0]
    _follows(few, warm, 0.02)


def test_rows_behind_those_that_say_the_state_are_forecast():
    # Many decays, fitted to rows that are many, too, would end anywhere.
    warm = log(before=2000.0, fast=0.0)
    found, how = begins(warm, rows=TIME < 4000.0)
    assert how == {"free"}
    _follows(found, warm, 0.004)


def _follows(found, warm, share):
    late = TIME > 4000.0
    for channel, each in found.items():
        error = warm.columns[channel] - each.zero.value - each.computed
        assert np.sqrt(np.mean(error[late] ** 2)) < share * LAGS[channel][0]


def test_the_zero_of_a_sensor_that_goes_with_the_room_is_free():
    room = Drive(ROOM, "first", "first", (-2.0, 2.0), rest=20.0)
    terms = (*MODEL.terms, Term(ROOM, T, Rational1(0.8, 2500.0)))
    model = replace(MODEL, drives=(*MODEL.drives, room), terms=terms)
    air = np.full(1200, 26.0)
    # It stands at the room's 26 degC, where the model has 20 + 0.8 (26 - 20).
    warm = log(before=2000.0, **{T: 6.0}).with_columns({ROOM: air})
    assert begins(warm, model=model)[0][T].zero.value == pytest.approx(21.2, abs=0.1)
    assert agreements(model, [warm])[T].rmse < 1.2 * SIGMA


def test_a_machine_that_its_calibration_found_warm_is_at_rest_nowhere():
    # Too little of a start to say so by itself, beside a gain that is wrong.
    hardly = log(before=60.0, gain=1.2)
    assert begins(hardly)[1] == {"rest"}
    warm = replace(MODEL.outputs[0], fit={"free_start": True})
    model = replace(MODEL, outputs=(warm, MODEL.outputs[1]))
    assert begins(hardly, model=model)[1] == {"free"}
    assert begins(hardly.rows(slice(0, 60)), model=model)[1] == {"rest"}


def test_what_a_body_of_many_modes_brings_along_is_followed_in_a_log_shorter_than_its_lags():
    body = replace(
        MODEL,
        outputs=(replace(MODEL.outputs[0], fit={"free_start": True}),),
        terms=(Term(HEAT, T, Conduction(8.0, 5.0, 1e-5, 0.16)),),
    )
    slowest = body.terms[0].response.slowest()
    assert slowest > TIME[-1]
    # From no level of the heat: its skin has cooled, its core has not.
    decays = zip((5.0, -2.0, 0.7, -0.9), (1.0, 0.2, 0.05, 0.01), strict=True)
    cooling = sum(height * np.exp(-TIME / (part * slowest)) for height, part in decays)
    noise = SIGMA * np.random.default_rng(11).standard_normal(len(TIME))
    record = Record(TIME, {HEAT: np.zeros(len(TIME)), T: 20.0 + cooling + noise}, digest="cools")
    assert begins(record, model=body)[1] == {"free"}
    assert agreements(body, [record])[T].rmse < 1.1 * SIGMA
    # A model that was calibrated from rest does not take so slow a course for a start.
    known = replace(body, outputs=(MODEL.outputs[0],))
    assert begins(record, model=known)[1] == {"rest"}
    # ... a machine that is never at rest does, where other responses to the heat would do as well.
    heated = record.with_columns({HEAT: np.ones(len(TIME))})
    rise = body.simulate(heated)[T]
    heated = heated.with_columns({T: record.columns[T] + rise})
    assert begins(heated, model=body)[1] == {"free"}
    assert agreements(body, [heated])[T].rmse < 1.1 * SIGMA


def displacement(tau, start, own, span, zero=300.0, swing=0.0, free_start=False):
    """A displacement of one lag, and a log over so many of it that begins away from rest."""
    time = np.linspace(0.0, span, 1200)
    fit = {"free_start": True} if free_start else {}
    output = Output(Z, "deflection", "first", (0.0, 40.0), fit=fit)
    model = replace(MODEL, outputs=(output,), terms=(Term(HEAT, Z, Rational1(40.0, tau)),))
    y = model.simulate(Record(time, {HEAT: LEVELS}))[Z] + start * np.exp(-time / own)
    y = y + swing * np.sin(2 * np.pi * time / (0.8 * span))
    y = y + zero + SIGMA * np.random.default_rng(12).standard_normal(1200)
    return model, Record(time, {HEAT: LEVELS, Z: y}, digest="log")


@pytest.mark.parametrize("share", [0.6, 0.8, 1.4])
@pytest.mark.parametrize("lengths", [2.1, 3.0, 4.0])
def test_a_start_by_another_lag_than_the_models_is_one(share, lengths):
    model, record = displacement(1500.0, 4.0, share * 1500.0, lengths * 1500.0)
    found, how = begins(record, model=model)
    assert how == {"free"}
    assert np.std(record.columns[Z] - found[Z].computed) < 0.25


@pytest.mark.parametrize("tau", [20_000.0, 60_000.0, 200_000.0])
def test_a_mode_slower_than_the_log_is_not_told_from_its_zero(tau):
    model, record = displacement(tau, 20.0, 3000.0, 12_000.0, free_start=True)
    found, how = begins(record, model=model)
    assert how == {"free"}
    assert found[Z].zero.value == pytest.approx(300.0, abs=15.0)
    assert np.std(record.columns[Z] - found[Z].computed) < 1.5 * SIGMA


def test_what_is_slow_in_a_log_is_no_part_of_its_start():
    model, record = displacement(1500.0, 6.0, 1500.0, 12_000.0, swing=0.5, free_start=True)
    found, how = begins(record, model=model)
    assert how == {"free"}
    start = found[Z].computed - model.simulate(record)[Z]
    # One decay by the lag of the model, and all of the swing is left.
    np.testing.assert_allclose(start, start[0] * np.exp(-record.time / 1500.0), atol=1e-9)
    assert start[0] == pytest.approx(6.0, abs=1.0)
    assert np.std(record.columns[Z] - found[Z].computed) > 0.3


def test_a_pair_that_rings_begins_in_its_own_mode():
    ring = response_class("oscillation")(K=40.0, D=0.0, omega=2 * np.pi / 2500.0, zeta=0.15)
    model = replace(MODEL, outputs=MODEL.outputs[1:], terms=(Term(HEAT, Z, ring),))
    (pole,) = ring.modes(10.0).poles
    y = model.simulate(Record(TIME, {HEAT: LEVELS}))[Z] + 6.0 * np.exp(pole * TIME).real
    y = y + 300.0 + SIGMA * np.random.default_rng(13).standard_normal(1200)
    record = Record(TIME, {HEAT: LEVELS, Z: y}, digest="log")
    assert begins(record, model=model)[1] == {"free"}
    assert agreements(model, [record])[Z].rmse < 1.1 * SIGMA
