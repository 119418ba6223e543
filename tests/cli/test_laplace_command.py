import io
import json
import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from thermaltool.cli.laplace import command
from thermaltool.errors import FitError, LogError
from thermaltool.laplace import METHODS


def run(*args, stdin=None):
    return CliRunner().invoke(command, [str(a) for a in args], input=stdin, catch_exceptions=False)


def table(text):
    return np.genfromtxt(io.StringIO(text), delimiter=",", names=True)


def test_grid_of_times_as_csv():
    result = run("exp(-r*sqrt(s))/s", "-p", "r=2", "--times", "0.1:100:5:log")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.splitlines()[0] == "time_s,value_1,error_1"
    rows = table(result.stdout)
    np.testing.assert_allclose(rows["time_s"], np.geomspace(0.1, 100, 5))
    exact = [math.erfc(1 / math.sqrt(t)) for t in rows["time_s"]]
    np.testing.assert_allclose(rows["value_1"], exact, atol=1e-12)
    assert (rows["error_1"] < 1e-9).all()


def test_single_times_and_a_linear_grid():
    rows = table(run("1/s**2", "--times", "1:3:3", "--time", 7, "--time", 5).stdout)
    np.testing.assert_array_equal(rows["time_s"], [1, 2, 3, 7, 5])
    np.testing.assert_allclose(rows["value_1"], [1, 2, 3, 7, 5], rtol=1e-9)


def test_times_from_the_clock_of_a_log(tmp_path):
    log = "time_s,T_room_degC\n1,20\n4,21\n"
    path = tmp_path / "log.csv"
    path.write_text(log)
    from_pipe, from_file = run("1/(s+1)", stdin=log), run("1/(s+1)", path)
    assert from_pipe.stdout == from_file.stdout
    np.testing.assert_allclose(table(from_pipe.stdout)["value_1"], np.exp([-1, -4]), atol=1e-12)


def test_header_only_gives_a_header():
    result = run("1/s", "-", stdin="time_s\n")
    assert (result.exit_code, result.stdout) == (0, "time_s,value_1,error_1\n")


def test_log_that_starts_at_zero():
    with pytest.raises(LogError, match="above 0 s"):
        run("1/s", "-", stdin="time_s\n0\n1\n")


def test_error_above_tolerance_writes_warns_and_exits_with_3():
    result = run("exp(-s)/s", "--time", 0.5, "--time", 1.0001, "--time", 2)
    assert result.exit_code == 3
    assert len(result.stdout.splitlines()) == 4
    assert len(result.stderr.splitlines()) == 1
    assert "at t = 1.0001 s exceeds 1e-09 (1 of 3 times)" in result.stderr


def test_looser_tolerance_passes():
    assert run("exp(-s)/s", "--time", 1.01, "--tol", 0.5).exit_code == 0


def test_a_pole_in_the_right_half_plane_is_found():
    result = run("1/(s+1)+1e-6/(s-0.3)", "--times", "1:50:50")
    exact = [math.exp(-t) + 1e-6 * math.exp(0.3 * t) for t in range(1, 51)]
    np.testing.assert_allclose(table(result.stdout)["value_1"], exact, rtol=1e-8)
    one = run("1/(s+1)+1e-6/(s-0.3)", "--time", 50, "--json", "--tol", 1e-6)
    assert one.exit_code == 0
    assert abs(json.loads(one.stdout)["abscissa"] - 0.3) < 0.06


def test_a_large_function_is_met_by_its_own_measure():
    assert run("1e12/(s+1)", "--times", "0.1:20:30").exit_code == 0
    assert run("1e12/(s+1)", "--times", "0.1:20:30", "--rtol", 0).exit_code == 3


def test_json():
    result = run("1/(s-1)", "--time", 2, "--abscissa", 1, "--method", "talbot", "--json")
    report = json.loads(result.stdout)
    assert report["method"] == "talbot"
    assert report["evaluations"] > 38
    assert report["time_s"] == [2.0]
    assert abs(report["value_1"][0] - math.e**2) <= 10 * report["error_1"][0]


def test_parquet_and_ndjson(tmp_path):
    path = tmp_path / "f.parquet"
    assert run("1/s", "--time", 1, "-o", path).exit_code == 0
    assert pq.read_table(path).column_names == ["time_s", "value_1", "error_1"]
    row = json.loads(run("1/s", "--time", 1, "--to", "ndjson").stdout)
    assert abs(row["value_1"] - 1) < 1e-12


def test_no_answer_is_an_empty_cell():
    result = run("1/(s-1)", "--time", 1000, "--abscissa", 1)  # e^1000
    assert result.exit_code == 3
    assert result.stdout.splitlines()[1] == "1000,,"
    report = json.loads(run("1/(s-1)", "--time", 1000, "--abscissa", 1, "--json").stdout)
    assert report["value_1"] == report["error_1"] == [None]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["1/(s+", "--time", "1"], "EXPRESSION: column"),
        (["1/s", "--time", "1", "--abscissa", "far"], "'far' is not"),
        (["k*s", "--time", "1"], "unknown name 'k'"),
        (["1/s", "--times", "0:1:3"], "0 < START"),
        (["1/s", "--times", "1:2"], "START:STOP:COUNT"),
        (["1/s", "--times", "1:2:3:cubic"], "log or lin"),
        (["1/s", "--times", "1:inf:3"], "0 < START"),
        (["1/s", "--time", "-1"], "x>0"),
        (["1/s", "--time", "1", "-p", "a"], "NAME=NUMBER"),
        (["1/s", "--time", "1", "--method", "weeks"], "weeks"),
    ],
)
def test_usage_errors(args, message):
    result = run(*args)
    assert result.exit_code == 2
    assert message in result.stderr


def test_transfer_that_is_not_finite_is_an_error():
    with pytest.raises(FitError, match="at s ="):
        run("9**9**9/s", "--time", 1)


def test_methods_offered_are_those_of_the_library():
    option = next(p for p in command.params if p.name == "method")
    assert tuple(option.type.choices) == METHODS
