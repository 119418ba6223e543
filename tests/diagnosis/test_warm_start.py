"""A log that begins on a warm machine: its start is of the model's modes, and hides no cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.select import fit_candidate, scan
from thermaltool.diagnosis.state import WITHIN_CALIBRATION
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.rational import Rational2

HEAT, ROOM, BED = "Q_main_1", "T_room_degC", "T_bed_degC"
PERIOD, ROWS = 10.0, 1200
OF_MODES, ANY_START = (WITHIN_CALIBRATION | {way} for way in ("modes", "initial"))


RESPONSES = {
    "two lags": Rational2(6.0, 3000.0, 2.0, 400.0),
    "a plate": Conduction(3.0, 1.0, 5e-4, 0.5),
    "a frame": Deflection(8.0, 1 / 3000, 1.0, 1 / 600, 0.001, 1 / 1500),
}


def warm_log(kind: str, unit: float, swing: float) -> tuple[Hypothesis, np.ndarray]:
    """A model on a log that begins away from rest in a room that swings, and its start.

    `unit` is the full level of the drive.
    """
    response = RESPONSES[kind]
    scaled = replace(response, **{g: getattr(response, g) / unit for g in response.gains})
    model = Model(
        drives=(Drive(HEAT, "zero", 0.0, (0.0, unit)),),
        outputs=(Output(BED, "sensor", 20.0, (-5.0, 15.0)),),
        terms=(Term(HEAT, BED, scaled),),
        sample_period=PERIOD,
    )
    time = PERIOD * np.arange(ROWS)
    draw = np.random.default_rng(4)
    columns = {HEAT: unit * np.repeat(draw.random(12), 100), ROOM: 20 + np.sin(time / 1700.0)}
    truth = model.simulate(Record(time, columns, digest="log"))[BED]
    start = 3.0 * (1 - response.step(time) / response.dc_gain())
    columns[BED] = 20 + truth + start + swing * np.sin(time / 1700.0)
    columns[BED] = columns[BED] + 0.05 * draw.standard_normal(ROWS)
    log = Record(time, columns, digest="log")
    return Hypothesis.of(model, [log], model, WITHIN_CALIBRATION), start


@pytest.mark.parametrize("unit", [0.001, 1.0, 1000.0])
@pytest.mark.parametrize("kind", RESPONSES)
def test_a_start_of_the_modes_is_the_likelier_in_any_unit(kind: str, unit: float) -> None:
    found, start = warm_log(kind, unit, 0.0)
    assert found.evidence_of(OF_MODES) > found.evidence_of(ANY_START) + 10.0
    (told,) = found.under(OF_MODES, found.model).beginning(BED)
    assert np.allclose(told - told[-1], start - start[-1], atol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("kind", RESPONSES)
def test_a_start_of_the_modes_leaves_more_of_what_is_slow(kind: str) -> None:
    found, _ = warm_log(kind, 1.0, 0.3)

    def evidence(way: frozenset[str]) -> float:
        begun = found.under(way, found.model)
        trials = [c for c in scan(begun, [way]) if c.effect.name == "ambient_drift"]
        return max(fit_candidate(begun, c).evidence for c in trials[:3])

    assert evidence(OF_MODES) > max(10.0, evidence(ANY_START) + 8.0)


def test_modes_that_two_responses_share_or_no_row_shows_are_no_columns() -> None:
    response = Conduction(3.0, 1.0, 5e-4, 0.5)
    slowest = 1 / float(np.min(np.abs(response.modes(PERIOD).poles.real)))
    other = Rational2(1.0, slowest, 0.5, 0.1 * PERIOD)
    found, _ = warm_log("a plate", 1.0, 0.0)
    term = found.model.terms[0]
    model = replace(found.model, terms=(*found.model.terms, replace(term, response=other)))
    starts = found.with_model(model).nuisance[BED].starts["modes"]
    table = np.column_stack([start[0] for start in starts])
    # Four modes and the sum of all; of the other response none is left.
    assert table.shape == (ROWS, 5)
    assert np.linalg.cond(table / np.max(np.abs(table), axis=0)) < 1e6
