"""Faults of sensors: left out by every command that fits or judges, told in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest

ROWS = 900
TIME = 10.0 * np.arange(ROWS)
HEAT = np.where((TIME > 500) & (TIME < 5000), 100.0, 0.0)


def lag(tau: float) -> np.ndarray:
    out, keep = np.zeros(ROWS), np.exp(-10.0 / tau)
    for k in range(1, ROWS):
        out[k] = keep * out[k - 1] + (1 - keep) * HEAT[k - 1]
    return out


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A sound log of a heated machine, and the same with faults."""
    folder = tmp_path_factory.mktemp("faults")
    noise = np.random.default_rng().normal(0, 1, (2, ROWS))
    T = 22 + 0.2 * lag(600.0) + 0.03 * noise[0]
    d = 0.3 * lag(900.0) + 0.1 * noise[1]
    paths = []
    for name in ("sound", "faulty"):
        if name == "faulty":
            T[[200, 201, 400]] = [-127.0, -127.0, 85.0]
            d[[300, 301, 650]] += 250.0
        rows = np.column_stack([TIME, HEAT, T, d])
        paths.append(folder / f"{name}.csv")
        head = "time_s,Q_motor_W,T_motor_degC,d_z_um"
        np.savetxt(paths[-1], rows, "%.4f", ",", header=head, comments="")
    return paths


TOLD = (
    "faults of sensors left out: 3 of T_motor_degC (1 at 85 degC, a DS18B20 after power-on; 2 at "
    "-127 degC, a DS18B20 that does not answer), 3 of d_z_um (spikes); --faults keep takes them"
)


def test_check_names_them_and_writes_the_log_without(thermaltool, logs, tmp_path):
    clean = tmp_path / "clean.csv"
    found = thermaltool("check", logs[1], "-o", clean)
    assert found.code == 3
    wrong = found.out.partition("wrong:\n")[2].splitlines()
    assert [line.partition("faulty.csv:")[2] for line in wrong[:2]] == [
        "402: T_motor_degC: 85 degC is a DS18B20 after power-on",
        "202: T_motor_degC: -127 degC is a DS18B20 that does not answer in 2 rows",
    ]
    assert [line.split(":")[1:3] for line in wrong[2:]] == [["302", " d_z_um"], ["652", " d_z_um"]]
    assert clean.read_text().splitlines()[401].split(",")[2] == ""
    assert thermaltool("check", logs[0]).code == 0
    thermaltool("check", logs[1], "--faults", "keep", "-o", clean)
    assert float(clean.read_text().splitlines()[401].split(",")[2]) == 85.0


def test_a_calibration_is_what_it_is_without_them(thermaltool, logs, tmp_path):
    plan = ("--drive", "Q_motor_W", "--sensor", "T_motor_degC", "--deflection", "d_z_um",
            "--response", "T_motor_degC=rational1", "--response", "d_z_um=rational1",
            "--linear")  # fmt: skip
    model, fits = tmp_path / "model.json", {}
    for path in logs:
        found = thermaltool("calibrate", path, *plan, "-o", model, "--json")
        fits[path] = json.loads(found.out)["outputs"]
        assert (TOLD in found.err) == (path is logs[1])
    for sound, faulty in zip(*fits.values(), strict=True):
        assert faulty["fit"]["rmse"] == pytest.approx(sound["fit"]["rmse"], rel=0.1)
    judged = thermaltool("simulate", model, logs[1], "-o", tmp_path / "out.csv")
    assert TOLD in judged.err
    kept = thermaltool("simulate", model, logs[1], "--faults", "keep", "-o", tmp_path / "out.csv")
    assert TOLD not in kept.err


def test_noise_counts_spikes_among_the_outliers(thermaltool, logs):
    document = json.loads(thermaltool("noise", logs[1], "--json").out)["channels"]
    assert document["d_z_um"]["outlier_count"] >= 3
    times = [each["time_s"] for each in document["d_z_um"]["outliers"]]
    assert {3000.0, 3010.0, 6500.0} <= set(times)
    assert times == sorted(times)
    assert document["T_motor_degC"]["white_sigma"] == pytest.approx(0.03, rel=0.2)


def test_a_spectrum_keeps_the_instant_of_a_step_whose_reading_is_a_fault(thermaltool, logs):
    text = logs[0].read_text().splitlines()
    first = int(np.argmax(HEAT > 0)) + 1
    cells = text[first].split(",")
    text[first] = ",".join([*cells[:2], "-127.0", *cells[3:]])
    path = logs[0].with_name("step.csv")
    path.write_text("\n".join(text) + "\n")
    plan = ("--input", "Q_motor_W", "--output", "T_motor_degC", "--lines", "1", "--json")
    sound, faulty = (
        json.loads(thermaltool("spectrum", each, *plan).out)["lines"][0] for each in (logs[0], path)
    )
    for key, value in sound.items():
        if isinstance(value, float):
            assert faulty[key] == pytest.approx(value, rel=2e-3), key
