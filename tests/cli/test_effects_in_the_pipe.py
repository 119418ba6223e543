"""A model's effects and measured drives through regularize, estimate, compensate, invert."""

from __future__ import annotations

import csv
import json
import subprocess
import sys

import numpy as np
import pytest
from effects.machine import AIR, COLUMN, COOLANT, FAR, HEAT, NEAR, X, Y, first_order, model

from thermaltool.effects import effect_class
from thermaltool.laplace import invert
from thermaltool.model import Drive, Model, Output, Term, dumps
from thermaltool.record import Record

FRAME, BED, DZ = "T_frame_degC", "T_bed_degC", "d_z_um"


def effect(name, channel, **parameters):
    return effect_class(name)(channel, parameters)


GAIN = effect("sensor_gain", NEAR, gain=0.8)
COOLING = effect("convection_state", COOLANT, rate=1e-3, level=1.0, idle=0.0)
LAG = effect("sensor_lag", NEAR, time_constant=60.0)
AMBIENT = effect_class("ambient_drift")(AIR, {"gain[d_y_um]": 6.0, "time_constant": 500.0})
NOISE = {
    "format": "thermaltool-noise",
    "version": 1,
    "channels": {c: {"white_sigma": 0.02, "drift": None} for c in (COLUMN, NEAR, FAR)},
}


def gantry():
    """Frame and bed temperatures are measured and drive the tool point; nothing is estimated."""
    return Model(
        (Drive(FRAME, "first", "first", (0.0, 12.0)), Drive(BED, "first", "first", (0.0, 30.0))),
        (Output(DZ, "deflection", "first", (-60.0, 200.0)),),
        (Term(FRAME, DZ, first_order(15.0, 1 / 300)), Term(BED, DZ, first_order(-2.0, 1 / 900))),
        5.0,
        effects=(effect_class("joint_contact")(DZ, {"curvature": 0.001}),),
    )


def table(text):
    rows = list(csv.reader(text.splitlines()))
    columns = zip(*rows[1:], strict=True)
    return {n: np.array(c, float) for n, c in zip(rows[0], columns, strict=True)}


def text_of(columns):
    rows = zip(*(v.tolist() for v in columns.values()), strict=True)
    return ",".join(columns) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)


@pytest.fixture
def gantry_log():
    time = 5.0 * np.arange(300)
    frame, bed = 20 + 10 * -np.expm1(-time / 400), 22 + 25 * (time > 300)
    return {"time_s": time, FRAME: frame, BED: bed}


def compensate(*arguments, text=""):
    """The command on real pipes."""
    command = [sys.executable, "-c", "from thermaltool.cli import main; main()", "compensate"]
    command += map(str, arguments)
    return subprocess.run(command, input=text, capture_output=True, text=True, check=False)


def streamed(path, log):
    """Estimates of compensate: all lines but the last, which is the end."""
    done = compensate(path, log, "--also", "estimates")
    assert (done.returncode, done.stderr.count("\n")) == (0, 1)
    assert ": starts from rest" in done.stderr
    return {n: v[:-1] for n, v in table(done.stdout).items()}


def test_a_model_of_measured_temperatures_streams(thermaltool, tmp_path, gantry_log):
    plain, design, log = (tmp_path / n for n in ("m.json", "d.json", "log.csv"))
    plain.write_text(dumps(gantry()))
    log.write_text(text_of(gantry_log))
    made = thermaltool("regularize", plain, "-o", design)
    assert (made.code, made.err) == (0, f"chosen: feedforward, from {FRAME}, {BED}\n")
    simulated = table(thermaltool("simulate", plain, log, "-q").out)[DZ]
    estimated = table(thermaltool("estimate", design, log, "-q").out)
    assert list(estimated) == ["time_s", DZ]
    # A simulation starts at the offset of its own, estimates at rest.
    np.testing.assert_allclose(estimated[DZ], simulated - simulated[0], atol=1e-6)
    assert np.ptp(estimated[DZ]) > 50
    stream = streamed(design, log)
    np.testing.assert_allclose(stream[DZ], estimated[DZ], atol=1e-9)
    assert set(stream) == {"time_s", "offset_z_um", DZ}


