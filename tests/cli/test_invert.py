"""``thermaltool invert`` from outside."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from thermaltool.model import Drive, Model, Output, Term, dumps
from thermaltool.model.combine import scheduled
from thermaltool.responses.rational import Rational2


def test_the_table(thermaltool, files):
    result = thermaltool("invert", files.kernel, "--window", 800)
    assert result.code == 0
    rows = list(csv.DictReader(result.out.splitlines()))
    assert list(rows[0]) == ["time_s", "weight_1", "A0_1", "A1_s"]
    assert len(rows) == 800
    assert float(rows[1]["time_s"]) == 10
    assert float(rows[0]["A1_s"]) == pytest.approx(1 / 0.01)
    assert float(rows[0]["A0_1"]) == pytest.approx(2 * 0.02 / 0.01 - 2 * 1e-4 / 0.01**2)
    assert result.err.startswith("A0 = 2, A1 = 100 s, error of a weight below ")
    assert "a window of 800 keeps 100.0" in result.err


def test_json_and_other_settings(thermaltool, files):
    result = thermaltool("invert", files.model, "--regularization", 0.02, 1e-4, 0.02,
                         "--dt", 5, "--window", 30, "--json")  # fmt: skip
    assert set(result.json) == {
        "A0", "A1_s", "error", "steady_state_kept", "time_s", "weight",
    }  # fmt: skip
    assert result.json["time_s"] == [5.0 * k for k in range(30)]
    assert result.json["A1_s"] == pytest.approx(50)
    assert 0 <= result.json["error"] < 1e-6


def test_stdin_and_parquet(thermaltool, files):
    target = files.folder / "kernel.parquet"
    result = thermaltool("invert", "-", "-o", target, stdin=files.kernel.read_text())
    assert (result.code, result.out) == (0, "")
    assert target.read_bytes().startswith(b"PAR1")


def test_the_kernel_gives_back_the_heat(thermaltool, files):
    """Convolved with the log's own temperature, as the help text says."""
    weights = thermaltool("invert", files.kernel, "--window", 300, "--json").json
    rows = list(csv.DictReader(files.log.read_text().splitlines()))
    heat, warm = (np.array([float(row[name]) for row in rows]) for name in
                  ("Q_main_1", "dT_pair1_K"))  # fmt: skip
    rise = np.diff(warm, prepend=warm[0]) / 10
    estimate = np.convolve(weights["weight"], warm)[:240]
    estimate = estimate + weights["A0"] * warm + weights["A1_s"] * rise
    assert np.mean(estimate[60:120]) == pytest.approx(1.0, abs=0.05)
    assert np.mean(estimate[-50:]) == pytest.approx(0.5, abs=0.05)
    assert np.mean(np.abs(heat - estimate)) < 0.15


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "no regularization: run thermaltool regularize --form kernel"),
        (("--sensor", "d_x_um"), "d_x_um is not a sensor with one drive; there are dT_pair1_K"),
        (("--sensor", "dT_b_K"), "dT_b_K is not a sensor"),
        (("--regularization", -0.01, 1e-4, 0.02), "the regularized inverse is unstable"),
        (("--regularization", 0, 1e-4, 0.02), "A other than 0"),
    ],
)
def test_refusals(thermaltool, files, options, message):
    result = thermaltool("invert", files.kalman, *options)
    assert (result.code, result.out) == (1, "")
    assert message in result.err
    assert result.err.count("\n") == 1


def test_a_design_for_other_parameters(thermaltool, files):
    document = json.loads(files.kernel.read_text())
    document["terms"][0]["parameters"]["r"] *= 1.01
    files.kernel.write_text(json.dumps(document))
    result = thermaltool("invert", files.kernel)
    assert result.code == 1
    assert "designed for other parameters" in result.err


POWER_TO_ANGLE = Model(
    (Drive("Q_heater_W", "zero", 0.0, (0.0, 60.0)),),
    (Output("phi_x_urad", "deflection", "first", (0.0, 200.0)),),
    (Term("Q_heater_W", "phi_x_urad", Rational2(2.0, 900.0, 1.0, 5000.0)),),
    60.0,
)


def test_an_inverse_transfer_function_simulates(thermaltool, tmp_path):
    model, inverse, log = (tmp_path / n for n in ("model.json", "inverse.json", "log.csv"))
    model.write_text(dumps(POWER_TO_ANGLE))
    rows = "".join(f"{60 * k},{50.0 * (k > 9)}\n" for k in range(600))
    log.write_text("time_s,Q_heater_W\n" + rows)
    done = thermaltool("invert", model, "--filter", "300", "-o", inverse)
    assert (done.code, done.out) == (0, "")
    # (2 (5000 s + 1) + 900 s + 1): zero at −3/10900.
    assert "filter of 300, 150 s; zeros at -0.000275 1/s; steady gain 0.3333" in done.err
    angle = tmp_path / "angle.csv"
    assert thermaltool("simulate", model, log, "-o", angle).code == 0
    done = thermaltool("simulate", inverse, angle)
    assert done.code == 0, done.err
    names, *lines = done.out.splitlines()
    assert names == "time_s,Q_heater_W"
    assert float(lines[0].split(",")[1]) == 0.0
    assert float(lines[-1].split(",")[1]) == pytest.approx(50.0, abs=0.01)


@pytest.mark.parametrize(
    "arguments", [("--filter", "60"), ("--regularization", "0.02", "1e-4", "0.02")]
)
def test_a_schedule_is_refused(thermaltool, tmp_path, arguments):
    """Of one way there is nothing to choose."""
    slow = (Term("Q_heater_W", "phi_x_urad", Rational2(2.0, 900.0, 1.0, 9000.0)),)
    sensor = (replace(POWER_TO_ANGLE.outputs[0], role="sensor"),)
    members = [replace(POWER_TO_ANGLE, outputs=sensor, **part) for part in ({}, {"terms": slow})]
    (tmp_path / "model.json").write_text(dumps(scheduled(members, "Q_heater_W", [20.0, 60.0])))
    done = thermaltool("invert", tmp_path / "model.json", *arguments)
    assert (done.code, done.out) == (1, "")
    (line,) = done.err.splitlines()
    assert "a schedule has no" in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--filter", "0"), "0.0 is not in the range"),
        (("--filter", "60", "--dt", "1"), "--filter goes with MODEL"),
        (("--drive", "Q_heater_W"), "--drive goes with --filter"),
        ((), "the model has no sensor"),
        (("--filter", "60", "--sensor", "d_z_um"), "no such way: Q_heater_W → phi_x_urad"),
    ],
)
def test_bad_input_of_an_inverse_transfer_function(thermaltool, tmp_path, arguments, message):
    model, kept = tmp_path / "model.json", tmp_path / "kept.json"
    model.write_text(dumps(POWER_TO_ANGLE))
    kept.write_text("kept")
    done = thermaltool("invert", model, *arguments, "-o", kept)
    assert done.code in (1, 2)
    assert message in done.err.splitlines()[-1]
    assert kept.read_text() == "kept"
