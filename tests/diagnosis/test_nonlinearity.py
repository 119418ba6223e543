"""A machine that is not linear: what is left is called so, and no cause stands for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machines.stateful import levels

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.nonlinearity import (
    explains_more,
    is_bent,
    nonlinearity,
    stands_for_another,
)
from thermaltool.effects import effect_class
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import rational_kind

HEAT, READ, MOVED = "Q_main_1", "dT_pair1_K", "d_y_um"


def logged(seed: int, bent: bool, rows: int = 1000) -> Record:
    """Two lags in a row behind a heater, read by a sensor that is steep in the middle, or not."""
    generator = np.random.default_rng(seed)
    heat = levels(generator, rows, 0, 1, 15, 80)
    heat[:15] = 0.0
    x, found = np.zeros(2), np.empty(rows)
    for k, q in enumerate(heat):
        found[k] = x[1]
        x = x + 3.0 * np.array([(q - x[0]) / 100, (x[0] - x[1]) / 50])
    read = 10 + 8 * np.tanh(5 * (found - 0.5)) if bent else 20 * found
    read = read - read[0] + 0.05 * generator.standard_normal(rows)
    return Record(3.0 * np.arange(rows), {HEAT: heat, READ: read}, digest=f"log {seed} {bent}")


@pytest.fixture(scope="module")
def model() -> Model:
    response = rational_kind(2, 0, False)(tau1=100.0, tau2=50.0, K1=40.0, K2=-20.0)
    return Model(
        (Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
        (Output(READ, "sensor", 0.0, (0.0, 20.0)),),
        (Term(HEAT, READ, response),),
        3.0,
    )


def test_a_curve_behind_the_dynamics_is_seen(model: Model) -> None:
    bent, straight = (nonlinearity(model, [logged(4, curved)], READ) for curved in (True, False))
    assert is_bent(bent)
    assert not is_bent(straight)


def test_what_bends_nothing_stands_for_another(model: Model) -> None:
    before = nonlinearity(model, [logged(4, True)], READ)
    swings = effect_class("periodic")("", {"period": 100.0})
    bends = effect_class("drive_nonlinearity")(HEAT, {"exponent": 2.0, "level": 1.0})
    assert stands_for_another(swings, before, None)
    # It has taken all of that, or nothing.
    assert not stands_for_another(bends, before, None)
    assert stands_for_another(bends, before, before)
    # Most of what is left is no curve any more.
    assert not stands_for_another(bends, before, replace(before, explained=0.4))
    straight = nonlinearity(model, [logged(4, False)], READ)
    assert not stands_for_another(swings, straight, straight)


def test_a_channel_that_the_model_lacks_is_tried_beside_the_products(model: Model) -> None:
    log = logged(4, False)
    fan, idle = (levels(np.random.default_rng(k), len(log), 0, 1, 30, 90) for k in (5, 6))
    slow, heats = 0.0, []
    for on in fan:
        slow += 3.0 / 150 * (on - slow)
        heats.append(8 * slow)
    log = log.with_columns({READ: log.column(READ) + heats, "x_fan_1": fan, "x_door_1": idle})
    alone = nonlinearity(model, [log], READ)
    assert explains_more(alone, nonlinearity(model, [log], READ, ["x_fan_1"]))
    curved = logged(4, True).with_columns({"x_door_1": idle})
    bent = nonlinearity(model, [curved], READ)
    assert not explains_more(bent, nonlinearity(model, [curved], READ, ["x_door_1"]))


def test_too_few_rows_say_nothing(model: Model) -> None:
    log = logged(4, True).rows(slice(0, 30))
    assert nonlinearity(model, [log], READ) is None


@pytest.mark.slow
def test_no_period_is_named_for_a_curve() -> None:
    log = logged(1, True)
    model = calibrate([log], CalibrationPlan((HEAT,), (READ,), (), {READ: "rational2"}))
    found = diagnose(model, [log])
    assert not found.adequate
    assert {cause.effect.name for cause in found.causes} <= {"unknown"}


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["geometry_step", "sensor_offset_step"])
def test_a_curve_that_the_calibration_left_keeps_no_cause_from_being_named(effect: str) -> None:
    """A thermometer a little bent, as calibrated: what jumps later is named."""

    def curved(seed: int) -> Record:
        log = logged(seed, False)
        read, moved = log.column(READ), 0.2 * log.column(READ)
        noise = 0.02 * np.random.default_rng([9, seed]).standard_normal(len(log))
        return log.with_columns({READ: read + 0.02 * read * (20 - read), MOVED: moved + noise})

    kinds = {READ: "rational2", MOVED: "rational2"}
    model = calibrate([curved(1)], CalibrationPlan((HEAT,), (READ,), (MOVED,), kinds))
    log = curved(2)
    channel = MOVED if effect == "geometry_step" else READ
    jump = (0.3 if channel == MOVED else 3.0) * (log.time > 0.6 * log.duration)
    found = diagnose(model, [log.with_columns({channel: log.column(channel) + jump})])
    assert found.causes[0].effect.name == effect
    assert not any("stands for what it is not" in note for note in found.notes)
