"""Commands that change during a pause of a log."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import thermaltool as tt
from thermaltool.api.pauses import placed_in_pauses
from thermaltool.fitting.pauses import switches_in_pauses
from thermaltool.model import Drive
from thermaltool.record import Record

HEATER, FAN, OUTPUT = "Q_heater_W", "n_fan_rpm", "dT_plate_K"
DT = 10.0


def plate(generator, rows=1200):
    """Two lumps with films, each heated: the course of every 10 s."""
    A = np.array([[-1 / 150.0, 1 / 250.0], [1 / 1500.0, -1 / 900.0]])
    B = np.array([[6e-4, 0.0], [0.0, 2e-6]])
    heater = np.repeat(generator.choice([0.0, 40.0, 90.0], rows // 40 + 1), 40)[:rows]
    fan = np.repeat(generator.choice([0.0, 2000.0, 3000.0], rows // 70 + 1), 70)[:rows]
    heater[:10] = fan[:10] = 0.0
    return A, B, heater, fan


def course(A, B, heater, fan, generator, noise=0.02):
    kept, x = expm(A * DT), np.zeros((len(heater), 2))
    into = np.linalg.solve(A, kept - np.eye(2)) @ B
    for k in range(1, len(x)):
        x[k] = kept @ x[k - 1] + into @ [heater[k - 1], fan[k - 1]]
    return x.sum(axis=1) + generator.normal(0, noise, len(x))


def paused(seed, first, rows_in, changes):
    """A log with a pause, and when each drive changes in it [s]."""
    generator = np.random.default_rng(seed)
    A, B, heater, fan = plate(generator)
    stop = first + rows_in
    heater[first - 20 : stop + 20], fan[first - 20 : stop + 20] = 0.0, 3000.0
    for drive, (row, level) in zip((heater, fan), changes, strict=True):
        if row is not None:
            drive[row : stop + 20] = level
    read = course(A, B, heater, fan, generator)
    kept = np.r_[:first, stop : len(read)]
    columns = {HEATER: heater[kept], FAN: fan[kept], OUTPUT: read[kept]}
    return Record(DT * kept, columns)


DRIVES = [Drive(HEATER, "zero", 0.0, (0, 90)), Drive(FAN, "zero", 0.0, (0, 3000))]


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("row", [505, 520, 535])
def test_the_instant_of_a_switch_in_a_pause_is_found_to_a_row(seed, row):
    record = paused(seed, 500, 40, ((row, 90.0), (None, 0.0)))
    (found,) = switches_in_pauses(record, DRIVES, [OUTPUT])
    assert found.drive == HEATER
    assert found.time == pytest.approx(row * DT, abs=DT)


def test_two_commands_in_one_pause_have_instants_of_their_own():
    record = paused(4, 500, 60, ((510, 90.0), (550, 0.0)))
    found = {each.drive: each.time for each in switches_in_pauses(record, DRIVES, [OUTPUT])}
    assert found[HEATER] == pytest.approx(5100, abs=2 * DT)
    assert found[FAN] == pytest.approx(5500, abs=10 * DT)


def test_a_command_that_is_held_over_a_pause_or_that_no_output_shows_stays_as_it_is():
    held = paused(5, 500, 40, ((540, 90.0), (None, 0.0)))
    assert switches_in_pauses(held, DRIVES, [OUTPUT]) == []
    record = paused(5, 500, 40, ((510, 90.0), (None, 0.0)))
    noise = np.random.default_rng(6).normal(0, 0.02, len(record))
    assert switches_in_pauses(record.with_columns({OUTPUT: noise}), DRIVES, [OUTPUT]) == []
    assert switches_in_pauses(record, DRIVES, ["dT_other_K"]) == []


def test_a_long_log_is_averaged_and_says_the_same(monkeypatch):
    record = paused(7, 500, 40, ((513, 90.0), (None, 0.0)))
    monkeypatch.setattr("thermaltool.fitting.pauses.MAX_ROWS", 400)
    (found,) = switches_in_pauses(record, DRIVES, [OUTPUT])
    assert found.time == pytest.approx(5130, abs=2 * DT)


@pytest.mark.slow
def test_a_calibration_and_its_simulation_take_the_switch_where_it_is():
    record = paused(8, 500, 40, ((508, 90.0), (None, 0.0)))
    frame = pd.DataFrame({"time_s": record.time, **record.columns})
    said: list[str] = []
    fit = tt.calibrate(frame, [HEATER, FAN], sensors=[OUTPUT], warn=said.append)
    (when,) = (found for each in said if (found := re.search(r"by 90 W .* (\S+) s into it", each)))
    assert float(when[1]) == pytest.approx(90, abs=DT)
    (term,) = (each for each in fit.model.terms if each.drive == HEATER)
    # Steady state of the two lumps, by hand.
    A, B, *_ = plate(np.random.default_rng(0))
    steady = np.linalg.solve(-A, B[:, 0]).sum()
    assert term.response.dc_gain() == pytest.approx(steady, rel=0.02)
    run = tt.simulate(fit, frame, warn=said.append)
    assert len(run.columns["time_s"]) == len(frame)
    told = fit.model.outputs[0].fit["rmse"]
    assert run.agreements[OUTPUT].rmse == pytest.approx(told, rel=0.01)
    assert told < 0.022


@pytest.mark.slow
def test_a_switch_in_a_pause_is_no_cause():
    def frame(record):
        return pd.DataFrame({"time_s": record.time, **record.columns})

    known = paused(9, 500, 40, ((540, 90.0), (None, 0.0)))
    said: list[str] = []
    fit = tt.calibrate(frame(known), [HEATER, FAN], sensors=[OUTPUT], warn=said.append)
    today = paused(9, 700, 60, ((720, 90.0), (None, 0.0)))
    found = tt.diagnose(fit, frame(today), warn=said.append)
    assert found.diagnosis.causes == ()
    assert found.diagnosis.verdict == "adequate"


def test_rows_in_a_pause_are_a_segment_of_their_own():
    record = Record(np.array([0.0, 1, 2, 9, 10]), {"a": np.arange(5.0)}, (slice(0, 3), slice(3, 5)))
    more = record.with_rows(np.array([1.5, 5.0, 9.5]), {"a": np.array([7.0, 8.0, 9.0])})
    assert more.time.tolist() == [0, 1, 1.5, 2, 5, 9, 9.5, 10]
    assert more.columns["a"].tolist() == [0, 1, 7, 2, 8, 3, 9, 4]
    assert more.segments == (slice(0, 4), slice(4, 5), slice(5, 8))


@pytest.mark.parametrize("late", [100.0, 300.0, 1000.0])
def test_a_switch_shortly_before_the_end_of_a_long_pause_is_found(late):
    """Sixteen hours, of which the outputs remember the last minutes."""
    rows, away = 900, 57600.0
    time = DT * np.arange(rows) + np.where(np.arange(rows) < 450, 0.0, away)
    heater = np.repeat([0.0, 60.0, 0.0, 90.0, 30.0, 90.0, 0.0, 60.0, 90.0], 100)
    heater[430:450], heater[450:500] = 0.0, 90.0
    y, level, kept = np.zeros(rows), 0.0, np.exp(-DT / 400)
    for k in range(1, rows):
        if k == 450:
            level = 0.05 * 90 * -np.expm1(-late / 400)
        else:
            level = kept * level + (1 - kept) * 0.05 * heater[k - 1]
        y[k] = level
    y += np.random.default_rng(10).normal(0, 0.01, rows)
    record = Record(time, {HEATER: heater, OUTPUT: y})
    (found,) = switches_in_pauses(record, DRIVES[:1], [OUTPUT])
    assert found.ends - found.time == pytest.approx(late, rel=0.1)


def test_what_else_is_measured_goes_on_over_a_pause():
    """A channel that is neither drive nor output: an effect of another model may read it."""
    record = paused(11, 500, 40, ((520, 90.0), (None, 0.0)))
    room = 20.0 + record.time / 3600
    frame = pd.DataFrame({"time_s": record.time, **record.columns, "T_room_degC": room})
    said: list[str] = []
    placed = placed_in_pauses(tt.read_log(frame), [HEATER], [OUTPUT], said.append)
    assert len(placed) == len(frame) + 2
    np.testing.assert_allclose(placed.column("T_room_degC"), 20.0 + placed.time / 3600)
    assert np.isnan(placed.column(OUTPUT)).sum() == 2
    assert np.isfinite(placed.column(FAN)).all()


@pytest.mark.slow
def test_rows_that_are_judged_do_not_say_when_a_command_has_changed():
    """What happens after the pause alone is an error of the model that is judged there."""
    record = paused(12, 500, 40, ((520, 90.0), (None, 0.0)))
    frame = pd.DataFrame({"time_s": record.time, **record.columns})
    said: list[str] = []
    fit = tt.calibrate(frame.iloc[:500], [HEATER, FAN], sensors=[OUTPUT], warn=said.append)
    start, said = float(record.time[500]), []
    run = tt.simulate(fit, frame, start=start, warn=said.append)
    assert not any("in this pause" in each for each in said)
    assert run.agreements[OUTPUT].rmse > 0.1
