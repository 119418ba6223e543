"""Slopes of a model: those of the whole model simulated again, and each of them simulated once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effects.machine import (
    BEARING,
    COLUMN,
    COOLANT,
    NEAR,
    RESPONSES,
    X,
    columns,
    first_order,
    model,
)

from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.simulation import SimulatedLogs
from thermaltool.diagnosis.state import RELEASED
from thermaltool.effects import effect_class
from thermaltool.effects.convection_state import ConvectionState
from thermaltool.model import Drive, Term
from thermaltool.record import Record

FAN = effect_class("convection_state")(
    COOLANT,
    {
        "fast[dT_near_K]": -0.3,
        "slow[dT_near_K]": -0.1,
        "slow[d_x_um]": 2.0,
        "time_constant": 150.0,
        "slowest": 900.0,
        "level": 1.0,
    },
    partner=NEAR,
)
# Causes of every kind that what the terms give goes through: none, outputs alone, outputs together,
# and the loss of heat.
CAUSES = {
    "none": (),
    "bent": (effect_class("joint_contact")(X, {"curvature": 0.01}),),
    "lost at one place": (FAN,),
    "joined": (
        effect_class("joint_contact")(
            NEAR,
            {"forces[d_x_um]": 6.0, "heat[d_x_um]": 2.0, "time_constant": 400.0, "level": 10.0},
        ),
    ),
    "lost everywhere": (
        effect_class("convection_state")(COOLANT, {"rate": 1e-3, "level": 1.0, "idle": 0.0}),
    ),
}


def runs(*effects):
    """A machine with two drives on an uneven clock."""
    plain = model(*effects)
    terms = [Term(BEARING, o, first_order(5.0, 1 / 300)) for o in RESPONSES]
    machine = replace(
        plain,
        drives=(*plain.drives, Drive(BEARING, "zero", 0.0, (0.0, 1.0))),
        terms=(*plain.terms, *terms),
    )
    time, logged = columns(extra=(BEARING, COOLANT), frozen=False)
    time[1:] += np.random.default_rng(4).uniform(-1.5, 1.5, len(time) - 1)
    return SimulatedLogs(machine, (Record(time, logged, digest="log"),), {})


@pytest.mark.parametrize("name", CAUSES)
def test_a_slope_is_that_of_the_whole_model(name):
    simulation = runs(*CAUSES[name])
    machine = simulation.model
    for at, term in enumerate(machine.terms):
        if term.output not in (NEAR, X):
            continue
        moved = replace(term.response, A=term.response.A + 0.5)
        terms = [*machine.terms[:at], replace(term, response=moved), *machine.terms[at + 1 :]]
        (whole,) = simulation.with_effects(model=replace(machine, terms=tuple(terms)))
        expected = (whole[term.output] - simulation.outputs[0][term.output]) / 0.5
        (slope,) = simulation.slopes.of_term(at, "A", moved, 0.5)
        np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-9 * np.ptp(expected))


def test_slopes_do_not_hang_on_what_else_is_free():
    """The same arrays under other assumptions: nothing is simulated twice."""
    simulation = runs()
    one = Hypothesis(simulation, simulation.model, RELEASED)
    other = replace(one, assumptions=RELEASED | {"initial"})
    for a, b in zip(
        one.nuisance[NEAR].sensitivities, other.nuisance[NEAR].sensitivities, strict=True
    ):
        assert a is b


def test_a_loss_at_one_place_is_worked_out_once_for_all_outputs(monkeypatch):
    simulation, calls, plain = runs(FAN), [], ConvectionState.state

    def counted(self, record, memory=None):
        calls.append(record)
        return plain(self, record, memory)

    monkeypatch.setattr(ConvectionState, "state", counted)
    (outputs,), log = simulation.outputs, simulation.logs[0]
    assert len(calls) == 1
    for name, y in simulation.responses[0].items():
        np.testing.assert_array_equal(outputs[name], FAN.output(name, {name: y}, log))
    assert np.array_equal(outputs[COLUMN], simulation.responses[0][COLUMN])
