"""identify: logs in, transfer functions and a model file out; what is wrong is told in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from reference.measured import MAPS, whole_log

from thermaltool.model import simulate_response
from thermaltool.responses.rational import Rational1, Rational2

RESPONSE = Rational2(12.0, 400.0, 5.0, 40.0, 20.0)


def write_log(path, columns):
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", fmt="%.10g",
               header=",".join(columns), comments="")  # fmt: skip
    return path


@pytest.fixture
def columns():
    rng = np.random.default_rng(21)
    time = 5.0 * np.arange(2400)
    power = np.repeat(rng.uniform(0, 2, 40), 60)
    power[:10] = 0.0
    y = simulate_response(RESPONSE, time, power, "zero")
    return {
        "time_s": time,
        "Q_main_W": power,
        "d_z_um": y + 0.05 * rng.standard_normal(2400) + 3.0,
    }


@pytest.fixture
def log(tmp_path, columns):
    return write_log(tmp_path / "run.csv", columns)


CALL = ("--input", "Q_main_W", "--output", "d_z_um")


@pytest.mark.slow
def test_json_says_what_was_identified(thermaltool, log):
    done = thermaltool("identify", log, *CALL, "--split", "0.6", "--json")
    assert done.code == 0
    (model,) = done.json["models"]
    assert model["inputs"] == ["Q_main_W"]
    assert model["output"] == "d_z_um"
    assert model["structure"] == "oe"
    assert model["delay_s"] == 25.0
    assert model["fit_training_percent"] > 98
    assert model["validation"]["fit_percent"] > 98
    assert model["method"] == "refined instrumental variables"
    slow, fast = model["time_constants_s"][:2]
    assert slow == pytest.approx(400, rel=0.05)
    assert fast == pytest.approx(40, rel=0.1)
    for each in model["parameters"].values():
        assert each["interval"][0] < each["value"] < each["interval"][1]
    assert model["residuals"]["independent_p"]["Q_main_W"] > 1e-3
    assert model["candidates"][0]["nk"] == [5]


@pytest.mark.slow
def test_heat_has_real_poles(thermaltool, tmp_path):
    """Two lags that are nearly one."""
    rng = np.random.default_rng()
    time, power = 10.0 * np.arange(700), np.repeat(rng.uniform(0, 200, 14), 50)
    grown = simulate_response(Rational2(7.0, 700.0, -6.5, 650.0), time, power, "zero")
    names = {"time_s": time, "Q_main_W": power, "d_z_um": grown + rng.standard_normal(700)}
    log = write_log(tmp_path / "near.csv", names)
    model = tmp_path / "model.json"
    assert thermaltool("identify", log, *CALL, "-o", model).code == 0
    (term,) = json.loads(model.read_text())["terms"]
    assert term["kind"].startswith("rational")


def test_bursts_are_rows(thermaltool, columns, tmp_path):
    """Three readings within 8 s of every minute."""
    rows = {name: np.repeat(values[::12], 3) for name, values in columns.items()}
    rows["time_s"] = rows["time_s"] + np.tile([0.0, 4.0, 8.0], len(columns["time_s"][::12]))
    log = write_log(tmp_path / "bursts.csv", rows)
    done = thermaltool("identify", log, *CALL, "--orders", "2,2,1", "--json")
    assert "in bursts of readings: the mean of each is one row, 200 in all" in done.err
    (model,) = done.json["models"]
    assert model["fit_training_percent"] > 90


@pytest.mark.parametrize("extra", [(), ("--continuous",), ("--structure", "bj"), ("--real-poles",)])
def test_simulate_takes_the_model(thermaltool, log, tmp_path, extra):
    model = tmp_path / "model.json"
    done = thermaltool("identify", log, *CALL, "--orders", "2,2,5", "-o", model, *extra)
    assert done.code == 0, done.err
    assert "d_z_um" in done.out
    assert "residuals" in done.out
    document = json.loads(model.read_text())
    assert document["terms"][0]["kind"] == "rational2"
    assert document["terms"][0]["parameters"]["delay"] == pytest.approx(20.0)
    done = thermaltool("simulate", model, log, "-o", tmp_path / "out.csv", "--json")
    assert done.code == 0, done.err
    assert done.json["d_z_um"]["fit_percent"] > 98


@pytest.mark.slow
@pytest.mark.parametrize("response", [
    Rational1(0.8, 3000.0, 600.0),
    pytest.param(Rational2(1.0, 6000.0, 0.5, 600.0, 600.0), marks=pytest.mark.slow),
])  # fmt: skip
def test_simulate_repeats_the_fit_to_one_step_from_rest(thermaltool, tmp_path, response):
    rows = np.arange(700)
    power = np.where(rows < 30, 0.0, 60.0)
    y = simulate_response(response, 60.0 * rows, power, "zero")
    y += 5.0 + 0.02 * np.random.default_rng(5).standard_normal(700)
    log = write_log(tmp_path / "step.csv",
                    {"time_s": 60.0 * rows, "Q_main_W": power, "d_z_um": y})  # fmt: skip
    model = tmp_path / "model.json"
    done = thermaltool("identify", log, *CALL, "-o", model, "--json")
    assert done.code == 0, done.err
    assert "--initial rest" not in done.err
    training = done.json["models"][0]["fit_training_percent"]
    done = thermaltool("simulate", model, log, "-o", tmp_path / "out.csv", "--json")
    assert training > 98
    assert done.json["d_z_um"]["fit_percent"] == pytest.approx(training, abs=1.0)


def test_a_fit_that_the_file_does_not_keep_is_told(thermaltool, columns, tmp_path):
    """A log that begins hot: run from rest the file is far off; simulate finds how it begins."""
    late = {name: values[150:900] for name, values in columns.items()}
    late["d_z_um"] = late["d_z_um"] + 30.0 * np.exp(-(late["time_s"] - 750.0) / 400.0)
    log, model = write_log(tmp_path / "late.csv", late), tmp_path / "model.json"
    done = thermaltool("identify", log, *CALL, "--orders", "2,2,5", "-o", model, "--json")
    assert done.json["models"][0]["fit_training_percent"] > 97
    (said,) = [line for line in done.err.splitlines() if "--initial rest" in line]
    call = ("simulate", model, log, "-o", tmp_path / "out.csv", "--json")
    fit = thermaltool(*call, "--initial", "rest").json["d_z_um"]["fit_percent"]
    assert f"to {fit:.3g} % with simulate --initial rest" in said
    assert thermaltool(*call).json["d_z_um"]["fit_percent"] > 97


def test_validation_on_another_log_and_two_outputs(thermaltool, log, columns, tmp_path):
    columns["d_x_um"] = 2 * columns["d_z_um"] - 9.0
    both = write_log(tmp_path / "both.csv", columns)
    columns["d_z_um"] = columns["d_z_um"] + 50.0  # a displacement has the zero of its log
    other = write_log(tmp_path / "other.csv", columns)
    done = thermaltool("identify", both, "--input", "Q_main_W", "--output", "d_z_um", "--output",
                       "d_x_um", "--orders", "2,2,5", "--validate", other, "--json")  # fmt: skip
    assert done.code == 0, done.err
    first, second = done.json["models"]
    assert first["validation"]["fit_percent"] == pytest.approx(
        first["fit_training_percent"], abs=0.5
    )
    gains = [m["terms"][0]["gain"]["value"] for m in (first, second)]
    assert gains[1] == pytest.approx(2 * gains[0], rel=1e-3)


@pytest.mark.parametrize("extra", [(), ("--continuous",)])
def test_a_held_and_a_running_input_together(thermaltool, columns, tmp_path, extra):
    """Power is held between rows, a temperature runs on; it is no fallback that both are joined."""
    rng = np.random.default_rng(4)
    air = 20 + np.convolve(rng.standard_normal(2410), np.ones(11) / 11, "valid")
    columns["T_air_degC"] = air
    columns["d_z_um"] = columns["d_z_um"] + simulate_response(
        Rational1(6.0, 200.0, 0.0), columns["time_s"], air - air[0], "first"
    )
    log = write_log(tmp_path / "two.csv", columns)
    done = thermaltool("identify", log, *CALL, "--input", "T_air_degC", *extra, "--orders", "2,2,5",
                       "--orders", "1,1,0", "--initial", "free", "--json")  # fmt: skip
    assert done.code == 0, done.err
    (model,) = done.json["models"]
    assert "of each input" in model["method"]
    assert "did not settle" not in done.err
    assert model["fit_training_percent"] > 98
    assert model["terms"][1]["gain"]["value"] == pytest.approx(6.0, rel=0.1)


def test_a_pause_parts_the_record(thermaltool, columns, tmp_path):
    kept = np.r_[0:1000, 1400:2400]
    gappy = write_log(tmp_path / "gap.csv", {n: v[kept] for n, v in columns.items()})
    done = thermaltool("identify", gappy, *CALL, "--orders", "2,2,5", "--json")
    assert done.code == 0
    assert "parted" in done.err
    assert done.json["models"][0]["fit_training_percent"] > 98


BAD = [
    ({"Q_main_W": lambda c: np.ones(2400)}, (), "Q_main_W does not excite"),
    ({"d_z_um": lambda c: np.ones(2400)}, (), "d_z_um is constant"),
    ({}, ("--orders", "2,2,4000"), "longer than the record"),
    ({}, ("--orders", "2,2,5", "--stop", "60"), "do not carry"),
    ({"Q_b_W": lambda c: 2 * c["Q_main_W"]}, ("--input", "Q_b_W"), "collinear"),
    ({"d_z_um": lambda c: np.where(c["time_s"] == 50, np.nan, c["d_z_um"])}, (), "d_z_um"),
]


@pytest.mark.parametrize(("changes", "extra", "message"), BAD)
def test_bad_input_is_one_clear_line(thermaltool, columns, tmp_path, changes, extra, message):
    changed = {**columns, **{name: make(columns) for name, make in changes.items()}}
    path = tmp_path / "bad.csv"
    write_log(path, changed)
    path.write_text(path.read_text().replace("nan", ""))
    done = thermaltool("identify", path, *CALL, *extra)
    assert done.code == 1
    assert message in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize(("extra", "message"), [
    (("--orders", "2,2"), "nb,nf,nk"),
    (("--split", "0.5", "--validate", "-"), "take one"),
    (("--output", "Q_main_W"), "named twice"),
    (("--continuous", "--structure", "arx"), "--continuous"),
])  # fmt: skip
def test_usage(thermaltool, log, extra, message):
    done = thermaltool("identify", log, *CALL, *extra)
    assert done.code == 2
    assert message in done.err


@pytest.mark.slow
@pytest.mark.parametrize("structure", [pytest.param("oe", marks=pytest.mark.slow), "arx", "armax"])
def test_hairdryer_delay_and_free_run(thermaltool, structure):
    """Three samples of delay; a free run over the second half at 85 % or better."""
    done = thermaltool("identify", whole_log("daisy/hairdryer_ljung.csv"), "--columns",
                       MAPS / "hairdryer.toml", "--input", "U_heater_V", "--output", "U_air_V",
                       "--structure", structure, "--split", "0.5", "--json")  # fmt: skip
    (model,) = done.json["models"]
    assert round(model["delay_s"] / 0.08) == 3
    assert model["validation"]["fit_percent"] >= 85


@pytest.mark.slow
def test_heating_system_held_out_half(thermaltool):
    done = thermaltool("identify", whole_log("daisy/heating_system.csv"), "--columns",
                       MAPS / "heating_system.toml", "--input", "U_lamp_V", "--output",
                       "T_plate_degC", "--split", "0.5", "--real-poles", "--json")  # fmt: skip
    (model,) = done.json["models"]
    assert model["validation"]["fit_state_estimated_percent"] > 86
    assert all(t > 0 for t in model["time_constants_s"])


def test_a_delayed_model_streams_from_a_measured_drive(thermaltool, log, columns, tmp_path):
    model, design = tmp_path / "model.json", tmp_path / "design.json"
    assert thermaltool("identify", log, *CALL, "--orders", "2,2,5", "-o", model).code == 0
    noise = tmp_path / "noise.json"
    assert thermaltool("noise", log, "-o", noise).code == 0
    done = thermaltool("regularize", model, "--noise", noise, "-o", design)
    assert done.code == 0, done.err
    assert thermaltool("estimate", design, log, "-o", tmp_path / "estimate.csv").code == 0
    estimated = np.genfromtxt(tmp_path / "estimate.csv", delimiter=",", names=True)
    name = next(n for n in estimated.dtype.names if "d_z_um" in n)
    truth = simulate_response(RESPONSE, columns["time_s"], columns["Q_main_W"], "zero")
    assert np.max(np.abs(estimated[name] - truth)) < 0.1


def test_a_drive_is_estimated_through_a_delay(thermaltool, columns, tmp_path):
    columns["dT_pair_K"] = columns["d_z_um"]
    log, model, noise = (tmp_path / name for name in ("log.csv", "model.json", "noise.json"))
    write_log(log, columns)
    call = ("--input", "Q_main_W", "--output", "dT_pair_K", "--output", "d_z_um")
    assert thermaltool("identify", log, *call, "--orders", "2,2,5", "-o", model).code == 0
    assert thermaltool("noise", log, "-o", noise).code == 0
    done = thermaltool("regularize", model, "--noise", noise)
    assert done.code == 0, done.err
    assert "s late: the estimator takes lags for that" in done.err


SHARED = ("--input", "Q_main_W", "--output", "d_z_um", "--output", "dT_pair_K",
          "--structure", "network")  # fmt: skip


@pytest.fixture
def pair(columns):
    """A displacement and a temperature with the same two time constants, without delay."""
    rng = np.random.default_rng(22)
    for name, response in (("d_z_um", Rational2(12.0, 400.0, 5.0, 40.0)),
                           ("dT_pair_K", Rational2(0.4, 400.0, 1.6, 40.0))):  # fmt: skip
        y = simulate_response(response, columns["time_s"], columns["Q_main_W"], "zero")
        columns[name] = y + 0.005 * rng.standard_normal(2400)
    return columns


@pytest.mark.slow
def test_a_network_shares_its_time_constants(thermaltool, pair, tmp_path):
    log, model = write_log(tmp_path / "pair.csv", pair), tmp_path / "model.json"
    done = thermaltool("identify", log, *SHARED, "--split", "0.6", "-o", model, "--json")
    assert done.code == 0, done.err
    first, second = done.json["models"]
    assert [m["output"] for m in (first, second)] == ["d_z_um", "dT_pair_K"]
    assert first["shared_with"] == ["dT_pair_K"]
    assert first["orders"] == {"modes": 2, "feedthrough": False}
    assert first["time_constants_s"] == second["time_constants_s"]
    assert first["time_constants_s"] == pytest.approx([400, 40], rel=0.02)
    for each in (first, second):
        assert each["structure"] == "network"
        assert (each["delay_s"], each["dead_time_s"]) == (5.0, 0.0)
        assert each["validation"]["fit_percent"] > 98
        assert each["candidates"][0]["modes"] == 2
        for estimate in each["parameters"].values():
            assert estimate["interval"][0] < estimate["value"] < estimate["interval"][1]
    document = json.loads(model.read_text())
    assert [t["kind"] for t in document["terms"]] == ["rational2", "rational2"]
    covariance = np.array(document["terms"][0]["covariance"])
    assert covariance.shape == (4, 4)
    assert np.all(np.linalg.eigvalsh(covariance) > 0)
    done = thermaltool("simulate", model, log, "-o", tmp_path / "out.csv", "--json")
    assert min(each["fit_percent"] for each in done.json.values()) > 98


@pytest.mark.slow
def test_other_commands_take_a_network(thermaltool, pair, tmp_path):
    """The power from the temperature, the displacement with it; its inverse; with a curve."""
    log, model, noise = (tmp_path / n for n in ("pair.csv", "model.json", "noise.json"))
    write_log(log, pair)
    done = thermaltool("identify", log, *SHARED, "--modes", "2", "-o", model)
    assert done.code == 0, done.err
    assert "2 shared modes" in done.out
    assert thermaltool("noise", log, "-o", noise).code == 0
    design, estimate = tmp_path / "design.json", tmp_path / "estimate.csv"
    # The power as it is read, and the power as the temperature tells it, late by its lags.
    for measured, share in ((("--measured", "Q_main_W"), 0.01), ((), 0.15)):
        done = thermaltool("regularize", model, "--noise", noise, *measured, "-o", design)
        assert done.code == 0, done.err
        assert thermaltool("estimate", design, log, "-o", estimate).code == 0
        table = np.genfromtxt(estimate, delimiter=",", names=True)
        left = pair["d_z_um"] - table["d_z_um"]
        assert np.std(left) < share * np.std(pair["d_z_um"])
    inverse = tmp_path / "inverse.json"
    done = thermaltool("invert", model, "--sensor", "d_z_um", "--filter", "20", "-o", inverse)
    assert done.code == 0, done.err
    assert thermaltool("correct", model, log, "-o", tmp_path / "bent.json").code == 0
    low, high = (tmp_path / f"{n}.json" for n in ("low", "high"))
    for path in (low, high):
        path.write_text(model.read_text())
    done = thermaltool("schedule", low, high, "--by", "Q_main_W", "--levels", "0.5,1.5",
                       "-o", tmp_path / "levels.json")  # fmt: skip
    assert done.code == 0, done.err


@pytest.mark.slow
def test_a_network_finds_its_delay(thermaltool, log):
    done = thermaltool("identify", log, *CALL, "--structure", "network", "--delay", "auto",
                       "--json")  # fmt: skip
    (model,) = done.json["models"]
    assert (model["delay_s"], model["dead_time_s"]) == (25.0, 20.0)
    assert model["time_constants_s"] == pytest.approx([400, 40], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("changes", "extra", "message"), [
    ({"Q_main_W": lambda c: np.ones(2400)}, (), "Q_main_W does not excite"),
    ({name: lambda c: np.ones(2400) for name in ("d_z_um", "dT_pair_K")}, (), "is constant"),
    ({}, ("--modes", "5"), "the data carry fewer"),
    ({}, ("--stop", "90", "--modes", "6", "--initial", "rest"), "do not carry 6 modes"),
    ({}, ("--delay", "40000"), "longer than the record"),
    ({"Q_b_W": lambda c: 2 * c["Q_main_W"]}, ("--input", "Q_b_W"), "collinear"),
    ({"d_z_um": lambda c: np.where(c["time_s"] == 50, np.nan, c["d_z_um"])}, (), "d_z_um"),
])  # fmt: skip
def test_bad_input_of_a_network_is_one_clear_line(
    thermaltool, pair, tmp_path, changes, extra, message
):
    changed = {**pair, **{name: make(pair) for name, make in changes.items()}}
    path = write_log(tmp_path / "bad.csv", changed)
    path.write_text(path.read_text().replace("nan", ""))
    done = thermaltool("identify", path, *SHARED, *extra)
    assert done.code == 1
    assert message in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize(("extra", "message"), [
    (("--structure", "network", "--orders", "2,2,1"), "--modes and --delay"),
    (("--modes", "2"), "--structure network"),
    (("--structure", "network", "--modes", "7"), "--modes"),
    (("--structure", "network", "--delay", "-5"), "below 0"),
    (("--structure", "network", "--delay", "soon"), "soon"),
])  # fmt: skip
def test_usage_of_a_network(thermaltool, log, extra, message):
    done = thermaltool("identify", log, *CALL, *extra)
    assert done.code == 2
    assert message in done.err
