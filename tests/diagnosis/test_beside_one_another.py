"""Causes, logs and units beside one another: each is told as if the others were not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.inputs import ChannelLevels
from thermaltool.diagnosis.joint_fit import fitted_together
from thermaltool.diagnosis.limits import UNLIMITED, USUAL_LIMITS
from thermaltool.diagnosis.no_signature import find_outliers
from thermaltool.diagnosis.select import fit_candidate
from thermaltool.diagnosis.state import RELEASED, WITHIN_CALIBRATION
from thermaltool.diagnosis.written import steps_of
from thermaltool.effects import effect_class
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

HEAT, PUMP, FAN, T, Z = "Q_motor_W", "s_pump_1", "s_fan_1", "T_head_degC", "d_z_um"


def follow(u: np.ndarray, lag: float, period: float) -> np.ndarray:
    """A first-order lag of what is held from row to row: Euler's steps, ten to a row."""
    found, y = [0.0], 0.0
    for value in u[:-1]:
        for _ in range(10):
            y += 0.1 * period * (value - y) / lag
        found.append(y)
    return np.array(found)


# ---------------------------------------------------------------- two sources that overlap


def two_sources(pump: float, fan: float, seed: int) -> Record:
    """A head that a motor warms, and at times two more sources that run together."""
    time = 30.0 * np.arange(400)
    noise = np.random.default_rng([2811, seed]).standard_normal((2, len(time)))
    heat = np.where((time > 300) & (time < 5000) | (time > 8000) & (time < 10000), 100.0, 0.0)
    runs = [((time > a) & (time < b)).astype(float) for a, b in ((2000, 9000), (2500, 7500))]
    beside = pump * follow(runs[0], 500.0, 30.0) + fan * follow(runs[1], 500.0, 30.0)
    columns = {
        HEAT: heat,
        PUMP: runs[0],
        FAN: runs[1],
        T: 20.0 + 0.2 * follow(heat, 600.0, 30.0) + 0.2 * beside + 0.02 * noise[0],
        Z: 0.3 * follow(heat, 900.0, 30.0) + beside + 0.1 * noise[1],
    }
    return Record(time, columns, digest=f"log {seed}")


@pytest.mark.slow
def test_two_sources_that_run_together_are_told_apart_by_their_sizes():
    model = calibrate([two_sources(0.0, 0.0, 1)], CalibrationPlan((HEAT,), (T,), (Z,), choose=True))
    found = diagnose(model, [two_sources(8.0, 6.0, 2)])
    told = {c.effect.channel: c for c in found.causes}
    assert {(c.effect.name, c.effect.channel) for c in found.causes} == {
        ("second_source", PUMP),
        ("second_source", FAN),
    }
    for channel, size in ((PUMP, 8.0), (FAN, 6.0)):
        values = told[channel].effect.parameters
        whole = values[f"gain[{Z}]"] + values.get(f"slow_gain[{Z}]", 0.0)
        assert whole == pytest.approx(size, rel=0.1)
        assert told[channel].explained > 0.9


# ---------------------------------------------------------------- heat that comes and goes


def lit(
    on: float, off: float, watts: float, seed: int, reaches: tuple[float, float] = (1.0, 4.0)
) -> Record:
    """A head with a motor and a lamp, each through a lag of its own, in two outputs."""
    time = 30.0 * np.arange(900)
    noise = np.random.default_rng([2812, seed]).standard_normal((2, len(time)))
    heat = 100.0 * np.repeat(np.random.default_rng(seed).choice([0.0, 0.4, 1.0], 30), 30)
    lamp = watts * follow(((time > on) & (time < off)).astype(float), 1500.0, 30.0)
    columns = {
        HEAT: heat,
        T: 20.0 + 0.2 * follow(heat, 600.0, 30.0) + reaches[0] * lamp + 0.03 * noise[0],
        Z: 0.3 * follow(heat, 900.0, 30.0) + reaches[1] * lamp + 0.1 * noise[1],
    }
    return Record(time, columns, digest=f"lit {seed}")


@pytest.mark.slow
@pytest.mark.parametrize(("on", "off", "watts"), [(7000.0, 15000.0, 3.0), (9000.0, 99999.0, 3.0)])
def test_a_lamp_that_nobody_logged_is_told_with_both_its_instants(on, off, watts):
    plan = CalibrationPlan((HEAT,), (T,), (Z,))
    found = diagnose(calibrate([lit(0.0, 0.0, 0.0, 3)], plan), [lit(on, off, watts, 4)])
    (cause,) = found.causes
    told = cause.effect.parameters
    assert (cause.effect.name, cause.effect.channel) == ("second_source", "")
    assert told["start"] == pytest.approx(on, abs=200.0)
    assert ("stop" in told) is (off < 27000.0)
    assert told.get("stop", off) == pytest.approx(off, abs=200.0)
    assert told[f"gain[{T}]"] == pytest.approx(watts, rel=0.1)
    assert ("and off at" in cause.action) is (off < 27000.0)