def test_a_measured_column_that_is_missing_is_held_and_told(thermaltool, tmp_path, gantry_log):
    plain, design = tmp_path / "m.json", tmp_path / "d.json"
    plain.write_text(dumps(gantry()))
    thermaltool("regularize", plain, "-o", design)
    lines = text_of(gantry_log).splitlines()
    lines[10] = lines[10].rpartition(",")[0] + ","
    done = compensate(design, text="\n".join(lines) + "\n")
    assert done.returncode == 0
    assert f"<stdin>:11: {BED}: empty: holding 22.0" in done.stderr
    raised = thermaltool("estimate", design, stdin="\n".join(lines) + "\n")
    assert f"<stdin>:11: {BED}: missing value" in raised.err
    gone = compensate(design, text=f"time_s,{FRAME}\n0,20\n")
    assert f"no column {BED}, which the estimator reads" in gone.stderr


def test_nothing_to_estimate_has_no_form(thermaltool, tmp_path):
    path = tmp_path / "m.json"
    path.write_text(dumps(gantry()))
    result = thermaltool("regularize", path, "--form", "kalman")
    assert result.code == 1
    assert "--form kalman: every drive is measured, nothing is to be estimated" in result.err
    report = thermaltool("regularize", path, "--json", "-o", tmp_path / "d.json").json
    assert (report["chosen"], report["outputs"], report["forms"]) == ("feedforward", [DZ], {})


@pytest.fixture
def machine(tmp_path):
    """Writes a model with effects, the noise and a log; returns (model, noise, log, truth)."""

    def make(*effects):
        document = model(*effects)
        time = 5.0 * np.arange(400)
        log = {
            HEAT: np.where((time > 300) & (time < 1500), 1.0, 0.0),
            AIR: 20 + 2 * np.sin(time / 400),
            COOLANT: np.where(time > 1000, 1.0, 0.0),
        }
        simulated = document.simulate(Record(time, log))
        rests = {COLUMN: 21.5}
        log |= {name: y + rests.get(name, 0.0) for name, y in simulated.items()}
        paths = [tmp_path / name for name in ("model.json", "noise.json", "log.csv")]
        texts = dumps(document), json.dumps(NOISE), text_of({"time_s": time, **log})
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return (*paths, simulated)

    return make


@pytest.mark.parametrize(
    "effects",
    [(GAIN, AMBIENT), (LAG,), (COOLING,)],
    ids=["gain and air", "lag", "coolant"],
)
def test_effects_act_without_further_options(thermaltool, tmp_path, machine, effects):
    path, noise, log, truth = machine(*effects)
    design, target = tmp_path / "d.json", tmp_path / "out.csv"
    made = thermaltool("regularize", path, "--noise", noise, "--walk", 0.05, "-o", design, "-q")
    assert made.code == 0
    result = thermaltool("estimate", design, log, "--json", "-o", target)
    assert result.err == ""
    for name in (X, Y):
        assert result.json["agreement"][name]["max_error"] < 0.02 * np.ptp(truth[name])
    stream = streamed(design, log)
    for name, values in table(target.read_text()).items():
        np.testing.assert_allclose(stream[name], values, atol=1e-7)


def test_effects_are_part_of_what_a_design_belongs_to(thermaltool, tmp_path, machine):
    path, noise, log, _ = machine(GAIN)
    design = tmp_path / "d.json"
    thermaltool("regularize", path, "--noise", noise, "--walk", 0.05, "-o", design, "-q")
    document = json.loads(design.read_text())
    document["effects"][0]["parameters"]["gain"] = 0.9
    design.write_text(json.dumps(document))
    result, done = thermaltool("estimate", design, log), compensate(design, log)
    assert (result.code, done.returncode) == (1, 1)
    for said in (result.err, done.stderr):
        assert "run thermaltool regularize again" in said


def test_what_cannot_be_had_is_refused_and_what_is_told_is_told(thermaltool, machine):
    path, noise, _, _ = machine(effect("sensor_drift", NEAR, rate=0.1))
    result = thermaltool("regularize", path, "--noise", noise)
    assert (result.code, result.out, result.err.count("\n")) == (1, "", 1)
    assert "the model's effect sensor_drift of dT_near_K: no reading of a stream" in result.err
    kept = thermaltool("regularize", path, "--noise", noise, "--walk", 0.05,
                       "--sensor", COLUMN, "--sensor", FAR)  # fmt: skip
    assert kept.code == 0
    path, noise, _, _ = machine(effect("transport_delay", HEAT, delay=20.0))
    told = thermaltool("regularize", path, "--noise", noise, "--walk", 0.05)
    assert told.err.startswith("Q_main_1: the estimate is what acts, behind transport_delay\n")


