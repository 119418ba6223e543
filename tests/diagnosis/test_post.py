"""What is hidden in the post is named, one cause of each kind, on clocks as they come.

One seed, the date of this file; no other was tried for these tests.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from machines import post_faults as faults
from machines.post import (
    DEFLECTIONS,
    DRIVE,
    FAR,
    NEAR,
    RISE,
    SENSORS,
    Post,
    duty,
    even,
    logged,
    read,
)

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.record import Record

SEED = 20261122
TIME = even()


def log_of(seed, acts=lambda course: course, change=None, beside=None, name="log", start=None):
    """A log of a duty, with what acts in place of the course and what is read of the outputs."""
    course = duty(seed, TIME)
    outputs = POST.outputs(POST.simulate(TIME, acts(course), start, beside))
    for output, changed in (change or {}).items():
        outputs[output] = changed(outputs[output])
    return Record(TIME, {DRIVE: logged(course, TIME), **read(outputs, seed)}, digest=name)


POST = Post(SEED)


@cache
def model():
    kinds = dict.fromkeys(SENSORS, "conduction") | dict.fromkeys(DEFLECTIONS, "deflection")
    plan = CalibrationPlan((DRIVE,), SENSORS, DEFLECTIONS, kinds)
    return calibrate([log_of(SEED, name="calibration")], plan)


def first_cause(log):
    found = diagnose(model(), [log])
    assert found.causes, found.notes
    return found.causes[0]


@pytest.mark.slow
def test_a_clean_log_has_no_cause():
    found = diagnose(model(), [log_of(SEED + 1)])
    assert not found.causes
    assert found.verdict != "not adequate"


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.9, 1.15])
def test_a_gain_of_the_drive(gain):
    cause = first_cause(log_of(SEED + 2, lambda course: faults.scaled(course, gain)))
    assert (cause.effect.name, cause.effect.channel) == ("drive_gain", DRIVE)
    assert cause.effect.parameters["gain"] == pytest.approx(gain, abs=0.01)


@pytest.mark.slow
def test_a_gain_of_the_drive_from_an_instant_on():
    course = duty(SEED + 3, TIME)
    truth = faults.scaled(course, 0.8, 4200.0)
    cause = first_cause(log_of(SEED + 3, lambda course: truth))
    assert (cause.effect.name, cause.effect.channel) == ("drive_gain_step", DRIVE)
    assert cause.effect.parameters["gain"] == pytest.approx(0.8, abs=0.02)
    # While the heater is off, one instant is as good as another.
    named = faults.scaled(course, 0.8, cause.effect.parameters["time"])
    assert np.mean(logged(named, TIME) != logged(truth, TIME)) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("law", [faults.sticking, faults.slipping])
def test_a_slide_that_sticks(law):
    cause = first_cause(log_of(SEED + 4, change={RISE: lambda y: law(y, 2.0)}))
    assert (cause.effect.name, cause.effect.channel) == ("stick_slip", RISE)
    if law is faults.sticking:
        assert cause.effect.parameters["width"] == pytest.approx(4.0, rel=0.1)


@pytest.mark.slow
def test_a_fan_that_nobody_logs():
    cause = first_cause(log_of(SEED + 5, beside=faults.fan(POST, 1.6, 12.0, 3.0)))
    assert cause.effect.name == "switching_loss"
    assert cause.effect.parameters["on"] == pytest.approx(12.0, abs=1.5) or (
        cause.effect.channel == FAR
    )


@pytest.mark.slow
def test_a_thermometer_that_warms_itself():
    change = {NEAR: lambda y: faults.self_heated(TIME, y, 0.4, 90.0)}
    cause = first_cause(log_of(SEED + 6, change=change))
    assert (cause.effect.name, cause.effect.channel) == ("sensor_self_heating", NEAR)
    assert cause.effect.parameters["rise"] == pytest.approx(0.4, rel=0.15)


@pytest.mark.slow
def test_a_channel_that_is_handed_on_late():
    change = {NEAR: lambda y: np.interp(TIME - 25.0, TIME, y)}
    cause = first_cause(log_of(SEED + 10, change=change))
    assert (cause.effect.name, cause.effect.channel) == ("logger_clock", NEAR)
    assert cause.effect.parameters["offset"] == pytest.approx(25.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("loud", [0.03, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_heater_that_is_heard_in_a_line(loud):
    on = logged(duty(SEED + 9, TIME), TIME) > 0.3
    heard = loud * on * np.random.default_rng(SEED + 9).standard_normal(len(TIME))
    found = diagnose(model(), [log_of(SEED + 9, change={NEAR: lambda y: y + heard})])
    named = [(c.effect.name, c.effect.channel, c.effect.partner) for c in found.causes]
    assert named == ([("noise_state", NEAR, DRIVE)] if loud else [])
    # No misfit of the model.
    assert found.verdict != "not adequate"
    assert found.model == model()
    for cause in found.causes:
        assert cause.effect.parameters["quiet"] == pytest.approx(0.01, rel=0.15)
        assert cause.effect.parameters["loud"] == pytest.approx(np.hypot(0.01, loud), rel=0.15)


@pytest.mark.slow
def test_sensors_that_are_swapped_though_one_hardly_moves():
    log = log_of(SEED + 8)
    near, far = (log.columns[name] for name in (NEAR, FAR))
    swapped = Record(TIME, {**log.columns, NEAR: far, FAR: near}, digest="log")
    assert np.ptp(near) > 2.5 * np.ptp(far)
    assert first_cause(swapped).effect.name == "sensors_swapped"


@pytest.mark.slow
@pytest.mark.parametrize("offset", [40.0, -40.0])
def test_a_logger_that_is_late_or_early(offset):
    """The temperatures are those of another moment; exactly, not between rows."""
    course = duty(SEED + 7, TIME)
    both = np.unique(np.concatenate([TIME, np.maximum(TIME - offset, 0.0)]))
    outputs = POST.outputs(POST.simulate(both, course))
    rows, moved = (np.searchsorted(both, np.maximum(t, 0.0)) for t in (TIME, TIME - offset))
    outputs = {name: y[moved if name in SENSORS else rows] for name, y in outputs.items()}
    log = Record(TIME, {DRIVE: logged(course, TIME), **read(outputs, SEED + 7)}, digest="log")
    cause = first_cause(log)
    assert cause.effect.name == "logger_clock"
    sign = 1.0 if cause.effect.channel in SENSORS else -1.0
    assert sign * cause.effect.parameters["offset"] == pytest.approx(offset, abs=3.0)
