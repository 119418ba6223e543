"""Experiments that can be done, and causes that are ruled out."""

from __future__ import annotations

import re

import numpy as np
import pytest
from reference.diagnosed import BED, DRIVE, OUTPUT, diagnosed, measured

from thermaltool.diagnosis.alternatives import invisible
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.inputs import library
from thermaltool.diagnosis.limits import UNLIMITED, ExperimentLimits, limits_of
from thermaltool.diagnosis.result import Tried
from thermaltool.diagnosis.ruled_out import ruled_out
from thermaltool.diagnosis.state import RELEASED
from thermaltool.effects.second_source import SecondSource
from thermaltool.errors import UnitError
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.deflection import Deflection

FRAME, ROOM, FAN = "T_frame_degC", "T_room_degC", "x_fan_1"


def machine(drive: str) -> Hypothesis:
    """One drive, a deflection with a time constant of three hours, a fan and a room in the log."""
    time = 30.0 * np.arange(1200)
    columns = {
        drive: np.repeat([0.0, 8.0, 0.0, 8.0], 300),
        FAN: np.repeat([0.0, 1.0], 600),
        ROOM: 20.0 + np.sin(time / 9000),
    }
    response = Deflection(40.0, 1 / 10800, 0.0, 1.0, 0.0, 1.0)
    model = Model(
        drives=(Drive(drive, 0.0, 0.0, (0.0, 8.0)),),
        outputs=(Output(OUTPUT, "deflection", "first", (-400.0, 400.0)),),
        terms=(Term(drive, OUTPUT, response),),
        sample_period=30.0,
    )
    y = model.simulate(Record(time, columns))[OUTPUT]
    noise = 0.5 * np.random.default_rng(3).standard_normal(len(time))
    log = Record(time, {**columns, OUTPUT: y + noise}, digest="log")
    return Hypothesis.of(model, [log], model, RELEASED)


def beside(channel: str) -> SecondSource:
    return SecondSource(channel, {f"gain[{OUTPUT}]": 1.0, "time_constant": 3000.0})


def moved(made: Hypothesis, limits: ExperimentLimits, *causes: SecondSource) -> set[str]:
    """Channels that some experiment moves."""
    return {
        channel
        for each in library(made, causes, limits)
        for channel, values in each.record.columns.items()
        if np.ptp(values) > 0
    }


def test_no_run_is_longer_than_can_be() -> None:
    made = machine("Q_main_1")
    for hours in (1.0, 4.0):
        found = library(made, [beside(FAN)], ExperimentLimits(run=3600 * hours))
        assert found
        assert max(each.record.duration for each in found) <= 3600 * hours * 1.01
        for each in found:
            told = [
                float(value) * {"s": 1, "min": 60, "h": 3600}[unit]
                for value, unit in re.findall(r"(\d+(?:\.\d+)?) (s|min|h)\b", each.sentence)
            ]
            assert max(told, default=0.0) <= 3600 * hours * 1.05, each.sentence
    assert max(e.record.duration for e in library(made, [beside(FAN)], UNLIMITED)) > 20 * 3600


def test_nothing_is_switched_faster_than_can_be() -> None:
    made = machine("Q_main_1")

    def fastest(limits: ExperimentLimits) -> float:
        shortest = np.inf
        for each in library(made, [beside(FAN)], limits):
            u = each.record.columns["Q_main_1"]
            steps = np.flatnonzero(np.abs(np.diff(u)) > 0.3)
            if len(steps) > 1:
                shortest = min(shortest, float(np.min(np.diff(steps))) * each.record.period)
        return shortest

    assert fastest(ExperimentLimits(run=4 * 3600.0)) < 200
    assert fastest(ExperimentLimits(run=4 * 3600.0, switch=600.0)) >= 570  # less a row


