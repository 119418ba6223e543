"""Delays on an irregular clock, and logs that begin while the machine is still warm."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from machines.post import (
    DEFLECTIONS,
    DRIVE,
    SENSORS,
    WHITE,
    Course,
    Post,
    duty,
    even,
    logged,
    read,
    uneven,
)

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.effects import effect_class
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import relative
from thermaltool.record import Record

SEED = 20261122
KINDS = dict.fromkeys(SENSORS, "conduction") | dict.fromkeys(DEFLECTIONS, "deflection")
PLAN = CalibrationPlan((DRIVE,), SENSORS, DEFLECTIONS, KINDS)


def log_of(post, seed, time, delay=0.0, name="", start=None):
    """What is logged of a duty that acts `delay` later, from a state at the first row."""
    course = duty(seed, time)
    outputs = read(post.outputs(post.simulate(time, course.later(delay), start)), seed)
    return Record(time, {DRIVE: logged(course, time), **outputs}, digest=name)


@cache
def machine(irregular):
    post = Post(SEED)
    time = uneven(SEED) if irregular else even()
    return post, calibrate([log_of(post, SEED, time, name="calibration")], PLAN)


@pytest.mark.slow
@pytest.mark.parametrize("irregular", [False, True], ids=["even", "irregular"])
def test_a_delay_is_found_on_any_clock(irregular):
    post, model = machine(irregular)
    time = uneven(SEED + 1) if irregular else even()
    log = log_of(post, SEED + 1, time, 50.0, "diagnosed")
    found = diagnose(model, [log])
    assert [(c.effect.name, c.effect.channel) for c in found.causes] == [("transport_delay", DRIVE)]
    assert found.causes[0].effect.parameters["delay"] == pytest.approx(50.0, abs=1.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "irregular", [pytest.param(False, marks=pytest.mark.slow), True], ids=["even", "irregular"]
)
def test_a_known_delay_leaves_what_no_delay_leaves(irregular):
    post, model = machine(irregular)
    time = uneven(SEED + 2) if irregular else even()
    known = effect_class("transport_delay")(DRIVE, {"delay": 50.0})
    left = {}
    for delay, effects in ((0.0, ()), (50.0, (known,))):
        log = log_of(post, SEED + 2, time, delay, "later")
        simulated = replace(model, effects=effects).simulate(log)
        left[delay] = {
            o.channel: float(
                np.std(relative(log.columns[o.channel], o.offset) - simulated[o.channel])
            )
            for o in model.outputs
        }
    for output, white in WHITE.items():
        assert left[50.0][output] == pytest.approx(left[0.0][output], abs=0.3 * white)


def warm(post, on, off):
    """The state after so long under heat and so long without [s]."""
    heated = Course(np.array([0.0, on]), np.array([0.8, 0.0]))
    return post.simulate(np.array([0.0, on, on + max(off, 1e-3)]), heated)[-1]


@pytest.mark.slow
@pytest.mark.parametrize(("on", "off"), [(6000.0, 0.0), (1500.0, 0.0), (6000.0, 1200.0)])
def test_a_warm_start_is_a_state_and_no_cause(on, off):
    post, model = machine(False)
    log = log_of(post, SEED + 3, even(), start=warm(post, on, off), name="warm")
    found = diagnose(model, [log])
    assert found.causes == ()
    # The kinds of response follow this post to some times its noise: no model of it is adequate.
    assert found.verdict != "not adequate"
    assert any("does not begin at rest" in note for note in found.notes)


@pytest.mark.slow
def test_a_cause_is_found_beside_a_warm_start():
    post, model = machine(False)
    log = log_of(post, SEED + 4, even(), 50.0, "both", warm(post, 3000.0, 300.0))
    found = diagnose(model, [log])
    assert [c.effect.name for c in found.causes] == ["transport_delay"]
    assert found.causes[0].effect.parameters["delay"] == pytest.approx(50.0, abs=2.0)
