"""Deflections of measured drives beside a loss of heat that goes by one of them: as simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.effects import effect_class
from thermaltool.effects.band import ScheduleBand
from thermaltool.errors import ModelError
from thermaltool.estimation.design import design_estimator
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import rational_kind
from thermaltool.runtime.stepper import stepper_of

HEAT, FLOW, HOT, BENT = "Q_a_W", "x_flow_1", "T_hot_degC", "d_z_um"
BOTH = (HEAT, FLOW)
TIME = 10.0 * np.arange(200)


def machine() -> Model:
    """Gains and loss rate by two levels of the flow, a power of the heater's drive."""

    def term(drive: str, level: int, gain: float) -> Term:
        response = rational_kind(2, 0, False)(tau1=400.0, tau2=60.0, K1=gain, K2=gain / 3)
        return Term(drive, BENT, response, band=ScheduleBand(FLOW, (0.0, 8.0), level))

    table = {"level0": 0.0, "rate0": 0.0, "level1": 8.0, "rate1": 4e-3}
    effects = (
        effect_class("convection_state")(FLOW, table),
        effect_class("drive_nonlinearity")(HEAT, {"exponent": 1.5, "level": 100.0}),
    )
    drives = tuple(Drive(name, "zero", 0.0, (0.0, 100.0)) for name in BOTH)
    terms = (*(term(HEAT, k, 0.3 - 0.1 * k) for k in range(2)), term(FLOW, 0, -1.0),
             term(FLOW, 1, -2.0))  # fmt: skip
    return Model(drives, (Output(BENT, "deflection", "first", (0.0, 50.0)),), terms, 10.0,
                 effects=effects)  # fmt: skip


def record() -> Record:
    generator = np.random.default_rng(20261130)
    heat, flow = (np.repeat(generator.uniform(0, top, 20), 10) for top in (100, 8))
    return Record(TIME, {HEAT: heat, FLOW: flow})


def pipeline_of(model: Model, measured: tuple[str, ...] = BOTH) -> EstimatorPipeline:
    problem = DesignModel.of(model, {}, 10.0, measured)
    return EstimatorPipeline.of(design_estimator(model, problem).model)


def test_a_record_is_estimated_as_it_is_simulated() -> None:
    model, log = machine(), record()
    pipeline = pipeline_of(model)
    got = pipeline.run(log.time, pipeline.true_values(log.columns))[:, 0]
    np.testing.assert_allclose(got, model.simulate(log)[BENT], rtol=1e-9, atol=1e-9)


def test_a_stream_is_the_same_and_goes_on_from_its_state() -> None:
    model, log = machine(), record()
    pipeline = pipeline_of(model)
    taken = np.column_stack(pipeline.estimator_inputs([*pipeline.true_values(log.columns).T]))
    stepper = stepper_of(pipeline.estimator, 10.0)
    got = [stepper.start(taken[0].tolist())[0]]
    for k, row in enumerate(taken[1:]):
        if k == 90:
            state, stepper = stepper.state(), stepper_of(pipeline.estimator, 10.0)
            stepper.resume(state)
        got.append(stepper.step(10_000_000_000, row.tolist())[0])
    np.testing.assert_allclose(got, model.simulate(log)[BENT], rtol=1e-9, atol=1e-9)


def test_a_settled_machine_stays() -> None:
    pipeline = pipeline_of(machine())
    still = {HEAT: np.full(50, 60.0), FLOW: np.full(50, 5.0)}
    got = pipeline.run(TIME[:50], pipeline.true_values(still), settled=True)[:, 0]
    assert np.ptp(got) < 1e-9
    assert abs(got[0]) > 1.0


def radiating(rise: float = 0.0, delay: float = 25.0) -> Model:
    """A heater behind a dead time; the loss goes by a temperature that is not given out."""
    hot = rational_kind(2, 0, False)(tau1=900.0, tau2=90.0, K1=0.6, K2=0.4, delay=delay)
    bent = rational_kind(2, 0, False)(tau1=900.0, tau2=300.0, K1=0.5, K2=0.2)
    effects = [effect_class("radiation")(HOT, {"rate": 4e-4, "rest": 20.0}),
               effect_class("natural_convection")(HOT, {"rate": 4e-4, "level": 80.0})]  # fmt: skip
    if rise:
        effects.append(effect_class("heat_capacity")(HOT, {"rise": rise, "level": 80.0}))
    outputs = (Output(HOT, "sensor", "first", (0.0, 90.0)), Output(BENT, "deflection", "first",
                                                                   (0.0, 60.0)))  # fmt: skip
    return Model((Drive(HEAT, "zero", 0.0, (0.0, 100.0)),),
                 outputs, (Term(HEAT, HOT, hot), Term(HEAT, BENT, bent)), 10.0,
                 effects=tuple(effects))  # fmt: skip


@pytest.mark.parametrize(("rise", "delay", "off"), [(0.0, 25.0, 1e-6), (0.5, 0.0, 0.005),
                                                    (-0.3, 0.0, 0.005)])  # fmt: skip
def test_a_loss_by_an_output_is_followed(rise: float, delay: float, off: float) -> None:
    """The time of its own goes in steps, by which a course is off a little."""
    model, log = radiating(rise, delay), record()
    expected = model.simulate(log)[BENT]
    pipeline = pipeline_of(model, (HEAT,))
    assert pipeline.estimator.estimates == (BENT,)
    got = pipeline.run(log.time, pipeline.true_values(log.columns))[:, 0]
    np.testing.assert_allclose(got, expected, atol=off * np.ptp(expected))
    linear = replace(model, effects=()).simulate(log)[BENT]
    assert np.max(np.abs(linear - expected)) > 0.03 * np.ptp(expected)
    taken = np.column_stack(pipeline.estimator_inputs([*pipeline.true_values(log.columns).T]))
    stepper = stepper_of(pipeline.estimator, 10.0)
    stream = [stepper.start(taken[0].tolist())]
    stream += [stepper.step(10_000_000_000, row.tolist()) for row in taken[1:]]
    np.testing.assert_allclose(np.array(stream)[:, 0], got, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("rise", "delay"), [(0.0, 25.0), (0.5, 0.0), (-0.4, 0.0)])
def test_a_settled_machine_stays_by_its_own_output(rise: float, delay: float) -> None:
    model = radiating(rise, delay)
    pipeline = pipeline_of(model, (HEAT,))
    still = {HEAT: np.full(200, 60.0)}
    got = pipeline.run(TIME, pipeline.true_values(still), settled=True)[:, 0]
    assert np.ptp(got) < 1e-3
    long = 10.0 * np.arange(4000)
    step = np.where(long > 0, 60.0, 0.0)
    assert got[0] == pytest.approx(model.simulate(Record(long, {HEAT: step}))[BENT][-1], rel=3e-3)


def test_a_pace_beside_a_dead_time_is_refused() -> None:
    with pytest.raises(ModelError, match="dead time of a measured drive; calibrate --linear"):
        pipeline_of(radiating(0.1), (HEAT,))


def test_a_loss_by_what_is_not_there_is_refused() -> None:
    effect = effect_class("radiation")("T_a_degC", {"rate": 1e-3, "rest": 20.0})
    with pytest.raises(ModelError, match="no output tells the state"):
        pipeline_of(replace(machine(), effects=(effect,)))
