"""Schedules and curves in a stream: line by line what a simulation gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.effects.curve import DriveCurve
from thermaltool.errors import ModelError
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.known_inputs import Feedforward
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.model import Drive, Model, Output, Term, dumps, loads
from thermaltool.model.combine import scheduled, superposed
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1, Rational2
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.settings import Settings

HEAT, WARM, ROOM, ANGLE = "Q_heater_W", "T_causal_degC", "T_room_degC", "phi_x_urad"
RNG = np.random.default_rng(12)
TIME = 60.0 * np.arange(300)
LOG = {
    HEAT: np.repeat(RNG.choice([0.0, 10.0, 25.0, 40.0, 55.0, 70.0], 20), 15),
    WARM: 21.0 + np.cumsum(RNG.standard_normal(300)),
    ROOM: 20.0 + np.sin(TIME / 3000),
}


def member(level, gain, tau):
    return Model(
        (Drive(HEAT, "zero", 0.0, (0.0, level)),),
        (Output(ANGLE, "deflection", "first", (-300.0, 300.0)),),
        (Term(HEAT, ANGLE, Rational2(gain, tau, 0.3, 5 * tau)),),
        60.0,
    )


BY_LEVEL = scheduled([member(20.0, 3.0, 900.0), member(60.0, 4.0, 600.0)], HEAT)
BY_ROOM = scheduled([member(20.0, 3.0, 900.0), member(60.0, 4.0, 600.0)], ROOM, [19.5, 20.5])
CAUSAL = Model(
    (Drive(WARM, "first", "first", (0.0, 20.0)),),
    (Output(ANGLE, "deflection", "first", (-300.0, 300.0)),),
    (Term(WARM, ANGLE, Rational1(-12.0, 300.0, 90.0)),),
    60.0,
)
CURVE = DriveCurve(HEAT, {"level": 70.0, "c1": 0.3, "c2": 0.7})
MODELS = {
    "by its drive": BY_LEVEL,
    "by another channel": BY_ROOM,
    "beside another drive": superposed([CAUSAL, BY_LEVEL]),
    "with a curve": replace(BY_LEVEL, effects=(CURVE,)),
    "by a drive that it does not take": replace(
        superposed([CAUSAL, BY_ROOM]),
        terms=tuple(
            replace(t, band=replace(t.band, channel=WARM, levels=(0.0, 5.0))) if t.band else t
            for t in superposed([CAUSAL, BY_ROOM]).terms
        ),
    ),
}


def designed(model):
    machine = DesignModel.of(model, {}, 60.0)
    estimator = machine.finished(Feedforward(machine.outputs))
    return loads(dumps(model.with_design(estimator.document())))


def streamed(model, rows, resume_at=None):
    """Estimates line by line; halfway by a second process that takes the state over."""
    each = offsets(model, Settings(), Messages(print))
    names, told = EstimatorPipeline.of(model).columns, []
    for k in rows:
        if k == resume_at:
            state = each.state()
            each = offsets(model, Settings(), Messages(print))
            each.resume(state)
        values = [float(LOG[c][k]) for c in names]
        each.take(Row(float(TIME[k]), values, ("",) * len(names)))
        told.append(each.estimates[0])
    return np.array(told)


@pytest.mark.parametrize("name", MODELS)
def test_batch_is_stream_is_simulation(name):
    model = designed(MODELS[name])
    expected = model.simulate(Record(TIME, LOG))[ANGLE]
    assert np.ptp(expected) > 50
    pipeline = EstimatorPipeline.of(model)
    batch = pipeline.run(TIME, pipeline.true_values(LOG))[:, 0]
    np.testing.assert_allclose(batch, expected, atol=1e-8)
    got = streamed(model, range(len(TIME)), resume_at=140)
    np.testing.assert_allclose(got, expected, atol=1e-8)


def test_a_scheduled_drive_is_read_once():
    assert EstimatorPipeline.of(designed(BY_LEVEL)).columns == (HEAT,)
    assert EstimatorPipeline.of(designed(MODELS["beside another drive"])).columns == (WARM, HEAT)


def test_a_scheduled_drive_cannot_be_estimated():
    sensor = Output("T_near_degC", "sensor", 20.0, (0.0, 50.0))
    both = replace(
        BY_LEVEL,
        outputs=(*BY_LEVEL.outputs, sensor),
        terms=(*BY_LEVEL.terms, Term(HEAT, "T_near_degC", Rational1(1.0, 60.0))),
    )
    with pytest.raises(ModelError, match=r"schedule of transfer functions.* --measured Q_heater_W"):
        DesignModel.of(both, {}, 60.0)
