from __future__ import annotations

import signal
import subprocess
import sys

import click
import numpy as np
import pytest
from click.testing import CliRunner
from pyarrow import parquet
from scipy.signal import lfilter

from thermaltool.cli import fit
from thermaltool.cli.forecast import command
from thermaltool.errors import LogError
from thermaltool.logs import read_log, write_table
from thermaltool.logs.formats import FORMATS
from thermaltool.logs.series import read_series
from thermaltool.runtime.sinks import SINKS
from thermaltool.timeseries.criteria import OrderCriteria
from thermaltool.timeseries.forecast import forecast
from thermaltool.timeseries.model import ArmaModel
from thermaltool.timeseries.runs import even_record


def run(what, *args):
    done = CliRunner().invoke(what, [str(a) for a in args], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return done


@pytest.fixture
def log(tmp_path):
    noise = np.random.default_rng(5).standard_normal(500)
    x = 20.0 + lfilter([1.0, 0.4], [1.0, -0.8], noise)[200:]
    path = tmp_path / "log.csv"
    rows = [f"{15 * k},{value:.17g}" for k, value in enumerate(x)]
    path.write_text("time_s,T_room_degC\n" + "\n".join(rows) + "\n")
    return path


def test_forecasts_go_on_from_the_end(log, tmp_path):
    model = tmp_path / "arma.json"
    run(fit.command, log, "-C", "T_room_degC", "--order", "1,1", "-o", model)
    lines = run(command, model, log, "--steps", 50).stdout.splitlines()
    assert lines[0] == "time_s,forecast_T_room_degC,low_T_room_degC,high_T_room_degC"
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    assert rows[0, 0] == 300 * 15
    assert rows.shape == (50, 4)
    assert (np.diff(rows[:, 3] - rows[:, 2]) > -1e-9).all()
    assert rows[-1, 1] == pytest.approx(20.0, abs=1.5)  # the mean, in the end


def test_a_log_of_another_period_is_refused(log, tmp_path):
    model = tmp_path / "arma.json"
    run(fit.command, log, "-C", "T_room_degC", "--order", "1,0", "-o", model)
    with pytest.raises(LogError, match="period of 15 s"):
        run(command, model, log, "--period", 5)


def arima(ar, ma, difference):
    entry = OrderCriteria(len(ar), len(ma), 0.0, 1.0, 100, 0, True)
    return ArmaModel("x", 1.0, difference, np.array(ar, float), np.array(ma, float), (),
                     np.empty((0, 0)), 1.0, None, entry, "ml")  # fmt: skip


@pytest.mark.parametrize(("ar", "ma", "d"), [([0.6], [0.3], 0), ([0.5], [0.4], 1), ([], [-0.3], 2)])
def test_intervals_cover_what_comes(ar, ma, d):
    """The share of later samples inside 90 % intervals, ten steps ahead, 400 records."""
    rng, inside = np.random.default_rng(8), []
    model = arima(ar, ma, d)
    for _ in range(400):
        x = lfilter(np.r_[1.0, ma], np.r_[1.0, -np.array(ar)], rng.standard_normal(160))
        for _ in range(d):
            x = np.cumsum(x)
        ahead = forecast(model, even_record(x[:150]), 10, 0.9)
        inside.append((ahead.low < x[150:]) & (x[150:] < ahead.high))
    share = np.mean(inside, axis=0)
    # Three standard errors of 400 draws.
    assert np.all(np.abs(share - 0.9) < 3 * np.sqrt(0.09 / 400))


def test_a_random_walk_stays_where_it_is():
    x = np.cumsum(np.random.default_rng(1).standard_normal(80))
    ahead = forecast(arima([], [], 1), even_record(x), 5)
    np.testing.assert_allclose(ahead.value, x[-1])
    np.testing.assert_allclose(ahead.error, np.sqrt(np.arange(1.0, 6.0)))


@pytest.mark.parametrize("options", [("--difference", 1), ("--detrend", "linear")])
def test_a_stream_takes_no_differences_and_no_line(log, tmp_path, options):
    model = tmp_path / "arma.json"
    run(fit.command, log, "-C", "T_room_degC", "--order", "1,0", *options, "-o", model)
    done = CliRunner().invoke(command, [str(model), str(log), "--stream"])
    assert done.exit_code == 2
    assert done.stdout == ""
    assert "--stream takes models without --difference and linear trend" in done.stderr


def test_a_stream_has_no_start_and_no_stop(log, tmp_path):
    model = tmp_path / "arma.json"
    run(fit.command, log, "-C", "T_room_degC", "--order", "1,0", "-o", model)
    done = CliRunner().invoke(command, [str(model), str(log), "--stream", "--stop", "9"])
    assert done.exit_code == 2
    assert "--start and --stop are for logs" in done.stderr


@pytest.mark.parametrize("size", [40.0, 1e6, 1e12])
@pytest.mark.parametrize("place", [-1, -3])
def test_an_outlier_near_the_end_counts_as_missing(tmp_path, size, place):
    """As in `fit`: the forecast is that of the log without it."""
    x = lfilter([1.0], [1.0, -0.8], np.random.default_rng(7).standard_normal(600))
    model = tmp_path / "m.json"
    runner = CliRunner()

    def ahead(values, *options):
        path = tmp_path / "x.csv"
        path.write_text("time_s,y\n" + "".join(f"{k},{v!r}\n" for k, v in enumerate(values)))
        if not model.exists():
            made = runner.invoke(fit.command, [str(path), "-C", "y", "--order", "1,0",
                                               "-o", str(model)])  # fmt: skip
            assert made.exit_code == 0
        done = runner.invoke(command, [str(model), str(path), *options])
        assert done.exit_code == 0
        return float(done.stdout.splitlines()[-1].split(",")[1])

    clean = ahead(x.tolist())
    spoiled = x.copy()
    spoiled[place] = size
    assert ahead(spoiled.tolist()) == pytest.approx(clean, abs=3.0)
    if place == -1:
        assert ahead(spoiled.tolist(), "--outliers", "keep") > 0.7 * size


@pytest.fixture
def fitted(log, tmp_path):
    model = tmp_path / "arma.json"
    run(fit.command, log, "-C", "T_room_degC", "--order", "1,0", "-o", model)
    return model


TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


def streamed(*args, out=subprocess.PIPE):
    line = [*TOOL, "forecast", *map(str, args), "--stream"]
    return subprocess.run(line, stdout=out, stderr=subprocess.PIPE, timeout=60)


@pytest.mark.slow
def test_a_stream_to_parquet_is_a_readable_file(fitted, log, tmp_path):
    path = tmp_path / "ahead.parquet"
    with open(path, "wb") as out:
        done = streamed(fitted, log, "--to", "parquet", out=out)
    assert (done.returncode, done.stderr) == (0, b"")
    table = parquet.read_table(path)
    lines = streamed(fitted, log, "--to", "csv").stdout.decode().splitlines()
    assert table.column_names == lines[0].split(",")
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    np.testing.assert_array_equal(np.column_stack([c.to_numpy() for c in table.columns]), rows)
    record, counted = read_series(str(path), "forecast_T_room_degC")
    assert (len(record), counted) == (300, False)


@pytest.mark.slow
def test_a_stream_to_parquet_that_is_ended_by_a_signal_is_whole(fitted, log, tmp_path):
    path = tmp_path / "ahead.parquet"
    text = log.read_bytes().splitlines(keepends=True)
    with open(path, "wb") as out:
        process = subprocess.Popen(
            [*TOOL, "forecast", str(fitted), "--stream", "--to", "parquet", "--timeout", "1"],
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=subprocess.PIPE,
            bufsize=0,
        )
        process.stdin.write(b"".join(text[:101]))
        # Once it tells of the silence, it has read all lines.
        assert b"no line for 1 s" in process.stderr.readline()
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)
    assert process.returncode == 143
    assert parquet.read_table(path).num_rows == 100


