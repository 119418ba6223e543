from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from thermaltool.cli.order import command
from thermaltool.errors import FitError, LogError


def series(size=600, seed=3):
    noise = np.random.default_rng(seed).standard_normal(size + 200)
    return lfilter([1.0, -0.2743], [1.0, -0.7575, 0.6874], noise)[200:]


def write(path, values, time=None):
    rows = ["value" if time is None else "time_s,value"]
    for k, value in enumerate(values):
        cell = "" if np.isnan(value) else f"{value:.17g}"
        rows.append(cell or '""' if time is None else f"{time[k]:.10g},{cell}")
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture
def log(tmp_path):
    return write(tmp_path / "bar.csv", series())


def run(*args):
    done = CliRunner().invoke(command, [str(a) for a in args], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return done


def test_json_contract(log):
    document = json.loads(run(log, "-C", "value", "--max-p", 4, "--max-q", 3, "--json").stdout)
    assert set(document["best"]) == {"aic", "aicc", "bic"}
    assert (document["best"]["bic"]["p"], document["best"]["bic"]["q"]) == (2, 1)
    assert len(document["table"]) == 20
    keys = {"p", "q", "aic", "aicc", "bic", "exact"}
    assert all(set(row) == keys for row in document["table"])
    for name, best in document["best"].items():
        exact = [row for row in document["table"] if row["exact"]]
        assert best["value"] == min(row[name] for row in exact)


def test_criterion_of_the_source_and_table(log):
    document = json.loads(run(log, "-C", "value", "--criterion", "gao", "--json").stdout)
    assert list(document["best"]) == ["gao"]
    text = run(log, "-C", "value", "--criterion", "bic").stdout
    assert text.splitlines()[1].startswith("2,1")
    bad = CliRunner().invoke(command, [str(log), "-C", "value", "--criterion", "hqc"])
    assert bad.exit_code == 2
    assert "aic, aicc, bic, gao" in bad.stderr


def test_a_search_cut_short_names_the_option(log):
    told = [
        run(log, "-C", "value", "--max-p", size, "--max-q", size, "--effort", effort).stdout
        for size, effort in ((10, 0.02), (1, 20))
    ]
    assert told[0].endswith("; --effort above 1 looks at more\n")
    assert told[1].endswith("by exact likelihood\n")


def test_figure(log, tmp_path):
    figure = tmp_path / "orders.png"
    run(log, "-C", "value", "--max-p", 3, "--max-q", 3, "--figure", figure)
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_edge_of_the_grid_and_unit_root_are_told(log, tmp_path):
    assert "edge of the grid" in run(log, "-C", "value", "--max-p", 1, "--max-q", 1).stderr
    walk = write(tmp_path / "walk.csv", np.cumsum(np.random.default_rng(1).standard_normal(500)))
    told = run(walk, "-C", "value", "--max-p", 3, "--max-q", 3).stderr
    assert "unit root" in told
    assert "--difference 1" in told
    again = run(walk, "-C", "value", "--max-p", 3, "--max-q", 3, "--difference", 1).stderr
    assert "unit root" not in again


def test_an_enormous_outlier_is_told_and_left_out(tmp_path):
    x = series()
    x[200] = 1e7
    log = write(tmp_path / "spike.csv", x)
    options = ("-C", "value", "--max-p", 4, "--max-q", 4, "--criterion", "bic")
    done = run(log, *options)
    assert "1e+07 at 200 s stands alone" in done.stderr
    assert done.stdout.splitlines()[1].startswith("2,1")
    assert not run(log, *options, "--outliers", "keep").stdout.splitlines()[1].startswith("2,1")


def test_gaps_and_segments(tmp_path):
    x, time = series(), 0.5 * np.arange(600)
    x[[100, 101, 350]] = np.nan
    time[400:] += 1000.0
    done = run(write(tmp_path / "gaps.csv", x, time), "-C", "value", "--criterion", "bic")
    assert "3 gaps" in done.stderr
    assert done.stdout.splitlines()[1].startswith("2,1")
    assert "597 samples" in done.stdout


def test_bad_input_is_one_clear_line(tmp_path):
    cases = {
        "constant": (np.full(100, 2.5), FitError, "constant"),
        "short": (np.array([1.0, 3.0, 2.0]), FitError, "too few"),
        "missing": (np.full(50, np.nan), FitError, "missing"),
    }
    for name, (values, error, what) in cases.items():
        log = write(tmp_path / f"{name}.csv", values)
        with pytest.raises(error, match=what) as caught:
            run(log, "-C", "value")
        assert str(log) in str(caught.value)
    uneven = write(
        tmp_path / "uneven.csv", series(50), np.sort(np.random.default_rng(0).random(50))
    )
    with pytest.raises(LogError, match="even clock"):
        run(uneven, "-C", "value")
    with pytest.raises(LogError, match="no column"):
        run(uneven, "-C", "values")


@pytest.mark.parametrize(
    "computed",
    [lambda k: 1.0 * k, lambda k: (-1.0) ** k, lambda k: np.sin(0.3 * k), lambda k: k % 7.0],
    ids=["line", "alternating", "sine", "period"],
)
def test_what_follows_from_the_samples_before_has_no_order(tmp_path, computed):
    log = write(tmp_path / "computed.csv", computed(np.arange(400)))
    with pytest.raises(FitError, match="no noise to model"):
        run(log, "-C", "value")


def test_samples_without_a_clock_are_told(log):
    assert "no clock" in run(log, "-C", "value").stderr
    assert "no clock" not in run(log, "-C", "value", "--period", 0.5).stderr


def test_two_columns_of_one_name(tmp_path):
    path = tmp_path / "twice.csv"
    path.write_text("time_s,value,value\n0,1,2\n1,2,3\n")
    with pytest.raises(LogError, match=r"twice\.csv:1: value: this name is there twice"):
        run(path, "-C", "value")
