"""A log that begins on a warm machine: its start is of the model's modes, and hides no cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
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


@pytest.mark.parametrize("kind", RESPONSES)
def test_a_step_is_looked_for_beside_the_start(kind: str) -> None:
    """The start moves more from reading to reading than the sensor that jumps."""
    found, start = warm_log(kind, 1.0, 0.0)
    (log,) = found.logs
    at = float(log.time[637])
    bed = log.columns[BED] + 19 * start + 0.2 * (log.time >= at)
    stepped = replace(log, columns={**log.columns, BED: bed})
    begun = found.with_logs([stepped]).under(OF_MODES, found.model)
    trials = scan(begun, [OF_MODES])
    first = next(c for c in trials if c.effect.name == "sensor_offset_step")
    step = fit_candidate(begun, first)
    assert step.evidence > 50.0
    assert step.effect.parameters["time"] == pytest.approx(at, abs=2 * PERIOD)


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


def pumped(seed: int, gain: float, before: float, first: int = 0) -> pd.DataFrame:
    """A log of two outputs by exact steps of their lags, beside a pump that warms both.

    `before` is the part of the way to its steady state that the pump and the heater have come at
    the first row; `first` is whether the pump runs there.
    """
    draw = np.random.default_rng(seed)
    heat = np.repeat(draw.choice([0.0, 60.0, 120.0, 200.0], 30), 20)
    pump = np.roll(np.repeat([1 - first, first, 1 - first, first], 150), 150).astype(float)

    def late(series: np.ndarray, tau: float, start: float) -> np.ndarray:
        kept = np.exp(-30.0 / tau)
        state, found = start, []
        for value in series:
            found.append(state)
            state = kept * state + (1 - kept) * value
        return np.array(found)

    frame = {"time_s": 30.0 * np.arange(600), "Q_heater_W": heat, "x_pump_1": pump}
    for output, zero, of_heat, tau, of_pump, sigma in (
        ("T_column_degC", 20.0, 0.05, 900.0, gain, 0.02),
        ("d_z_um", 0.0, 0.2, 2400.0, 4.0 * gain, 0.2),
    ):
        moved = late(of_heat * heat, tau, before * 100.0 * of_heat)
        moved = moved + late(of_pump * pump, 1500.0, before * of_pump)
        frame[output] = zero + moved + sigma * draw.standard_normal(600)
    return pd.DataFrame(frame)


@pytest.mark.slow
# A source that is on before the log has a past, which the search takes in part for a slower lag.
@pytest.mark.parametrize(("first", "left"), [(0, 0.03), (1, 0.1)])
def test_a_source_is_told_and_written_where_logs_begin_warm(first: int, left: float) -> None:
    calibration = pumped(1, 0.0, 0.0)
    outputs = {"sensors": ["T_column_degC"], "deflections": ["d_z_um"]}
    model = tt.calibrate(calibration, ["Q_heater_W"], **outputs).model
    logs = [pumped(2, 1.5, 0.6 * first, first), pumped(3, 1.5, 0.8, first)]
    found = tt.diagnose(model, logs[0], validate=[logs[1]], warn=lambda message: None)
    assert [c.effect.name for c in found.diagnosis.causes] == ["second_source"]
    (cause,) = found.diagnosis.causes
    assert cause.effect.channel == "x_pump_1"
    assert "rest" not in cause.effect.parameters
    if not first:
        assert cause.effect.parameters["gain[T_column_degC]"] == pytest.approx(1.5, rel=0.05)
    assert found.diagnosis.spoiled is None
    told = tt.simulate(found.model, logs[1], warn=lambda message: None).agreements
    assert told["T_column_degC"].rmse < left
    assert told["d_z_um"].rmse < 1.5 * 0.2
