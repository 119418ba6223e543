"""The Python API: loaded lazily, documented with examples that run, results that print and draw."""

from __future__ import annotations

import doctest
import importlib
import inspect
import json
import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool import api
from thermaltool.api.result import Result
from thermaltool.errors import ModelError, ThermalToolWarning

if TYPE_CHECKING:
    from conftest import Files

FUNCTIONS = [name for name in api.__all__ if inspect.isfunction(getattr(tt, name))]
CLASSES = [name for name in api.__all__ if inspect.isclass(getattr(tt, name))]
RESULTS = [name for name in CLASSES if issubclass(getattr(tt, name), Result)]


def test_the_import_is_quick_and_loads_no_numpy() -> None:
    code = """
import sys, time
start = time.process_time()
import thermaltool
print(time.process_time() - start)
dir(thermaltool)
assert "numpy" not in sys.modules
"""
    starts = [
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
        for _ in range(5)
    ]
    assert min(float(each.stdout) for each in starts) < 0.02


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibarte'"):
        _ = tt.calibarte
    assert set(api.__all__) <= set(dir(tt))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_documented_with_an_example(name: str) -> None:
    text = inspect.getdoc(getattr(tt, name)) or ""
    arguments = list(inspect.signature(getattr(tt, name)).parameters)
    for section in ("Parameters\n---", "Examples\n---"):
        assert section in text, section
    for argument in arguments:
        assert argument in text.partition("Parameters")[2], argument


def modules() -> list[ModuleType]:
    return [importlib.import_module(f"thermaltool.{name}") for name in api.PUBLIC]


@pytest.mark.slow
@pytest.mark.parametrize("module", modules(), ids=lambda module: module.__name__.rpartition(".")[2])
def test_examples_run(module: ModuleType) -> None:
    finder = doctest.DocTestFinder(exclude_empty=True)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    for test in finder.find(module):
        runner.run(test)
    assert runner.summarize().failed == 0


@pytest.mark.parametrize("name", RESULTS)
def test_results_say_what_they_hold_and_print(name: str) -> None:
    found = getattr(tt, name)
    assert "Attributes\n---" in (inspect.getdoc(found) or "")
    assert found.table is not Result.table
    assert found.draw is not Result.draw
    assert found.frame is not Result.frame


def test_a_check_prints_and_draws() -> None:
    result = tt.check("data_samples/frame_step100_first10min.csv")
    assert result.passed
    assert list(result.frame) == ["kind", "line", "column", "message"]
    assert result.frame.empty
    assert str(result).splitlines()[-1] == "nothing wrong"
    assert repr(result) == str(result) == result.table()
    assert len(result.plot().axes) == 4


def test_noise_as_a_frame_and_as_the_next_stage_reads_it() -> None:
    from thermaltool.api.inputs import read_noise

    result = tt.noise("data_samples/frame_idle.parquet", channels=["dT_pair1_K"])
    white = result.frame.loc["dT_pair1_K", "white_sigma"]
    assert 0.015 < white < 0.025
    assert read_noise(result)["dT_pair1_K"].white == white
    assert len(result.plot().axes) == 3


def test_an_inversion_is_a_frame_and_knows_where_it_failed() -> None:
    result = tt.invert_laplace("exp(-s)/s", [0.5, 1.0001, 2.0])
    assert result.missed == 1
    assert "at t = 1.0001 s exceeds 1e-09 (1 of 3 times)" in result.warning()
    assert result.frame.index.tolist() == [0.5, 1.0001, 2.0]
    assert tt.invert_laplace(lambda s: 1 / s, [1.0]).warning() == ""
    with pytest.raises(ValueError, match="parameters belong to an expression"):
        tt.invert_laplace(lambda s: 1 / s, [1.0], parameters={"a": 1.0})


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    """A minute of rest, then 100 W: d_z follows with 200 s, read with 0.01 µm of noise."""
    time = np.arange(0.0, 1200.0, 10.0)
    frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    frame["d_z_um"] += 0.01 * np.random.default_rng(3).standard_normal(len(time))
    return frame


@pytest.fixture(scope="module")
def fit(frame: pd.DataFrame) -> api.Calibration:
    return tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])


