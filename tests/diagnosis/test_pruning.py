"""Causes that do not stand beside the others are taken out again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

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
    rng = np.random.default_rng(3)
    machine = replace(MODEL, effects=(*MODEL.effects, *truth))
    for output, moved in machine.simulate(Record(TIME, columns, digest="log")).items():
        columns[output] = moved + 0.1 * rng.standard_normal(len(TIME))
    task = DiagnosisTask(
        MODEL, (Record(TIME, columns, digest="log"),), (), (), lambda message: None
    )
    first = task.first()
    last = Hypothesis.of(MODEL, task.logs, MODEL, WITHIN_CALIBRATION)
    last = last.with_model(replace(MODEL, effects=(*MODEL.effects, *effects)))
    causes = tuple(Cause(each, 50.0 - k, {}, {}, 0.5) for k, each in enumerate(effects))
    return pruned(task, first, SearchState(last, last, (), causes))


def test_causes_that_undo_each_other_are_no_gain(monkeypatch):
    """Without either of them the other one spoils the model: both together do nothing."""
    monkeypatch.setattr("thermaltool.diagnosis.pruning._backward", lambda search: search)
    search = found(source(ONE, 30.0), source(OTHER, -30.0))
    assert search.causes == ()
    assert any("with it no log is better" in note for note in search.notes)
    # What is left over is that of a model without them.
    assert search.ended.model.effects == ()


def test_a_model_that_is_not_written_says_nothing_of_its_causes(monkeypatch):
    """Beside a cause that spoils the model a true one seems to explain nothing."""
    monkeypatch.setattr("thermaltool.diagnosis.pruning._backward", lambda search: search)
    # A model without a covariance may have any gain of its own.
    monkeypatch.setattr("thermaltool.diagnosis.state.fitted_together", lambda last: last)
    gain = effect_class("sensor_gain")(Z, {"gain": 1.5}, "log")
    search = found(gain, source(ONE, -300.0), truth=(gain,))
    assert [cause.effect for cause in search.causes] == [gain]
    assert search.notes == (f"second_source is left out: with it {Z} in <record> would be worse",)


@pytest.mark.slow
@pytest.mark.parametrize("laws", [0, 1])
def test_a_cause_that_is_right_elsewhere_stays_though_it_is_not_written(monkeypatch, laws):
    """What one output loses is little of what the other gains, with a law or without."""
    monkeypatch.setattr("thermaltool.diagnosis.pruning._backward", lambda search: search)
    other = "d_y_um"
    model = replace(
        MODEL,
        outputs=(*MODEL.outputs, Output(other, "deflection", "first", (-100.0, 100.0))),
        terms=(*MODEL.terms, Term(HEAT, other, Rational1(20.0, 300.0, 0.0))),
        effects=(effect_class("drive_nonlinearity")(HEAT, {"exponent": 1.2, "level": 1.0}),)[:laws],
    )
    monkeypatch.setattr(f"{__name__}.MODEL", model)

    def moves(on_other: float):
        gains = {f"gain[{Z}]": 30.0, f"gain[{other}]": on_other}
        return effect_class("second_source")(ONE, {**gains, "time_constant": 50.0})

    truth = source(ONE, 30.0)
    for little in (0.1, 5.0):
        slight = found(moves(little), truth=(truth,))
        assert [cause.effect.name for cause in slight.causes] == ["second_source"]
    large = found(moves(20.0), truth=(truth,))
    assert large.causes == ()


@pytest.mark.parametrize(
    ("beside", "unseen", "stays"),
    [
        (0.8, ["clean"], True),
        (0.8, ["as wrong"], False),
        (0.8, ["again"], True),
        # One bad day is no every day, and outliers are no misfit.
        (0.8, ["clean", "as wrong"], True),
        (0.8, ["outlier"], True),
        # What is wrong every day would be here, too.
        (0.0, ["as wrong"], True),
    ],
)
@pytest.mark.parametrize("good", [0, 3])
def test_a_change_in_one_log_is_more_than_what_every_log_is_wrong_by(beside, unseen, stays, good):
    heat = np.repeat([0.0, 1.0, 0.3, 0.8, 0.0, 0.5, 1.0, 0.0], 100)
    moved = MODEL.simulate(Record(TIME, {HEAT: heat}))[Z]

    def log(name, beside):
        noise = 0.1 * np.random.default_rng([6, len(name)]).standard_normal(len(TIME))
        return Record(TIME, {HEAT: heat, Z: moved + beside + noise}, digest=name, name=name)

    hump = np.exp(-0.5 * ((TIME - 2000.0) / 400.0) ** 2)
    others = {
        "clean": 0.0 * TIME,
        "as wrong": 2.0 * hump,
        "again": 1.0 * (TIME > 1500),
        "outlier": 60.0 * (TIME == 1500.0),
    }
    logs = [
        log("log", 1.0 * (TIME > 2600.0) + beside * hump),
        *(log(f"good {k}", 0.0) for k in range(good)),
    ]
    others = tuple(log(name, others[name]) for name in unseen)
    task = DiagnosisTask(MODEL, tuple(logs), others, (), lambda message: None)
    step = effect_class("sensor_offset_step")(Z, {"step": 1.0, "time": 2600.0}, "log")
    first = Hypothesis.of(MODEL, tuple(logs), MODEL, WITHIN_CALIBRATION)
    last = first.with_model(replace(MODEL, effects=(step,)))
    search = pruned(
        task, task.first(), SearchState(last, last, (), (Cause(step, 50.0, {}, {}, 0.5),))
    )
    assert bool(search.causes) == stays
