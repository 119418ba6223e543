"""Commands that change between the rows of a log: when, nobody has written down."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.diagnosis.assumptions import released
from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.residual_budget import OutputResiduals, budget_of
from thermaltool.diagnosis.simulation import SimulatedLogs
from thermaltool.diagnosis.state import WITHIN_CALIBRATION, DiagnosisTask
from thermaltool.diagnosis.switching import MAX_SWITCHES, instants_of
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

HEAT, BEND = "Q_main_W", "d_z_um"
TAU, GAIN, NOISE = 900.0, 0.4, 0.02
TIME = 20.0 * np.arange(900)
# A command changes at these instants, some seconds before the row that shows it.
ROWS = np.arange(30, 880, 34)


def model() -> Model:
    output = Output(BEND, "deflection", "first", (0.0, 40.0), {"rmse": NOISE})
    term = Term(HEAT, BEND, Rational1(GAIN, TAU))
    return Model((Drive(HEAT, "zero", 0.0, (0.0, 100.0)),), (output,), (term,), 20.0)


def log(seed: int, early: float = 1.0, step: float = 0.0) -> Record:
    """A lag in its exact steps; commands act up to `early` rows before they are logged.

    After their rows where it is negative.
    """
    draw = np.random.default_rng([seed, 20261125])
    heat = np.zeros(len(TIME))
    before = early * draw.uniform(0.0, 1.0, len(ROWS))
    acting = np.zeros(len(TIME))
    levels = draw.uniform(0.0, 30.0, len(ROWS)) + 60.0 * (np.arange(len(ROWS)) % 2 == 0)
    for k, (row, level) in enumerate(zip(ROWS, levels, strict=True)):
        end = ROWS[k + 1] if k + 1 < len(ROWS) else len(TIME)
        heat[row:end], acting[row:end] = level, level
        acting[row - (early > 0)] += before[k] * (level - heat[row - 1])
    bend, kept = np.zeros(len(TIME)), np.exp(-20.0 / TAU)
    for k in range(1, len(TIME)):
        bend[k] = kept * bend[k - 1] + GAIN * (1 - kept) * acting[k - 1]
    bend += NOISE * draw.standard_normal(len(TIME)) + step * (TIME > 9000)
    return Record(TIME, {HEAT: heat, BEND: bend}, digest=f"log {seed}")


def first(record: Record) -> Hypothesis:
    return DiagnosisTask(model(), (record,), (), (), lambda message: None).first()


def test_a_column_is_what_an_earlier_switch_changes():
    record = replace(log(1, early=0.0), digest="one")
    columns = instants_of(SimulatedLogs(model(), (record,), {}), BEND)
    assert len(columns) == len(ROWS)
    sooner = record.columns[HEAT].copy()
    # A whole row earlier; the column is that of a standard deviation.
    sooner[ROWS[3] - 1] = sooner[ROWS[3]]
    moved = model().simulate(record.with_columns({HEAT: sooner}))[BEND]
    change = moved - model().simulate(record)[BEND]
    assert columns[3][0] * np.sqrt(12.0) == pytest.approx(change, abs=1e-3 * np.ptp(change))


def test_instants_are_free_where_the_log_asks_for_them():
    # This model has commands that switch at the rows: all are earlier together, too.
    assert first(log(2)).assumptions == WITHIN_CALIBRATION | {"instants", "earlier"}
    assert first(log(2, early=0.0)).assumptions == WITHIN_CALIBRATION


def test_what_switching_explains_is_no_cause():
    found = diagnose(model(), [log(3)])
    assert found.causes == ()
    assert found.verdict == "adequate"
    assert any("between the rows" in note for note in found.notes)


def test_switching_is_no_misfit_of_a_model_that_is_free():
    found = first(log(3))
    free = found.under(released(found.assumptions), model())
    left = OutputResiduals.of(free, free, BEND)
    budget = budget_of(free, free, (BEND, 0), left, NOISE, 100.0)
    assert budget.total > 2 * NOISE
    assert budget.unexplained == pytest.approx(NOISE, rel=0.2)
    assert not budget.wrong


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6, 7])
def test_commands_that_act_late_are_a_cause(seed, monkeypatch):
    monkeypatch.setitem(globals(), "NOISE", 0.1)
    # Half a row in the mean, which no instant before the row explains.
    (cause,) = diagnose(model(), [log(seed, early=-1.0)]).causes
    # Of a single displacement sticking looks much the same.
    assert cause.effect.name in ("transport_delay", "stick_slip")
    assert cause.effect.parameters.get("delay", 10.0) == pytest.approx(10.0, abs=1.0)


@pytest.mark.slow
def test_a_step_is_found_beside_switches():
    found = diagnose(model(), [log(4, step=0.3)])
    assert [c.effect.name for c in found.causes] == ["geometry_step"]
    assert found.causes[0].effect.parameters["step[d_z_um]"] == pytest.approx(0.3, abs=0.03)


def test_a_pause_is_no_switch():
    record = log(1)
    paused = record.where(~((20.0 * ROWS[3] - 200.0 < TIME) & (20.0 * ROWS[3] > TIME)))
    assert len(instants_of(SimulatedLogs(model(), (paused,), {}), BEND)) == len(ROWS) - 1


def test_a_heater_that_is_pulsed_is_no_command():
    heat = 100.0 * (np.arange(len(TIME)) % 2)
    pulsed = Record(TIME, {HEAT: heat, BEND: heat}, digest="pulsed")
    assert instants_of(SimulatedLogs(model(), (pulsed,), {}), BEND) == []
    many = 100.0 * (np.arange(len(TIME)) // 8 % 2)
    often = Record(TIME, {HEAT: many, BEND: many}, digest="often")
    assert len(instants_of(SimulatedLogs(model(), (often,), {}), BEND)) == MAX_SWITCHES
