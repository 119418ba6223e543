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


def found(*effects):
    """The search for causes in a log that the plain model fits, with such causes accepted."""
    heat = np.repeat([0.0, 1.0, 0.3, 0.8, 0.0, 0.5, 1.0, 0.0], 100)
    switched = np.repeat([0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0], 100)
    columns = {HEAT: heat, ONE: switched, OTHER: switched.copy()}
    noise = 0.1 * np.random.default_rng(3).standard_normal(len(TIME))
    columns[Z] = MODEL.simulate(Record(TIME, columns, digest="log"))[Z] + noise
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
