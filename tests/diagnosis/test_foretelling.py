"""Of two causes that explain a log alike the one that foretells another log is it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.state import WITHIN_CALIBRATION
from thermaltool.diagnosis.unseen import foretelling, overruled
from thermaltool.effects import effect_class
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

HEAT, BED, SIGMA = "Q_main_W", "T_bed_degC", 0.05
TIME = 10.0 * np.arange(900)
KNOWN = 1e-8 * np.eye(2)
MODEL = Model(
    drives=(Drive(HEAT, "zero", 0.0, (0.0, 100.0)),),
    outputs=(Output(BED, "sensor", 20.0, (0.0, 20.0)),),
    terms=(
        Term(HEAT, BED, Rational1(0.2, 500.0), covariance=KNOWN, covariance_names=("tau1", "K1")),
    ),
    sample_period=10.0,
)
# Both make 1.1 times the heat of a drive at 60 W, and differ at 20 W.
GAIN = effect_class("drive_gain")(HEAT, {"gain": 1.1})
BENT = effect_class("drive_nonlinearity")(
    HEAT, {"exponent": 1 - np.log(1.1) / np.log(100 / 60), "level": 100.0}
)
JUMP = effect_class("sensor_offset_step")(BED, {"step": 1.0, "time": 4000.0}, "seen")


def read(name: str, level: float, share: float) -> Record:
    """A log of a lag by exact steps, with `share` times the heat that is commanded."""
    heat = level * np.repeat([0.0, 1.0, 0.0, 1.0, 1.0, 0.0], 150)
    kept, bed = np.exp(-10.0 / 500.0), [0.0]
    for each in heat[:-1]:
        bed.append(kept * bed[-1] + (1 - kept) * 0.2 * share * each)
    noise = SIGMA * np.random.default_rng(len(name)).standard_normal(len(TIME))
    return Record(TIME, {HEAT: heat, BED: 20.0 + np.array(bed) + noise}, digest=name, name=name)


def told(*logs: Record, order=(GAIN, BENT)) -> list[str]:
    hypothesis = Hypothesis.of(MODEL, [read("seen", 60.0, 1.1)], MODEL, WITHIN_CALIBRATION)
    found = [CauseCandidate(e, 50.0 - k, 40.0, WITHIN_CALIBRATION, {}) for k, e in enumerate(order)]
    return [c.effect.name for c in foretelling(hypothesis, found, logs, MODEL)]


def law_at(level: float) -> float:
    return float((level / 100.0) ** (BENT.parameters["exponent"] - 1))


def test_the_two_are_alike_in_the_diagnosed_log():
    assert law_at(60.0) == pytest.approx(1.1)
    assert law_at(20.0) > 1.3


@pytest.mark.parametrize("order", [(GAIN, BENT), (BENT, GAIN)])
@pytest.mark.parametrize(
    ("share", "first"), [(1.1, "drive_gain"), (law_at(20.0), "drive_nonlinearity")]
)
def test_the_one_that_foretells_the_unseen_log_comes_first(order, share, first):
    names = told(read("unseen", 20.0, share), order=order)
    assert names[0] == first


def test_what_unseen_logs_should_show_and_do_not_is_left_out():
    assert told(read("unseen", 60.0, 1.0)) == []
    # A log in which the drive hardly acts says nothing of it.
    assert told(read("unseen", 0.001, 1.0)) == ["drive_gain", "drive_nonlinearity"]


def test_accidents_keep_their_places_and_without_unseen_logs_all_do():
    bent = read("unseen", 20.0, law_at(20.0))
    assert told(bent, order=(GAIN, JUMP, BENT)) == [
        "drive_nonlinearity",
        "sensor_offset_step",
        "drive_gain",
    ]
    assert told(order=(GAIN, BENT)) == ["drive_gain", "drive_nonlinearity"]


def test_other_assumptions_have_to_be_decisively_better():
    hypothesis = Hypothesis.of(MODEL, [read("seen", 60.0, 1.1)], MODEL, WITHIN_CALIBRATION)
    one = CauseCandidate(GAIN, 50.0, 40.0, WITHIN_CALIBRATION, {})
    other = replace(one, assumptions=WITHIN_CALIBRATION | {"modes"}, evidence=55.0)
    found = foretelling(hypothesis, [other, one], [read("unseen", 60.0, 1.1)], MODEL)
    assert found[0] is one


def test_a_cause_that_only_the_diagnosed_logs_speak_for_is_told():
    gain, bent, jump = (
        CauseCandidate(e, 50.0, 40.0, WITHIN_CALIBRATION, {}) for e in (GAIN, BENT, JUMP)
    )
    note = overruled([jump, gain, bent], [jump, bent, gain], BENT)
    assert (note or "").startswith("drive_gain explains the diagnosed logs no worse")
    # Not where another was found in the end, nor where the order is the same.
    assert overruled([gain, bent], [bent, gain], GAIN) is None
    assert overruled([gain, bent], [gain, bent], GAIN) is None
    assert overruled([jump], [jump], JUMP) is None
