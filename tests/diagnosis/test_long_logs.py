"""Logs of more rows than a search keeps: averages are searched, readings say what it is worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.long_logs import averaged_logs
from thermaltool.diagnosis.state import DiagnosisTask
from thermaltool.fitting import averaging
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Model, agreements
from thermaltool.record import Record
from thermaltool.signals.row_groups import RowGroups

DRIVE, RISE, BEND = "Q_main_1", "dT_pair1_K", "d_y_um"
NOISE = {RISE: 0.02, BEND: 0.1}
# Rows of all logs together that are taken one by one, and of the long log.
FEW, MANY = 2000, 10_000


def lag(u: np.ndarray, tau: float) -> np.ndarray:
    """A lag of a held input, sampled every second, to its last digit."""
    kept = np.exp(-1 / tau)
    return np.asarray(lfilter([0.0, 1 - kept], [1.0, -kept], u))


def log(rows: int, seed: int, law: float = 1.0) -> Record:
    """A random duty whose heat goes by a power of the drive."""
    rng = np.random.default_rng([20261124, seed])
    switched = rng.random(rows) < 1 / 200
    levels = rng.choice([0.0, 0.3, 0.6, 1.0], int(switched.sum()) + 1)
    levels[0] = 0.0
    u = levels[np.cumsum(switched)]
    rise, bend = 6 * lag(u**law, 60.0), 30 * lag(u**law, 200.0)
    columns = {
        DRIVE: u,
        RISE: rise + NOISE[RISE] * rng.standard_normal(rows),
        BEND: bend + NOISE[BEND] * rng.standard_normal(rows),
    }
    return Record(np.arange(float(rows)), columns, digest=f"log {seed}", name=f"log {seed}")


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(averaging, "MAX_ROWS", FEW)


@pytest.fixture(scope="module")
def model() -> Model:
    kinds = {RISE: "rational1", BEND: "rational1"}
    plan = CalibrationPlan((DRIVE,), (RISE,), (BEND,), kinds, linear=True)
    return calibrate([log(FEW, 1)], plan)


@pytest.mark.slow
def test_a_clean_log_is_adequate(model: Model) -> None:
    found = diagnose(model, [log(MANY, 2)])
    assert found.adequate
    assert not found.causes
    assert found.model == model
    assert any("averages of 5 rows each" in note for note in found.notes)
    # Noise and residual are those of a reading, not of a mean.
    for output, report in found.residuals.items():
        assert report.noise.white == pytest.approx(NOISE[output], rel=0.05)
        assert report.rms == pytest.approx(NOISE[output], rel=0.05)


@pytest.mark.slow
def test_what_is_found_is_told_as_simulate_runs_it_on_all_rows(model: Model) -> None:
    wrong = log(MANY, 3, law=1.6)
    found = diagnose(model, [wrong])
    cause = found.causes[0]
    assert (cause.effect.name, cause.effect.channel) == ("drive_nonlinearity", DRIVE)
    assert cause.effect.parameters["exponent"] == pytest.approx(1.6, rel=0.02)
    # The written model runs on logs as they are.
    assert found.model.drives == model.drives
    last = max(step.step for step in found.written)
    for step in found.written:
        if step.step in (0, last):
            told = agreements(model if step.step == 0 else found.model, [wrong])[step.output]
            assert step.agreement.rows == MANY
            assert step.agreement.rmse == pytest.approx(told.rmse, rel=1e-9)
    assert cause.gain[BEND].rms_after < 1.2 * NOISE[BEND] < cause.gain[BEND].rms_before
    # Held out on averages, in the noise of a reading.
    assert cause.held_out[BEND].rms_before == pytest.approx(cause.gain[BEND].rms_before, rel=0.05)


@pytest.mark.slow
def test_outliers_among_the_readings_are_found(model: Model) -> None:
    wrong = log(MANY, 4)
    bad = np.random.default_rng(5).choice(MANY, 40, replace=False)
    wrong.columns[BEND][bad] += 5.0
    found = diagnose(model, [wrong])
    assert [cause.effect.name for cause in found.causes] == ["outliers"]
    share = found.causes[0].effect.parameters["share"]
    assert all(step.agreement.rows == MANY for step in found.written)
    assert any("averages of 5 rows each" in note for note in found.notes)
    assert share == pytest.approx(40 / MANY, rel=0.1)


def test_few_rows_are_taken_as_they_are(model: Model) -> None:
    task = DiagnosisTask(model, (log(FEW, 6),), (), (), lambda message: None)
    assert task.averaged() is task
    longer = replace(task, validate=(log(FEW + 1, 6),)).averaged()
    # All logs are of one kind where one of them is long.
    assert [each.row_readings for each in (*longer.logs, *longer.validate)] == [1, 2]
    assert longer.readings is not None


def test_channels_beside_the_model_are_averaged(model: Model) -> None:
    time = np.arange(float(MANY))
    beside = {
        "T_hall_degC": 20 + np.sin(2 * np.pi * time / 5000),
        "n_fan_rpm": np.where(time % 1000 < 300, 900.0, 0.0),
    }
    whole = log(MANY, 7).with_columns(beside)
    _, [[few]] = averaged_logs(model, [(whole,)])
    assert list(few.columns) == list(whole.columns)
    assert few.row_readings == 5
    hall = 20 + np.sin(2 * np.pi * few.time / 5000)
    inside = (few.time > 5) & (few.time < MANY - 5)  # beyond the ends all is as there
    assert few.columns["T_hall_degC"][inside] == pytest.approx(hall[inside], abs=1e-4)
    # What is held from row to row keeps its integral.
    held = float(np.sum(few.columns["n_fan_rpm"][:-1] * np.diff(few.time)))
    assert held == pytest.approx(float(beside["n_fan_rpm"].sum()), rel=1e-3)


def test_drives_that_always_switch_take_no_more_rows(model: Model) -> None:
    rows = 20 * FEW
    record = Record(
        np.arange(float(rows)),
        {DRIVE: np.arange(rows) % 2 * 1.0, RISE: np.zeros(rows), BEND: np.zeros(rows)},
    )
    _, [[few]] = averaged_logs(model, [(record,)])
    assert len(few) < 3 * FEW


def test_a_mean_counts_as_its_readings(model: Model) -> None:
    whole = log(MANY, 8)
    _, [[few]] = averaged_logs(model, [(whole,)])
    groups = RowGroups.of([few], [np.isfinite(few.columns[BEND])])
    assert groups is not None
    assert float(np.sum(1 / groups.weight)) == pytest.approx(MANY, rel=1e-3)


def test_a_mean_of_readings_that_jump_is_left_out(model: Model) -> None:
    # 6002 is inside a stretch of five rows; of two such levels the mean looks like a lag.
    wrong = log(MANY, 9)
    wrong.columns[BEND][6002:] += 5.0
    few, same = (averaged_logs(model, [(each,)])[1][0][0] for each in (wrong, log(MANY, 9)))
    lost = np.isnan(few.columns[BEND]) & np.isfinite(same.columns[BEND])
    assert lost.sum() == 1
    assert few.time[lost] == pytest.approx(6002, abs=5)