def test_a_calibration_prints_its_table_and_draws_the_log(
    fit: api.Calibration, frame: pd.DataFrame
) -> None:
    head, row, *rest = str(fit).splitlines()
    assert rest[len(rest) - len(fit.notes) :] == list(fit.notes)
    assert any(line.startswith("d_z_um: kinds compared") for line in rest)
    assert head.split()[:2] == ["output", "rmse"]
    assert row.startswith("d_z_um")
    assert set(fit.frame.index.get_level_values("output")) == {"d_z_um"}
    assert fit.frame["standard_error"].notna().any()
    assert fit.exceeds(0.001)
    assert not fit.exceeds(1.0)
    titles = [ax.get_title("left").split(",")[0] for ax in fit.plot().axes]
    assert titles == ["d_z_um", "", "Whiteness", "Independence"]


def test_what_a_fit_leaves_open_is_printed_below_its_table(frame: pd.DataFrame) -> None:
    # Of one lag three are not identified.
    kinds = {"d_z_um": "deflection"}
    fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"], kinds=kinds)
    assert fit.notes
    assert str(fit) == repr(fit) == "\n".join([fit.table(), *fit.notes])
    said: list[str] = []
    walk = pd.DataFrame({"time_s": np.arange(300.0)})
    walk["x"] = np.cumsum(np.random.default_rng(1).standard_normal(300))
    arma = tt.fit(walk, "x", (1, 0), warn=said.append)
    assert arma.notes == (said[-1].removeprefix("<frame>: x: "),)
    assert "as good as 1" in arma.notes[0]
    assert str(arma).endswith(arma.notes[0])
    orders = tt.order(walk, "x", max_p=1, max_q=0, criteria=["bic"], warn=said.append)
    assert orders.notes
    assert str(orders) == "\n".join([orders.table(), *orders.notes])


def test_findings_coefficients_and_choices_are_frames(files: Files) -> None:
    bad = pd.DataFrame({"time_s": [0.0, 1.0, 2.0], "T_a_degC": [20.0, -300.0, 20.1]})
    found = tt.check(bad)
    assert found.frame.loc[0].tolist() == [
        "implausible", 2, "T_a_degC", "-300 degC is below absolute zero",
    ]  # fmt: skip
    noise = pd.DataFrame({"time_s": np.arange(300.0)})
    noise["x"] = np.random.default_rng(1).standard_normal(300)
    fit = tt.fit(noise, "x", (2, 1), warn=lambda message: None)
    assert fit.frame.index.tolist() == ["ar1", "ar2", "ma1"]
    np.testing.assert_array_equal(fit.frame["value"], [*fit.model.ar, *fit.model.ma])
    np.testing.assert_array_equal(fit.frame["standard_error"], fit.model.errors)
    design = tt.regularize(files.model, files.noise, form="kalman", walk=0.01, dt=10.0)
    best = design.design.best
    assert best is not None
    assert design.frame["walk_per_sqrt_s"].tolist() == [0.01]
    assert design.frame["band_d_x_um"].tolist() == [best.prediction.band[0]]
    assert design.frame["chosen"].all()


@pytest.mark.parametrize("name", ["calibrate", "check", "diagnose", "estimate", "fit", "forecast",
                                  "identify", "noise", "order", "simulate"])  # fmt: skip
def test_an_unknown_argument_is_refused_in_the_name_of_the_stage(name: str) -> None:
    with pytest.raises(
        TypeError, match=rf"^{name}\(\) takes no argument 'max_gab' \(near: max_gap"
    ):
        getattr(tt, name)(max_gab=1.0)


def test_several_logs_are_calibrated_together(frame: pd.DataFrame) -> None:
    both = tt.calibrate(
        [frame, frame[frame["time_s"] < 600]], ["Q_motor_W"], deflections=["d_z_um"]
    )
    assert both.model.outputs[0].fit["rows"] == 120 + 60


def test_a_simulation_takes_a_fit_a_model_or_a_file(
    fit: api.Calibration, frame: pd.DataFrame, tmp_path: Path
) -> None:
    tt.write_model(fit, str(tmp_path / "model.json"))
    runs = [tt.simulate(m, frame) for m in (fit, fit.model, tmp_path / "model.json")]
    for run in runs[1:]:
        np.testing.assert_allclose(run.columns["d_z_um"], runs[0].columns["d_z_um"], rtol=1e-12)
    # A displacement counts from its first value, which is read with noise.
    assert runs[0].agreements["d_z_um"].rmse < 0.05
    assert list(runs[0].frame) == ["d_z_um", "residual_d_z_um"]
    assert len(runs[0].plot().axes) == 2
    assert not tt.simulate(fit, frame[["time_s", "Q_motor_W"]]).judged


