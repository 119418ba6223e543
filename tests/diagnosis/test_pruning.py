"""Causes that do not stand beside the others are taken out again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.pruning import pruned
from thermaltool.diagnosis.result import Cause
from thermaltool.diagnosis.state import WITHIN_CALIBRATION, DiagnosisTask, SearchState
from thermaltool.effects import effect_class
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

HEAT, ONE, OTHER, Z = "Q_main_1", "U_one_V", "U_other_V", "d_z_um"
TIME = 5.0 * np.arange(800)
MODEL = Model(
    drives=(Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
    outputs=(Output(Z, "deflection", "first", (-100.0, 100.0)),),
    terms=(Term(HEAT, Z, Rational1(40.0, 300.0, 0.0)),),
    sample_period=5.0,
)


def source(channel: str, gain: float):
    return effect_class("second_source")(channel, {f"gain[{Z}]": gain, "time_constant": 50.0})


def found(*effects, truth=()):
    """The search for causes in a log of the model with `truth`, with such causes accepted."""
    heat = np.repeat([0.0, 1.0, 0.3, 0.8, 0.0, 0.5, 1.0, 0.0], 100)
    switched = np.repeat([0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0], 100)
    columns = {HEAT: heat, ONE: switched, OTHER: switched.copy()}
    noise = 0.1 * np.random.default_rng(3).standard_normal(len(TIME))
    machine = replace(MODEL, effects=truth)
    columns[Z] = machine.simulate(Record(TIME, columns, digest="log"))[Z] + noise
    task = DiagnosisTask(
        MODEL, (Record(TIME, columns, digest="log"),), (), (), lambda message: None
    )
    first = task.first()
    last = Hypothesis.of(MODEL, task.logs, MODEL, WITHIN_CALIBRATION)
    last = last.with_model(replace(MODEL, effects=effects))
    causes = tuple(Cause(each, 50.0 - k, {}, {}, 0.5) for k, each in enumerate(effects))
    return pruned(task, first, SearchState(last, last, (), causes))


def test_causes_that_undo_each_other_are_no_gain(monkeypatch):
    """Without either of them the other one spoils the model: both together do nothing."""
    monkeypatch.setattr("thermaltool.diagnosis.pruning._backward", lambda search: search)
    search = found(source(ONE, 30.0), source(OTHER, -30.0))
    assert search.causes == ()
    assert any("with it no log is better" in note for note in search.notes)


def test_a_model_that_is_not_written_says_nothing_of_its_causes(monkeypatch):
    """Beside a cause that spoils the model a true one seems to explain nothing."""
    monkeypatch.setattr("thermaltool.diagnosis.pruning._backward", lambda search: search)
    gain = effect_class("sensor_gain")(Z, {"gain": 1.5}, "log")
    search = found(gain, source(ONE, -300.0), truth=(gain,))
    assert [cause.effect for cause in search.causes] == [gain]
    assert search.notes == ("second_source is left out: with it a log would be worse",)