def test_what_is_only_measured_is_not_set() -> None:
    heated, warmed = machine("Q_main_1"), machine(FRAME)
    usual = ExperimentLimits()
    assert moved(heated, usual, beside(FAN), beside(ROOM)) == {"Q_main_1", FAN}
    assert moved(heated, ExperimentLimits(fixed=frozenset({FAN})), beside(FAN)) == {"Q_main_1"}
    allowed = ExperimentLimits(settable=frozenset({ROOM}))
    assert ROOM in moved(heated, allowed, beside(ROOM))
    assert moved(warmed, usual, beside(FAN)) == {FAN}
    assert not any(FRAME in each.sentence for each in library(warmed, [beside(FAN)], usual))
    assert FRAME in moved(warmed, ExperimentLimits(settable=frozenset({FRAME})), beside(FAN))


def test_what_cannot_be_seen_does_not_depend_on_what_can_be_done() -> None:
    made = machine("Q_main_1")
    nothing = ExperimentLimits(fixed=frozenset({"Q_main_1", FAN}))
    free, bound = invisible(made, UNLIMITED), invisible(made, nothing)
    assert free
    assert [each.names for each in free] == [each.names for each in bound]
    assert all(each.separating_experiment for each in free)
    assert not any(each.separating_experiment for each in bound)


def test_limits_as_they_are_typed() -> None:
    channels = ["Q_main_1", ROOM, FAN]
    assert limits_of("", channels) == ExperimentLimits()
    assert limits_of(f"switch=30s, run=4h,fixed={FAN},set={ROOM},fixed=Q_main_1", channels) == (
        ExperimentLimits(30.0, 14400.0, frozenset({FAN, "Q_main_1"}), frozenset({ROOM}))
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fast", "takes switch=TIME, run=TIME"),
        ("stop=3", "takes switch=TIME"),
        ("run=4K", "not a time above zero"),
        ("run=4", "of which unit. run=4s, run=4min or run=4h .logs count in s"),
        ("run=0h", "not a time above zero"),
        ("run=long", "not a number"),
        ("fixed=T_rom_degC", "no channel 'T_rom_degC' .near: T_room_degC"),
        (f"fixed={FAN},set={FAN}", "both fixed and set"),
        ("switch=2h,run=1h", "switch is longer than run"),
    ],
)
def test_limits_that_cannot_be(text: str, message: str) -> None:
    with pytest.raises(UnitError, match=message):
        limits_of(text, [ROOM, FAN])


def test_ruled_out_is_what_would_have_been_seen_and_was_not() -> None:
    found = diagnosed([measured()])
    residual = found.residuals[OUTPUT].spread
    tried = (
        Tried("second_source", BED, -5.0, 0.1 * residual, "no evidence", OUTPUT),  # named
        Tried("sensor_gain", OUTPUT, -8.0, 0.1 * residual, "no evidence", OUTPUT),
        Tried("radiation", OUTPUT, -9000.0, 0.05 * residual, "no evidence", OUTPUT),
        Tried("hysteresis", DRIVE, 2.0, 0.1 * residual, "no evidence", OUTPUT),  # speaks for it
        Tried("backlash", DRIVE, -8.0, 0.8 * residual, "no evidence", OUTPUT),  # too small to see
        Tried("transport_delay", DRIVE, -7.1, None, "cannot be seen"),
        Tried("periodic", OUTPUT, -8.0, 0.1 * residual, "no evidence", OUTPUT),  # any period
        Tried("second_source", "", -8.0, 0.1 * residual, "no evidence", OUTPUT),  # anything
    )
    named = {("second_source", BED)}
    told = ruled_out(tried, found.residuals, named, {})
    assert [each.name for each in told] == ["radiation", "sensor_gain"]
    assert told[0].odds == pytest.approx(1000.0)
    assert told[1].odds == pytest.approx(np.exp(4.0))
    assert told[1].matters == residual
    # A looser tolerance rules out more, a tight one nothing.
    loose = ruled_out(tried, found.residuals, named, {OUTPUT: 2 * residual})
    assert [each.name for each in loose] == ["radiation", "sensor_gain", "backlash"]
    assert ruled_out(tried, found.residuals, named, {OUTPUT: 0.01 * residual}) == ()