def test_extrapolation_and_pauses_are_warned_of(fit: api.Calibration, frame: pd.DataFrame) -> None:
    with pytest.warns(ThermalToolWarning, match="the model extrapolates"):
        tt.simulate(fit, frame.assign(Q_motor_W=2 * frame["Q_motor_W"]))
    late = frame.assign(time_s=frame["time_s"] + np.where(frame["time_s"] > 600, 7200.0, 0.0))
    said: list[str] = []
    tt.simulate(fit, late, warn=said.append)
    assert [sentence.partition(": ")[2] for sentence in said] == [
        "a pause of 7210 s; the drive is taken as held over it"
    ]


def test_a_design_prints_its_trade_off_and_estimates(files: Files) -> None:
    design = tt.regularize(files.model, files.noise, form="kalman", walk=0.01, dt=10.0)
    head, *rows, chosen = str(design).splitlines()
    assert head.startswith("form")
    assert len(rows) == 1
    assert chosen == "chosen: kalman, walk_per_sqrt_s = 0.01"
    assert len(design.plot().axes) == 1
    result = tt.estimate(design, files.log)
    assert list(result.frame) == ["Q_main_1", "d_x_um"]
    assert result.agreements["d_x_um"].rmse < 3.0
    assert str(result).splitlines()[0].split()[:2] == ["estimate", "band"]
    assert len(result.plot().axes) == 4


def test_a_design_asks_for_the_noise(files: Files) -> None:
    with pytest.raises(ModelError, match="weighs the sensors' noise"):
        tt.regularize(files.model)


def test_the_compensator_cancels_what_is_estimated_row_by_row(files: Files) -> None:
    estimates = tt.estimate(files.kalman, files.log).frame
    compensator = tt.Compensator(files.kalman, step=0.0, slew=math.inf)
    assert compensator.names == ("offset_x_um",)
    setpoints = compensator.run(files.log)["offset_x_um"]
    # Blocks of rows and one row after the other round otherwise: by 2e-7 on some processors.
    largest = float(np.max(np.abs(setpoints)))
    np.testing.assert_allclose(setpoints, -estimates["d_x_um"], atol=1e-6 * largest)
    assert compensator.finish() == {"offset_x_um": 0.0}


def test_a_compensator_goes_on_from_its_state(files: Files) -> None:
    log = tt.read_log(files.log)
    whole = tt.Compensator(files.kalman).run(log)
    first = tt.Compensator(files.kalman)
    head = first.run(log.rows(slice(0, 100)))
    second = tt.Compensator(files.kalman)
    second.resume(json.loads(json.dumps(first.state())))
    pd.testing.assert_frame_equal(pd.concat([head, second.run(log.rows(slice(100, None)))]), whole)


def test_a_time_that_is_no_number_leaves_the_setpoint_as_it_is(files: Files) -> None:
    log = tt.read_log(files.log).rows(slice(0, 60))
    for first in (math.nan, math.inf):
        compensator = tt.Compensator(files.kalman, slew=math.inf, warn=lambda sentence: None)
        assert compensator.step(first, {"dT_pair1_K": 0.0}) == {"offset_x_um": 0.0}
        expected = tt.Compensator(files.kalman, slew=math.inf).run(log)
        pd.testing.assert_frame_equal(compensator.run(log), expected)


def test_a_lost_reading_is_warned_of_and_ends_in_the_safe_setpoint(files: Files) -> None:
    said: list[str] = []
    compensator = tt.Compensator(files.kalman, slew=math.inf, hold=20.0, warn=said.append)
    log = tt.read_log(files.log).rows(slice(0, 60))
    assert compensator.run(log)["offset_x_um"].iloc[-1] < 0
    for k in range(5):
        setpoint = compensator.step(600.0 + 10 * k, {})
    assert setpoint == {"offset_x_um": 0.0}
    assert any("dT_pair1_K" in sentence for sentence in said)