@pytest.mark.slow
def test_a_lamp_that_was_on_before_is_told_as_switched_off():
    plan = CalibrationPlan((HEAT,), (T,), (Z,))
    found = diagnose(calibrate([lit(0.0, 0.0, 0.0, 3)], plan), [lit(9000.0, 99999.0, -3.0, 5)])
    (cause,) = found.causes
    assert cause.effect.name == "second_source"
    assert "switched off" in cause.action


@pytest.mark.slow
@pytest.mark.parametrize(("reaches", "named"), [((1.0, 0.0), True), ((0.0, 4.0), False)])
def test_a_lamp_may_reach_one_temperature_alone_and_no_displacement_alone(reaches, named):
    plan = CalibrationPlan((HEAT,), (T,), (Z,))
    lamp = lit(9000.0, 99999.0, 3.0, 4, reaches)
    found = diagnose(calibrate([lit(0.0, 0.0, 0.0, 3)], plan), [lamp])
    sources = [c.effect for c in found.causes if c.effect.name == "second_source"]
    assert not found.adequate
    assert bool(sources) is named
    for source in sources:
        assert source.parameters["start"] == pytest.approx(9000.0, abs=200.0)
        assert source.parameters[f"gain[{T}]"] == pytest.approx(3.0, rel=0.1)
        assert f"gain[{Z}]" not in source.parameters
        assert "No other output shows it" in found.causes[0].action


# ---------------------------------------------------------------- one output, many units

STEPS = np.repeat([0.0, 1.0, 0.3, 0.8, 0.0, 0.5, 1.0, 0.0], 100)
TIME = 5.0 * np.arange(800)