def test_noise_and_drives_that_are_missing(thermaltool, machine):
    path, noise, _, _ = machine()
    assert thermaltool("regularize", path).code == 2
    result = thermaltool("regularize", path, "--noise", noise, "--measured", "Q_else_1")
    assert "no drive Q_else_1 in the model; there are: Q_main_1" in result.err
    measured = thermaltool("regularize", path, "--measured", HEAT, "-q")
    assert json.loads(measured.out)["design"]["form"] == "feedforward"


def test_a_reading_without_a_truth_is_named(thermaltool, tmp_path, machine):
    path, noise, log, _ = machine(effect("sensor_conversion", NEAR, curvature=-0.004))
    text = path.read_text().replace("-100.0", "-30.0").replace("100.0\n", "50.0\n")
    path.write_text(text)
    design = tmp_path / "d.json"
    made = thermaltool("regularize", path, "--noise", noise, "--walk", 0.05, "-o", design, "-q")
    assert made.code == 0, made.err
    lines = log.read_text().splitlines()
    at = lines[0].split(",").index(NEAR)
    row = lines[5].split(",")
    row[at] = "70"
    lines[5] = ",".join(row)
    result = thermaltool("estimate", design, "--faults", "keep", stdin="\n".join(lines) + "\n")
    assert result.code == 1
    assert "<stdin>:6: dT_near_K: no truth gives this reading (1 row)" in result.err


SHAPE = ("--sensor", NEAR, "--regularization", 0.02, 1e-3, 0.1, "--window", 4000, "--dt", 0.5)


def test_a_kernel_with_a_lag_gives_the_drive_back(thermaltool, machine):
    """The table, summed over a step response of machine and sensor written out by hand."""
    path, _, _, _ = machine(LAG)
    kernel = thermaltool("invert", path, *SHAPE, "--json").json
    since = np.array(kernel["time_s"])
    reading = 20 * (1 - (200 * np.exp(-since / 200) - 60 * np.exp(-since / 60)) / 140)
    weight = np.array(kernel["weight"])
    heat = np.convolve(weight, reading)[: len(since)] + kernel["A0"] * reading
    heat += kernel["A1_s"] * np.diff(reading, prepend=0.0) / 0.5

    def regularized(s):
        machine = 20 / (1 + 200 * s) / (1 + 60 * s)
        added = 0.02 * s / (s + 0.1) ** 2 + 2e-3 * s / (s + 0.1) ** 3
        return machine / (machine + added) / s

    expected = invert(regularized, since[1:]).values
    # The slope is a difference over a sample.
    np.testing.assert_allclose(heat[1:], expected, atol=0.03)


def test_kernels_are_told_what_is_around_them(thermaltool, tmp_path, files):
    document = json.loads(files.model.read_text())
    plain = thermaltool("invert", files.model, "--regularization", 0.01, 1e-4, 0.02, "--json")
    for name, channel, parameters, message in (
        ("sensor_gain", "dT_pair1_K", {"gain": 0.8}, "ΔT is the truth behind the reading"),
        ("ambient_drift", "T_room_degC", {"gain[dT_pair1_K]": 0.1, "time_constant": 900.0},
         "ΔT is without what known columns add to it"),
    ):  # fmt: skip
        document["effects"] = [{"name": name, "channel": channel, "parameters": parameters}]
        files.model.write_text(json.dumps(document))
        told = thermaltool("invert", files.model, "--regularization", 0.01, 1e-4, 0.02, "--json")
        assert message in told.err
        assert told.json["weight"] == plain.json["weight"]
    document["effects"] = [
        {"name": "sensor_lag", "channel": "dT_pair1_K", "parameters": {"time_constant": 30.0}}
    ]
    files.model.write_text(json.dumps(document))
    late = thermaltool("invert", files.model, "--regularization", 0.01, 1e-4, 0.02, "--json")
    assert late.json["A1_s"] == plain.json["A1_s"]
    assert late.json["weight"] != plain.json["weight"]
    assert late.json["steady_state_kept"] == pytest.approx(1, abs=0.02)
    document["effects"] = [
        {"name": "radiation", "channel": "T_room_degC", "parameters": {"rate": 1e-4}}
    ]
    files.model.write_text(json.dumps(document))
    refused = thermaltool("invert", files.model, "--regularization", 0.01, 1e-4, 0.02)
    assert (refused.code, refused.out) == (1, "")
    assert "a kernel cannot follow the model's effect radiation" in refused.err