@pytest.mark.slow
def test_a_stream_reads_lines_only(fitted, log, tmp_path):
    table = read_log(str(log))
    columns = {"time_s": table.time, **table.columns}
    table, lines = tmp_path / "log.parquet", tmp_path / "log.ndjson"
    for path in (table, lines):
        write_table(columns, str(path))
    done = CliRunner().invoke(command, [str(fitted), str(table), "--stream"])
    assert done.exit_code == 2
    assert "a stream reads lines, not parquet: there are csv, ndjson" in done.stderr
    # A file's format follows its suffix, as in a batch.
    done = streamed(fitted, lines)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout == streamed(fitted, log).stdout


def test_a_stream_writes_to_stdout_alone(fitted, log, tmp_path):
    to = ("-o", str(tmp_path / "ahead.parquet"))
    done = CliRunner().invoke(command, [str(fitted), str(log), "--stream", *to])
    assert (done.exit_code, done.stdout) == (2, "")
    assert "--stream writes to stdout" in done.stderr
    assert not (tmp_path / "ahead.parquet").exists()


def test_a_sink_goes_with_a_stream(fitted, log, monkeypatch):
    to = next(option for option in command.params if option.name == "to_format")
    assert set(to.type.choices) == {*FORMATS, *SINKS}
    monkeypatch.setattr(to, "type", click.Choice(["udp"]))
    done = CliRunner().invoke(command, [str(fitted), str(log), "--to", "udp"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert "--to udp goes with --stream" in done.stderr


@pytest.mark.slow
def test_a_stream_takes_outliers_as_they_are(fitted, log, tmp_path):
    """100 K above the rest, 40 standard deviations: left out, or the start of a new forecast."""
    lines = log.read_text().splitlines(keepends=True)
    lines[200] = f"{15 * 199},120\n"
    spoiled = tmp_path / "spoiled.csv"
    spoiled.write_text("".join(lines))

    def after_the_outlier(*options):
        done = streamed(fitted, spoiled, *options)
        assert done.returncode == 0
        rows = [line.split(",") for line in done.stdout.decode().splitlines()[1:]]
        (value,) = (float(row[1]) for row in rows if float(row[0]) == 15 * 200)
        return value, done.stderr.decode()

    for options in ((), ("--outliers", "omit")):
        value, messages = after_the_outlier(*options)
        assert abs(value - 20) < 10
        assert "taken for an outlier" in messages
    value, messages = after_the_outlier("--outliers", "keep")
    assert value > 80
    assert "outlier" not in messages


@pytest.mark.slow
def test_a_stream_forgets_the_samples_before_a_pause(fitted, log, tmp_path):
    """A pause of 4 samples: bridged by default, as of 10 in a batch; not above --max-gap."""
    lines = log.read_text().splitlines(keepends=True)
    paused = tmp_path / "paused.csv"
    paused.write_text("".join([*lines[:200], *lines[203:]]))
    for options, told in (
        ((), False),
        (("--max-gap", 60), False),
        (("--max-gap", 59), True),
    ):
        done = streamed(fitted, paused, *options)
        assert done.returncode == 0
        assert ("a pause of 60 s: lags forgotten" in done.stderr.decode()) == told
    long = tmp_path / "long.csv"
    long.write_text("".join([*lines[:200], *lines[220:]]))
    for options, told in (((), True), (("--max-gap", 1000), False)):
        done = streamed(fitted, long, *options)
        assert ("lags forgotten" in done.stderr.decode()) == told


@pytest.mark.parametrize("option", ["--level", "--forgetting"])
def test_a_share_that_is_no_number_is_refused(fitted, log, option):
    done = CliRunner().invoke(command, [str(fitted), str(log), "--stream", option, "nan"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert "'nan' is not a finite number" in done.stderr