def plain(output: str, gain: float) -> Model:
    return Model(
        drives=(Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
        outputs=(Output(output, "deflection", "first", (-100.0, 100.0)),),
        terms=(Term(HEAT, output, Rational1(gain, 300.0, 0.0)),),
        sample_period=5.0,
    )


def fitted_causes(*truth, start):
    """Causes as they are fitted together to a log of the plain model with `truth`."""
    model = plain(Z, 40.0)
    second = np.repeat([0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0], 100)
    columns = {HEAT: STEPS, PUMP: second, FAN: np.roll(second, 50)}
    machine = replace(model, effects=truth)
    columns[Z] = machine.simulate(Record(TIME, columns))[Z]
    columns[Z] = columns[Z] + 0.1 * np.random.default_rng(9).standard_normal(len(TIME))
    log = Record(TIME, columns, digest="log")
    last = Hypothesis.of(replace(model, effects=start), [log], model, WITHIN_CALIBRATION)
    return fitted_together(last).model.effects


def source(channel: str, gain: float, lag: float):
    return effect_class("second_source")(channel, {f"gain[{Z}]": gain, "time_constant": lag})


def test_causes_move_to_what_each_is_beside_the_other():
    alone = source(PUMP, 13.0, 400.0), source(FAN, 6.0, 100.0)
    found = fitted_causes(source(PUMP, 8.0, 150.0), source(FAN, 6.0, 150.0), start=alone)
    assert [each.channel for each in found] == [PUMP, FAN]
    for each, size in zip(found, (8.0, 6.0), strict=True):
        assert each.parameters[f"gain[{Z}]"] == pytest.approx(size, rel=0.05)
        assert each.parameters["time_constant"] == pytest.approx(150.0, rel=0.2)


@pytest.mark.parametrize(("output", "unit"), [("d_z_um", 1.0), ("d_z_mm", 1e-3), ("d_z_m", 1e-6)])
def test_a_changed_gain_is_fitted_whatever_its_unit(output, unit):
    model = plain(output, 40.0 * unit)
    truth = plain(output, 52.0 * unit).simulate(Record(TIME, {HEAT: STEPS}))[output]
    noise = 0.1 * unit * np.random.default_rng(3).standard_normal(len(TIME))
    log = Record(TIME, {HEAT: STEPS, output: truth + noise}, digest="log")
    fitted = Hypothesis.of(model, [log], model, RELEASED).fitted().model.terms[0].response
    assert fitted.dc_gain() == pytest.approx(52.0 * unit, rel=0.01)


@pytest.mark.parametrize("watts", [1.0, 1000.0])
def test_a_source_behind_a_curved_sensor_is_fitted_whatever_its_unit(watts):
    """A unit of a gain in °C/W is a thousand degrees where the drive is 1000 W."""
    bent = effect_class("sensor_conversion")(T, {"gain": 1.0, "curvature": 2e-3})
    model = Model(
        drives=(Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
        outputs=(Output(T, "sensor", 20.0, (0.0, 40.0)),),
        terms=(Term(HEAT, T, Rational1(30.0, 300.0, 0.0)),),
        sample_period=5.0,
        effects=(bent,),
    )
    power = watts * np.repeat([0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0], 100)
    rise = 30.0 * follow(STEPS, 300.0, 5.0) + 5.0 * follow(power / watts, 200.0, 5.0)
    noise = 0.02 * np.random.default_rng(5).standard_normal(len(TIME))
    columns = {HEAT: STEPS, "Q_pump_W": power, T: 20.0 + rise + 2e-3 * rise**2 + noise}
    log = Record(TIME, columns, digest="log")
    here = Hypothesis.of(model, [log], model, RELEASED - {"released"})
    trial = effect_class("second_source")("Q_pump_W", {f"gain[{T}]": 0.0, "time_constant": 100.0})
    found = fit_candidate(here, CauseCandidate.unfitted(trial, here.assumptions)).effect
    assert watts * found.parameters[f"gain[{T}]"] == pytest.approx(5.0, rel=0.03)


# ---------------------------------------------------------------- readings


@pytest.mark.parametrize("step", [0.1, 0.5])
@pytest.mark.parametrize("spikes", [0, 12])
def test_a_coarse_sensor_has_no_outliers_but_its_own(step, spikes):
    rng = np.random.default_rng([4, spikes])
    time = 3.0 * np.arange(4000)
    heat = np.repeat([0.0, 1.0, 0.3, 0.8], 1000)
    truth = 20.0 + 5.0 * follow(heat, 900.0, 3.0)
    read = np.round((truth + 0.1 * step * rng.standard_normal(len(time))) / step) * step
    rows = rng.choice(np.arange(1100, 1900), spikes, replace=False)
    read[rows] += 20.0 * step
    model = Model(
        drives=(Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
        outputs=(Output(T, "sensor", 20.0, (0.0, 5.0)),),
        terms=(Term(HEAT, T, Rational1(5.0, 900.0, 0.0)),),
        sample_period=3.0,
    )
    log = Record(time, {HEAT: heat, T: read}, digest="log")
    found = find_outliers(Hypothesis.of(model, [log], model, WITHIN_CALIBRATION))
    masked = np.zeros(0) if found is None else np.flatnonzero(found.masked["log", T])
    assert masked.tolist() == sorted(rows)


def test_a_better_logger_is_judged_by_its_own_noise():
    model = plain(Z, 40.0)
    known = {"discrepancy": {"white_sigma": 1.0}}
    model = replace(model, outputs=tuple(replace(o, fit=known) for o in model.outputs))
    quiet = 0.1 * np.random.default_rng(8).standard_normal(len(TIME))
    y = model.simulate(Record(TIME, {HEAT: STEPS}))[Z] + quiet

    def white(readings: np.ndarray) -> float:
        log = Record(TIME, {HEAT: STEPS, Z: readings}, digest="log")
        return Hypothesis.of(model, [log], model, WITHIN_CALIBRATION).nuisance[Z].white

    assert white(y) == pytest.approx(0.1, rel=0.1)
    # One that stands still is no better.
    assert white(np.where(TIME > 600.0, y[120], y)) > 0.5


def test_leaving_readings_out_is_no_step_of_the_model():
    outliers = effect_class("outliers")(Z, {"share": 0.02, "amplitude": 5.0})
    pump = source(PUMP, 8.0, 150.0)
    before = plain(Z, 40.0)
    after = replace(plain(Z, 41.0), effects=(pump,))
    assert steps_of(before, after, [outliers, pump]) == [before, before, after]


# ---------------------------------------------------------------- logs of other lengths


def test_what_happens_in_a_short_log_is_as_short_beside_a_long_one():
    model = plain(Z, 40.0)
    short, long = (
        Record(TIME * k, {HEAT: STEPS, Z: 40.0 * STEPS}, digest=f"x{k}") for k in (1, 60)
    )
    step = effect_class("sensor_offset_step")(Z, {"step": 3.0, "time": 1500.0}, short.digest)
    alone, beside = (
        Hypothesis.of(model, logs, model, WITHIN_CALIBRATION).simulation.duration_of(step)
        for logs in ([short], [short, long])
    )
    assert alone == beside == short.duration


def test_nothing_that_limits_a_run_makes_it_shorter():
    for logged in (3600.0, 20 * 86400.0):
        assert UNLIMITED.longest(logged) >= USUAL_LIMITS.longest(logged)


@pytest.mark.parametrize(
    ("low", "high", "third", "said"),
    [
        (101.2, 102.8, 102.0, "102 °C"),
        (2950.0, 3050.0, 3000.0, "3000 °C"),
        (0.0, 1e-3, 5e-4, "0.0005 °C"),
        (0.0, 100.0, 50.0, "50 °C"),
    ],
)
def test_levels_are_rounded_by_what_lies_between_them(low, high, third, said):
    levels = ChannelLevels("T_bed_degC", low, low, high, 0.5)
    assert levels.third == pytest.approx(third)
    assert levels.say(levels.third) == said
    stairs = [levels.at(share) for share in (0.25, 0.5, 0.75)]
    assert len({*stairs, low, high}) == 5
    assert low < min(stairs) < max(stairs) < high
