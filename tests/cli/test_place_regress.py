"""``place`` and ``regress``: tables, documents, a figure, a model that others take, bad inputs."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from machines.expanding_rod import random_heat, rod_columns
from machines.warm_axis import axis_columns


def write(path, columns):
    names, rows = list(columns), np.column_stack(list(columns.values()))
    lines = [",".join(f"{v:.9g}" for v in row) for row in rows]
    path.write_text("\n".join([",".join(names), *lines]) + "\n")
    return path


@pytest.fixture
def log(tmp_path):
    rng = np.random.default_rng(3)
    return write(tmp_path / "my rod.csv", rod_columns(random_heat(rng, 360, 60), 10.0, rng, 0.02))


def test_place_says_which_sensors_and_what_the_next_gains(thermaltool, log, tmp_path):
    figure = tmp_path / "place.png"
    options = ("--output", "d_tip_um", "--sensors", 3, "--static")
    result = thermaltool("place", log, *options, "--plot", figure)
    assert result.code == 0
    assert "next gains" in result.out
    assert "say the same" in result.out
    assert figure.read_bytes().startswith(b"\x89PNG")
    document = thermaltool("place", log, *options, "--json").json
    sets = document["sets"]
    assert [each["count"] for each in sets] == [1, 2, 3]
    assert sets[0]["gain_of_the_next"] == pytest.approx(
        1 - sets[1]["rmse"]["d_tip_um"] / sets[0]["rmse"]["d_tip_um"]
    )


@pytest.mark.parametrize("criterion", ["I", "A", "D"])
def test_place_by_design(thermaltool, log, criterion):
    options = ("--output", "d_tip_um", "--criterion", criterion, "--sensors", 3)
    document = thermaltool("place", log, *options, "--json").json
    assert all(0 < each["efficiency_at_least"] <= 1 for each in document["sets"])
    dear = ("--cost", "T_1_degC=2", "--forbid", "T_2_degC")
    sets = thermaltool("place", log, *options, *dear, "--json").json["sets"]
    assert not any("T_2_degC" in each["sensors"] for each in sets)


BODY = Path(__file__).parents[2] / "data_samples/bodies/rod.toml"


@pytest.mark.parametrize("criterion", ["I", "modes"])
def test_place_on_a_body(thermaltool, tmp_path, criterion):
    figure = tmp_path / "body.png"
    options = ("--criterion", criterion, "--forbid", "left", "--reading-noise", 0.05,
               "--sensors", 2)  # fmt: skip
    result = thermaltool("place", BODY, *options, "--plot", figure)
    assert result.code == 0
    assert "from the heat m" in result.out
    assert figure.read_bytes().startswith(b"\x89PNG")
    document = thermaltool("place", BODY, *options, "--json").json
    assert document["reading_noise_K"] == 0.05
    chosen = {name for each in document["sets"] for name in each["sensors"]}
    assert set(document["places_m"]) == chosen
    assert all(x > 0 for (x,) in document["places_m"].values())


def test_options_of_logs_and_of_bodies_are_told_apart(thermaltool, log):
    for source, option, words in (
        (BODY, ("--static",), "--static is of logs"),
        (BODY, ("--nan-policy", "omit"), "--nan-policy is of logs"),
        (BODY, ("--criterion", "held-out"), "held-out is of logs"),
        (log, (), "logs need --output"),
        (log, ("--output", "d_tip_um", "--criterion", "modes"), "--criterion modes is of a body"),
        (log, ("--output", "d_tip_um", "--reading-noise", 1), "--reading-noise is of a body"),
    ):
        result = thermaltool("place", source, *option)
        assert (result.code, result.out) == (2, "")
        assert words in result.err
    result = thermaltool("place", BODY, log, "--output", "d_tip_um")
    assert (result.code, result.out) == (2, "")
    assert "is a body, which comes without logs" in result.err


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--sensors", "10"), 1, "10 sensors of 9 candidates"),
        (("--candidate", "T_x_degC"), 1, "T_x_degC"),
        (("--forbid", "T_x_degC"), 1, "no such candidate to forbid"),
        (("--cost", "T_1_degC=2"), 2, "count for the criteria I, A and D"),
        (("--static", "--time-constant", "60"), 2, "--static has no --time-constant"),
        (("--criterion", "I", "--cost", "T_1_degC=-1"), 1, "above zero"),
    ],
)
def test_place_refuses_in_one_line(thermaltool, log, options, code, words):
    result = thermaltool("place", log, "--output", "d_tip_um", *options)
    assert result.code == code
    assert words in result.err


@pytest.mark.slow
def test_constant_candidates_are_left_out(thermaltool, log):
    lines = log.read_text().splitlines()
    wide = [lines[0] + ",T_dead_degC", *(line + ",21.5" for line in lines[1:])]
    text = "\n".join(wide) + "\n"
    result = thermaltool("place", "-", "--output", "d_tip_um", "--sensors", 1, stdin=text)
    assert result.code == 0
    assert "T_dead_degC never moves: it is no candidate" in result.err
    result = thermaltool("regress", "-", "--output", "d_tip_um", stdin=text)
    assert result.code == 0
    assert "T_dead_degC never moves: it is left out" in result.err
    named = ("--sensor", "T_1_degC", "--sensor", "T_dead_degC")
    result = thermaltool("regress", "-", "--output", "d_tip_um", *named, stdin=text)
    assert result.code == 1
    assert "T_dead_degC never moves in training" in result.err


@pytest.mark.parametrize(
    "call", [("place", "--sensors", 1, "--static"), ("regress", "--static", "--sensor", "T_1_degC")]
)
def test_a_cell_that_nothing_needs_and_a_sensor_that_sticks_are_told(thermaltool, log, call):
    lines = log.read_text().splitlines()
    at = lines[0].split(",").index("T_1_degC")
    rows = [line.split(",") for line in lines[1:]]
    for row in rows[100:]:
        row[at] = rows[100][at]
    wide = [lines[0] + ",n_spindle_rpm", *(",".join([*row, "100"]) for row in rows)]
    wide[40] = wide[40].removesuffix("100") + "1o0"
    log.write_text("\n".join([*wide, ""]))
    command, *options = call
    result = thermaltool(command, log, "--output", "d_tip_um", *options)
    assert result.code == 0
    told = [line for line in result.err.splitlines() if str(log) in line]
    unread, stuck = told
    assert unread == f"{log}:41: n_spindle_rpm: not a number: '1o0': taken as a missing value"
    assert stuck.startswith(f"{log}:102: T_1_degC: ")
    assert "for 260 rows: a sensor that is stuck? These rows count" in stuck
    wide[40] = wide[40].replace(rows[39][at], "2l.0", 1)
    log.write_text("\n".join([*wide, ""]))
    result = thermaltool(command, log, "--output", "d_tip_um", *options)
    assert (result.code, result.out) == (1, "")
    assert f"{log}:41: T_1_degC: not a number: '2l.0'" in result.err


def test_a_log_that_judges_itself_and_a_temperature_as_a_position_are_told(
    thermaltool, log, tmp_path
):
    again = tmp_path / "copy.csv"
    again.write_bytes(log.read_bytes())
    own = ("--output", "d_tip_um", "--static")
    result = thermaltool("place", log, again, *own, "--sensors", 1)
    assert (result.code, result.err.count("the same log again")) == (0, 1)
    one = (*own, "--sensor", "T_1_degC")
    result = thermaltool("regress", log, *one, "--validate", again)
    assert result.code == 0
    assert "copy.csv: it was fitted: that it is held says nothing" in result.err
    result = thermaltool("regress", log, *one, "--position", "T_2_degC")
    assert (result.code, result.out) == (2, "")
    assert "T_2_degC is a temperature: no position along an axis" in result.err


def streamed(model, log):
    tool = [sys.executable, "-c", "from thermaltool.cli import main; main()"]
    call = [*tool, "compensate", model, log, "--also", "estimates"]
    done = subprocess.run(call, capture_output=True, text=True)
    assert "which the machine cannot" not in done.stderr
    # The last line is the safe setpoint.
    rows = [line.split(",") for line in done.stdout.splitlines()[1:-1]]
    return {float(row[0]): float(row[-1]) for row in rows}


def in_batch(thermaltool, model, log):
    rows = [line.split(",") for line in thermaltool("estimate", model, log, "-q").out.splitlines()]
    return {float(row[0]): float(row[1]) for row in rows[1:]}


def test_a_regression_simulates_and_streams(thermaltool, log, tmp_path):
    model, ready = tmp_path / "model.json", tmp_path / "ready.json"
    options = ("--output", "d_tip_um", "--sensor", "T_1_degC", "--sensor", "T_5_degC")
    result = thermaltool("regress", log, *options, "-o", model)
    assert result.code == 0
    assert "least-squares" in result.out
    assert "lagged" in result.out or "static" in result.out
    simulated = thermaltool("simulate", model, log, "--json").json
    assert simulated["d_tip_um"]["fit_percent"] > 95
    assert thermaltool("regularize", model, "-o", ready, "-q").code == 0
    assert streamed(ready, log) == pytest.approx(in_batch(thermaltool, ready, log), abs=1e-9)
    assert thermaltool("present", model).code == 0


@pytest.mark.slow
def test_an_axis_by_its_position(thermaltool, tmp_path):
    train, test = axis_columns(np.random.default_rng(4))
    first, second = write(tmp_path / "a.csv", train), write(tmp_path / "b.csv", test)
    model = tmp_path / "axis.json"
    options = ("--output", "d_z_um", "--position", "x_z_mm", "--validate", second)
    result = thermaltool("regress", first, *options, "-o", model)
    assert result.code == 0
    assert "with powers 0, 1 of x_z_mm" in result.err
    simulated = thermaltool("simulate", model, second, "--json").json
    assert simulated["d_z_um"]["rmse"] < 0.5
    document = thermaltool("regress", first, *options, "--json").json
    assert {t["power"] for t in document["outputs"][0]["terms"]} == {0, 1}
    # Sets with pauses between: the machine went on meanwhile, and no sensor has jumped. The first
    # line behind a pause waits for another that bears out its time.
    ready = tmp_path / "ready.json"
    assert (
        "from dT_1_K, dT_2_K, dT_3_K, x_z_mm\n" in thermaltool("regularize", model, "-o", ready).err
    )
    computed, stream = in_batch(thermaltool, ready, second), streamed(ready, second)
    assert set(computed) - set(stream) == {test["time_s"][k] for k in range(17, 136, 17)}
    assert stream == pytest.approx({t: computed[t] for t in stream}, abs=1e-9)


def test_positions_without_readings_and_degrees_without_position(thermaltool, tmp_path):
    train, _ = axis_columns(np.random.default_rng(4))
    train["x_z_mm"][:] = np.nan
    path = write(tmp_path / "a.csv", train)
    path.write_text(path.read_text().replace("nan", ""))
    options = ("--output", "d_z_um", "--position", "x_z_mm", "--nan-policy", "omit")
    result = thermaltool("regress", path, *options)
    assert result.code == 1
    assert "x_z_mm" in result.err
    assert result.err.count("\n") == 1
    result = thermaltool("regress", path, "--output", "d_z_um", "--degree", 1)
    assert result.code == 2
    assert "a degree needs a position" in result.err


@pytest.mark.slow
def test_states_carry_on_over_a_pause(thermaltool, tmp_path):
    rng = np.random.default_rng(8)
    columns = rod_columns(random_heat(rng, 1080, 60), 10.0, rng, 0.02)
    # The pause is short beside the states, which are thus known behind it.
    kept = (np.arange(1080) < 500) | (np.arange(1080) >= 520)
    path = write(tmp_path / "a.csv", {name: values[kept] for name, values in columns.items()})
    options = ("--output", "d_tip_um", "--sensor", "T_1_degC", "--max-gap", 60)
    lags = ("--time-constant", 600, "--time-constant", 3000)
    model = tmp_path / "model.json"
    result = thermaltool("regress", path, *options, *lags, "-o", model)
    assert "the sensors are taken along a straight line over it" in result.err
    paused = thermaltool("regress", path, *options, *lags, "--json").json["outputs"][0]
    simulated = thermaltool("simulate", model, path, "--max-gap", 60, "--json").json["d_tip_um"]
    # A simulation takes its zero from the first rows, a fit from all.
    about_mean = (simulated["rmse"] ** 2 - simulated["mean"] ** 2) ** 0.5
    assert about_mean == pytest.approx(paused["rmse"], rel=1e-3)
    whole = write(tmp_path / "b.csv", columns)
    other = thermaltool("regress", whole, *options, *lags, "--json").json["outputs"][0]
    assert paused["rmse"] == pytest.approx(other["rmse"], rel=0.2)


def with_column(log, name, cells):
    first, *lines = log.read_text().splitlines()
    wide = [f"{line},{cell}" for line, cell in zip(lines, cells, strict=True)]
    log.write_text("\n".join([f"{first},{name}", *wide]) + "\n")


def test_a_candidate_with_holes_is_named(thermaltool, log):
    cells = ["" if 100 <= k < 220 else f"{20 + k % 7}" for k in range(360)]
    with_column(log, "T_holes_degC", cells)
    options = ("--output", "d_tip_um", "--sensors", 1, "--static")
    result = thermaltool("place", log, *options)
    assert result.code == 1
    assert "csv:102: T_holes_degC: missing value (120 in all): see --nan-policy" in result.err
    result = thermaltool("place", log, *options, "--nan-policy", "omit")
    assert result.code == 0
    assert "T_holes_degC has no reading in 120 of 360 rows" in result.err
    result = thermaltool("place", log, *options, "--forbid", "T_holes_degC")
    assert result.code == 0
    assert result.err == ""
    result = thermaltool("regress", log, *options[:2])
    assert "T_holes_degC: missing value" in result.err


def test_an_empty_candidate_is_none(thermaltool, log):
    with_column(log, "T_none_degC", [""] * 360)
    result = thermaltool("place", log, "--output", "d_tip_um", "--sensors", 1, "--static")
    assert result.code == 0
    assert "T_none_degC never has a reading: it is no candidate" in result.err
    result = thermaltool("place", log, "--output", "d_tip_um", "--sensors", 10)
    assert "T_none_degC never has a reading" in result.err
    result = thermaltool("regress", log, "--output", "d_tip_um", "--static")
    assert result.code == 0
    assert "T_none_degC never has a reading: it is left out" in result.err


@pytest.mark.parametrize(
    ("command", "options", "words"),
    [
        ("place", ("--forbid", "T_1_deg"), "near: T_1_degC"),
        ("place", ("--criterion", "I", "--cost", "T_1_deg=2"), "near: T_1_degC"),
        ("place", ("--candidate", "d_tip_um"), "d_tip_um is a sensor and an output"),
        ("place", ("--candidate", "T_1_degC", "--candidate", "T_1_degC"), "given twice"),
        ("regress", ("--sensor", "T_1_degC", "--position", "T_1_degC"), "a sensor and the"),
        ("regress", ("--output", "d_tip_um"), "d_tip_um is given twice among the outputs"),
    ],
)
def test_names_are_known_and_have_one_role(thermaltool, log, command, options, words):
    result = thermaltool(command, log, "--output", "d_tip_um", *options)
    assert result.code in (1, 2)
    assert words in result.err


def test_cheap_sensors_cost_no_more_than_all(thermaltool, log):
    costs = [each for k in range(1, 10) for each in ("--cost", f"T_{k}_degC=0.1")]
    document = thermaltool(
        "place", log, "--output", "d_tip_um", "--criterion", "I", *costs, "--json"
    ).json
    assert document["sets"][-1]["count"] == 9


@pytest.mark.slow
def test_logs_update_a_body(thermaltool, tmp_path):
    rng = np.random.default_rng(4)
    heat = random_heat(rng, 360, 60)
    columns = rod_columns(0.8 * heat, 10.0, rng, 0.05)
    log = write(tmp_path / "my rod.csv", {**columns, "Q_motor_W": heat})
    model = tmp_path / "model.json"
    result = thermaltool("calibrate", log, "--body", BODY, "--json", "-o", model)
    assert result.code == 0
    share = next(p for p in result.json["parameters"] if p["kind"] == "heat")
    assert share["value"] == pytest.approx(0.8, rel=0.05)
    assert share["identified"]
    assert thermaltool("simulate", model, log, "-o", tmp_path / "out.csv").code == 0
    assert "film coefficient" in thermaltool("calibrate", log, "--body", BODY, "-o", model).err
    assert thermaltool("calibrate", log, "--body", BODY, "-o", model, "--max-rmse", 1e-6).code == 3


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ((), 2, "needs --drive, or --body"),
        (("--body", BODY, "--drive", "Q_motor_W"), 2, "--drive has no meaning beside --body"),
        (("--body", BODY, "--linear"), 2, "--linear has no meaning beside --body"),
        (("--body", BODY), 1, "no column Q_motor_W"),
    ],
)
def test_a_body_has_no_responses_to_choose(thermaltool, log, options, code, words):
    result = thermaltool("calibrate", log, *options)
    assert (result.code, result.out) == (code, "")
    assert words in result.err


def test_few_rows_and_a_sensor_that_is_dead_where_it_judges_are_told(thermaltool, log, tmp_path):
    lines = log.read_text().splitlines()
    short = tmp_path / "short.csv"
    short.write_text("\n".join(lines[:7]) + "\n")
    own = ("--output", "d_tip_um")
    for criterion, words in (("held-out", "6 rows: too few to hold out each of 5 blocks"),
                             ("I", "short.csv with readings of all: moments of")):  # fmt: skip
        result = thermaltool("place", short, *own, "--criterion", criterion)
        assert (result.code, result.out) == (1, "")
        assert words in result.err
    assert thermaltool("regress", short, *own, "--sensor", "T_1_degC").code == 0
    at, dead = lines[0].split(",").index("T_3_degC"), tmp_path / "dead.csv"
    rows = [line.split(",") for line in lines]
    dead.write_text("\n".join(",".join([*r[:at], r[at] if not k else "21.5", *r[at + 1 :]])
                              for k, r in enumerate(rows)) + "\n")  # fmt: skip
    sensors = ("--sensor", "T_1_degC", "--sensor", "T_3_degC", "--static")
    result = thermaltool("regress", log, *own, *sensors, "--validate", dead)
    assert result.code == 0
    assert "dead.csv: T_3_degC never moves: what is missed there may be" in result.err


def test_candidates_of_which_a_noise_file_says_nothing_are_named(thermaltool, log, tmp_path):
    noise = tmp_path / "noise.json"
    lines = log.read_text().splitlines()[:100]
    log.write_text("\n".join([*lines, ""]))
    assert thermaltool("noise", log, "-o", noise).code == 0
    log.write_text("\n".join([lines[0].replace("T_4_degC", "T_rear_degC"), *lines[1:]]) + "\n")
    options = ("--output", "d_tip_um", "--criterion", "I", "--sensors", 1, "--noise", noise)
    result = thermaltool("place", log, *options)
    assert result.code == 0
    assert "no white noise of T_rear_degC in the noise file: by the logs instead" in result.err
