"""Machines that a log finds away from rest, computed at every instant by their own lags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.fitting.calibrate import as_simulated, calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.start_choice import free_where_known, rests
from thermaltool.model import Drive, agreements
from thermaltool.record import Record
from thermaltool.report.calibration import calibration_warnings

DRIVE, OUTPUTS = "P_pad_W", ("dT_a_K", "dT_b_K")
LAGS = {"dT_a_K": ((0.12, 300.0), (0.08, 2400.0)), "dT_b_K": ((0.1, 1800.0),)}  # K/W, s
GAINS = {output: sum(gain for gain, _ in lags) for output, lags in LAGS.items()}
PLAN = CalibrationPlan((DRIVE,), OUTPUTS, initial="auto", choose=True)


def log_of(seed, before=0.0, idle=0.0, loss=0.0):
    """Random levels of power; `before` it [W] for long, `idle` [s] off first; `loss` by warmth."""
    generator = np.random.default_rng(seed)
    step, time = 20.0, 20.0 * np.arange(1000)
    power = np.repeat(generator.choice([0.0, 30.0, 60.0, 90.0], 25), 40)
    power[time < idle] = 0.0
    columns = {DRIVE: power}
    for output, lags in LAGS.items():
        y = np.zeros(len(time))
        for gain, tau in lags:
            x = gain * before
            for k in range(len(time)):
                y[k] += x
                rate = (1 + loss * x / 10.0) / tau
                end = gain * power[k] / (1 + loss * x / 10.0)
                x = end + (x - end) * np.exp(-step * rate)
        columns[output] = y + 0.01 * generator.standard_normal(len(time))
    return Record(time, columns, digest=f"{seed} {before} {idle}")


def steady_then(log, power):
    """The outputs of a machine that has long been under what its log begins with."""
    found = {}
    for output, lags in LAGS.items():
        y = np.zeros(len(log.time))
        for gain, tau in lags:
            x, keep = gain * power, np.exp(-20.0 / tau)
            for k, u in enumerate(log.columns[DRIVE]):
                y[k] += x
                x = gain * u + (x - gain * u) * keep
        found[output] = y + 0.01 * np.random.default_rng(7).standard_normal(len(y))
    return found


def gains_of(model):
    return {term.output: term.response.dc_gain() for term in model.terms}


def starts_free(model):
    return {output.fit["free_start"] for output in model.outputs}


@pytest.mark.slow
def test_a_machine_that_cools_as_its_log_begins():
    log = log_of(20261123, before=150.0)
    model = calibrate([log], PLAN)
    assert starts_free(model) == {True}
    assert gains_of(model) == pytest.approx(GAINS, rel=0.01)
    assert all(output.fit["rmse_zero_free"] < 0.012 for output in model.outputs)
    # As `simulate` gives it, which finds that the log does not begin at rest.
    assert all(output.fit["rmse"] < 0.012 for output in model.outputs)
    assert any(
        "state at the first rows is fitted" in sentence for sentence in calibration_warnings(model)
    )


@pytest.mark.slow
def test_rest_is_taken_for_rest():
    model = calibrate([log_of(20261124)], PLAN)
    assert starts_free(model) == {False}
    assert gains_of(model) == pytest.approx(GAINS, rel=0.01)


@pytest.mark.slow
def test_a_machine_that_stood_under_power_is_not_at_rest():
    # Nothing moves at first, and still it is far from rest.
    log = log_of(20261127, before=60.0)
    log.columns[DRIVE][:40] = 60.0
    columns = {**log.columns, **steady_then(log, 60.0)}
    model = calibrate([Record(log.time, columns, digest="steady")], PLAN)
    assert starts_free(model) == {True}
    assert gains_of(model) == pytest.approx(GAINS, rel=0.01)


def test_what_rests_is_off_and_still_at_first():
    drive = Drive(DRIVE, "zero", 0.0, (0.0, 90.0))
    off = log_of(20261125, idle=1200.0)
    assert rests(off, [drive], OUTPUTS)
    columns = {name: values.copy() for name, values in off.columns.items()}
    # A reading that is missing somewhere says nothing of the first ones.
    columns["dT_a_K"][700] = np.nan
    assert rests(Record(off.time, columns), [drive], OUTPUTS)
    columns[DRIVE] += 1.0
    assert not rests(Record(off.time, columns), [drive], OUTPUTS)
    assert not rests(log_of(20261125, before=60.0, idle=1200.0), [drive], OUTPUTS)


@pytest.mark.slow
def test_no_lag_behind_a_free_start_is_longer_than_the_log():
    log = log_of(20261126, before=150.0)
    creep = 5.0 * -np.expm1(-log.time / (20 * log.duration))
    columns = {**log.columns, "dT_b_K": log.columns["dT_b_K"] + creep}
    plan = replace(PLAN, initial="free", sensors=("dT_b_K",))
    model = calibrate([Record(log.time, columns, digest="creeps")], plan)
    assert max(term.response.slowest() for term in model.terms) <= 1.001 * log.duration


def with_open_gains(model, output):
    """The model as if the log said nothing of the gains of an output."""
    terms = (
        replace(t, covariance=np.asarray(t.covariance) * 1e12) if t.output == output else t
        for t in model.terms
    )
    return replace(model, terms=tuple(terms))


@pytest.mark.slow
def test_each_output_begins_as_leaves_fewer_gains_open():
    log = log_of(20261128)
    free, rested = (
        calibrate([log], replace(PLAN, initial=how, kinds=dict.fromkeys(OUTPUTS, "rational1")))
        for how in ("free", "rest")
    )
    a, b = OUTPUTS
    chosen = free_where_known(with_open_gains(free, a), with_open_gains(rested, b))
    assert [o.channel for o in chosen.outputs] == list(OUTPUTS)
    assert [o.fit["free_start"] for o in chosen.outputs] == [False, True]
    assert [t for t in chosen.terms if t.output == a] == [t for t in rested.terms if t.output == a]
    assert [t for t in chosen.terms if t.output == b] == [t for t in free.terms if t.output == b]
    # What is told of either is what `simulate` makes of them together.
    told = as_simulated(chosen, [log])
    for channel, found in agreements(chosen, [log]).items():
        own = next(o for o in told.outputs if o.channel == channel)
        assert own.fit["rmse"] == found.rmse
    assert as_simulated(told, [log]).outputs == told.outputs
    # Where both know as much, all begin free.
    assert starts_free(free_where_known(free, rested)) == {True}


@pytest.mark.slow
def test_gains_from_rest_that_leave_what_a_start_explains_are_no_better_known():
    log = log_of(20261128, before=150.0)
    free, rested = (
        calibrate([log], replace(PLAN, initial=how, kinds=dict.fromkeys(OUTPUTS, "rational1")))
        for how in ("free", "rest")
    )
    unsure = with_open_gains(with_open_gains(free, OUTPUTS[0]), OUTPUTS[1])
    assert starts_free(free_where_known(unsure, rested)) == {True}


def warm_in_a_room(seed, warm):
    """A bearing on a bed in a room that drifts, all `warm` [K] warmer than it at first."""
    rng = np.random.default_rng([2811, seed])
    step, rows = 10.0, 1800
    time = step * np.arange(rows)
    power = np.repeat(rng.permutation(np.repeat([0.0, 0.3, 0.6, 1.0], 5)), 90)
    power[:30] = 0.0
    room = 2.0 * np.sin(2 * np.pi * (time / 16000.0 + rng.uniform())) - 1e-4 * time
    room -= room[0]
    bearing = bed = warm
    found = np.empty(rows)
    for k in range(rows):
        found[k] = bearing
        for _ in range(10):
            flow = 5.0 * (bearing - bed)
            bearing += 0.1 * step * (70.0 * power[k] - flow - 0.7 * (bearing - room[k])) / 4000.0
            bed += 0.1 * step * (flow - 22.0 * (bed - room[k])) / 60000.0
    noise = 0.03 * rng.standard_normal(rows)
    columns = {"P_pad_W": power, "T_room_degC": 21.0 + room, "T_nut_degC": 21.0 + found + noise}
    return Record(time, columns, digest=f"room {seed}")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "warm"), [(1, 1.5), (3, 1.5), (4, -1.0), (6, 0.0)])
def test_a_machine_still_on_its_way_to_its_room_follows_the_room(seed, warm):
    """It hardly moves before the drive does, and from rest a slow response to the room does."""
    plan = replace(PLAN, drives=(DRIVE, "T_room_degC"), sensors=("T_nut_degC",))
    model = calibrate([warm_in_a_room(seed, warm)], plan)
    assert starts_free(model) == {warm != 0}
    gains = {term.drive: term.response.dc_gain() for term in model.terms}
    assert gains["T_room_degC"] == pytest.approx(1.0, abs=0.01)
    through_bed = 1 / (1 / 5.0 + 1 / 22.0)
    assert gains[DRIVE] == pytest.approx(70.0 / (0.7 + through_bed), rel=0.02)
    another = warm_in_a_room(seed + 10, 0.0)
    assert agreements(model, [another])["T_nut_degC"].rmse < 2 * 0.03
