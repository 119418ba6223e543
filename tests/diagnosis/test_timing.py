"""Delays on an irregular clock, found and run by the written model."""

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
    Post,
    duty,
    even,
    logged,
    read,
    uneven,
)

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.effects import effect_class
from thermaltool.fitting.calibrate import CalibrationPlan, calibrate
from thermaltool.model import relative
from thermaltool.record import Record

SEED = 20261122
PLAN = CalibrationPlan((DRIVE,), SENSORS, DEFLECTIONS)


def log_of(post, seed, time, delay=0.0, name=""):
    """What is logged of a duty that acts `delay` later."""
    course = duty(seed, time)
    outputs = read(post.outputs(post.simulate(time, course.later(delay))), seed)
    return Record(time, {DRIVE: logged(course, time), **outputs}, digest=name)


@cache
def machine(irregular):
    post = Post(SEED)
    time = uneven(SEED) if irregular else even()
    return post, calibrate([log_of(post, SEED, time, name="calibration")], PLAN)


@pytest.mark.parametrize(
    "irregular", [pytest.param(False, marks=pytest.mark.slow), True], ids=["even", "irregular"]
)
def test_a_delay_is_found_on_any_clock(irregular):
    post, model = machine(irregular)
    time = uneven(SEED + 1) if irregular else even()
    log = log_of(post, SEED + 1, time, 50.0, "diagnosed")
    found = diagnose(model, [log])
    assert [(c.effect.name, c.effect.channel) for c in found.causes] == [("transport_delay", DRIVE)]
    assert found.causes[0].effect.parameters["delay"] == pytest.approx(50.0, abs=1.5)


@pytest.mark.parametrize("irregular", [False, True], ids=["even", "irregular"])
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
