"""A diagnosis from Python: what it prints, draws, writes and hands on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool import api
from thermaltool.errors import LogError
from thermaltool.record import Record

TIME = np.arange(0.0, 1200.0, 10.0)


def frame(seed: int, jump: float = 0.0) -> pd.DataFrame:
    """A minute of rest, then 100 W: d_z follows with 200 s; it jumps after 800 s."""
    read = 20 * -np.expm1(-np.maximum(TIME - 60, 0) / 200) + jump * (TIME > 800)
    read = read + 0.05 * np.random.default_rng([20261122, seed]).standard_normal(len(TIME))
    heat = np.where(TIME < 60, 0.0, 100.0)
    return pd.DataFrame({"time_s": TIME, "Q_motor_W": heat, "d_z_um": read})


@pytest.fixture(scope="module")
def fit() -> api.Calibration:
    return tt.calibrate(frame(1), ["Q_motor_W"], deflections=["d_z_um"])


@pytest.fixture(scope="module")
def found(fit: api.Calibration) -> api.DiagnosisReport:
    return tt.diagnose(fit, frame(2, -1.0), warn=lambda message: None)


def test_the_cause_is_a_row_of_the_frame(found: api.DiagnosisReport) -> None:
    assert not found.adequate
    assert found.exceeds(0.5)
    row = found.frame.loc["geometry_step", "d_z_um", "step[d_z_um]"]
    assert row["low"] < row["value"] < row["high"] < 0.0
    # Twice the interval, which one log in twenty leaves.
    assert abs(row["value"] + 1.0) < row["high"] - row["low"] < 0.2
    assert row["unit"] == "um"


def test_it_prints_draws_and_writes_its_report(found: api.DiagnosisReport, tmp_path: Path) -> None:
    assert str(found).startswith("The model is not adequate for <frame>")
    assert len(found.plot().axes) == 2
    asked: list[str] = []
    found.write(str(tmp_path / "why.md"), asked.append)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "why.md", "why_d_z_um.png", "why_evidence.png",
    ]  # fmt: skip
    assert asked == [str(tmp_path / "why_d_z_um.png"), str(tmp_path / "why_evidence.png")]


def test_the_extended_model_goes_on(found: api.DiagnosisReport, tmp_path: Path) -> None:
    path = str(tmp_path / "extended.json")
    tt.write_model(found, path)
    (effect,) = tt.read_model(path).effects
    assert effect.name == "geometry_step"
    assert found.extended("a call").provenance["diagnosed"]["command"] == "a call"


def test_the_extended_model_tells_its_own_errors(found: api.DiagnosisReport) -> None:
    (simulated,) = tt.simulate(found, frame(2, -1.0)).agreements.values()
    (output,) = found.model.outputs
    for key in ("rmse", "rmse_zero_free", "fit_percent", "rows"):
        assert output.fit[key] == pytest.approx(getattr(simulated, key))
    (came_in,) = found.diagnosis.model.outputs
    assert came_in.fit["rmse"] != pytest.approx(simulated.rmse, rel=0.01)
    assert output.fit["noise"] == came_in.fit["noise"]
    assert "causes from <frame>: errors are those of the model there" in str(tt.present(found))


@pytest.mark.parametrize("faults", ["omit", "keep"])
def test_errors_are_those_of_simulate_where_readings_stand_out(
    fit: api.Calibration, faults: str
) -> None:
    """`simulate` leaves spikes out as faults of a sensor; the report counts so, and names them."""
    log = frame(3)
    log.loc[[30, 55, 80, 101], "d_z_um"] += [3.0, -2.5, 4.0, -3.0]
    told = tt.diagnose(fit, log, faults=faults, warn=lambda message: None)
    assert [cause.effect.name for cause in told.diagnosis.causes] == ["outliers"]
    (step, *_) = told.diagnosis.written
    real = tt.simulate(fit, log, faults=faults, warn=lambda message: None).agreements["d_z_um"]
    assert step.agreement.rmse == pytest.approx(real.rmse, rel=1e-9)
    assert step.agreement.rows == real.rows
    assert (real.rows < len(log)) is (faults == "omit")


def test_one_log_twice_is_refused(fit: api.Calibration) -> None:
    with pytest.raises(LogError, match="the same log as"):
        tt.diagnose(fit, frame(1), validate=[frame(1)])


def test_a_log_in_another_unit_is_refused_with_the_line_of_a_map(fit: api.Calibration) -> None:
    other = frame(3)
    other["Q_motor_W"] *= 1000.0
    with pytest.raises(LogError, match="is this log in mW"):
        tt.diagnose(fit, other)


@pytest.mark.slow
def test_a_dead_probe_is_no_other_unit(fit: api.Calibration) -> None:
    dead = frame(3)
    dead["d_z_um"] = 0.003 * np.random.default_rng(20261128).standard_normal(len(TIME))
    told: list[str] = []
    assert not tt.diagnose(fit, dead, warn=told.append).adequate
    assert any("is this log in mm" in each for each in told)


@pytest.mark.slow
def test_records_that_were_not_read_are_told_apart_by_their_samples(fit: api.Calibration) -> None:
    first, second = (
        Record(
            TIME, {"Q_motor_W": each["Q_motor_W"].to_numpy(), "d_z_um": each["d_z_um"].to_numpy()}
        )
        for each in (frame(2, -1.0), frame(3))
    )
    found = tt.diagnose(fit, [first, second], warn=lambda message: None)
    assert found.frame.index.get_level_values(0)[0] == "geometry_step"
    # What happened in one record does not act in another.
    calm = tt.simulate(fit, frame(4), warn=lambda message: None).frame
    after = tt.simulate(found.model, frame(4), warn=lambda message: None).frame
    channel = next(c for c in calm.columns if c.endswith("d_z_um"))
    assert after[channel].iloc[-1] == pytest.approx(calm[channel].iloc[-1], abs=0.5)
    with pytest.raises(LogError, match="the same log"):
        tt.diagnose(fit, [first, first], warn=lambda message: None)


@pytest.mark.slow
def test_a_drive_that_is_a_million_times_too_large_is_judged() -> None:
    """A log in other units than its names say: some causes cannot be followed there."""

    def both(seed: int, times: float) -> pd.DataFrame:
        own = frame(seed)
        rng = np.random.default_rng([20261125, seed])
        rise = 10 * -np.expm1(-np.maximum(TIME - 60, 0) / 150) * (TIME >= 60)
        own["T_head_degC"] = 22 + rise + 0.02 * rng.standard_normal(len(TIME))
        return own.assign(Q_motor_W=times * own["Q_motor_W"])

    kinds = {"d_z_um": "rational1", "T_head_degC": "rational1"}
    model = tt.calibrate(both(1, 1.0), ["Q_motor_W"], sensors=["T_head_degC"],
                         deflections=["d_z_um"], kinds=kinds, linear=True)  # fmt: skip
    found = tt.diagnose(model, both(2, 1e6), warn=lambda message: None)
    assert not found.adequate
