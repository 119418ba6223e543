from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from thermaltool.cli.fit import METHODS, command
from thermaltool.errors import FitError
from thermaltool.timeseries.fit import METHODS as KNOWN
from thermaltool.timeseries.model import loads
from thermaltool.timeseries.polynomials import is_stationary
from thermaltool.timeseries.roots import modes

# Gao (2000), 6.1: ARMA(2,1) at 0.5 ms; φ2 is printed without its sign, θ is -ma.
PERIOD, PHI1, PHI2, THETA = 0.0005, 0.7575, -0.6874, 0.2743


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    noise = np.random.default_rng(11).standard_normal(40_200)
    x = lfilter([1.0, -THETA], [1.0, -PHI1, -PHI2], noise)[200:]
    path = tmp_path_factory.mktemp("bar") / "bar.csv"
    rows = [f"{PERIOD * k:.10g},{value:.17g}" for k, value in enumerate(x)]
    path.write_text("time_s,d_bar_um\n" + "\n".join(rows) + "\n")
    return path


def run(*args):
    done = CliRunner().invoke(command, [str(a) for a in args], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return done


def test_the_printed_model_has_its_mode_where_its_roots_are(bar, tmp_path):
    target = tmp_path / "arma.json"
    table = run(bar, "-C", "d_bar_um", "--order", "2,1", "-o", target).stdout
    model = loads(target.read_text())
    mode = modes(model)[0]
    natural = mode.natural
    # The roots of the printed coefficients: 2225 rad/s and 0.1685, not the printed 2478 and 0.15.
    root = np.roots([1.0, -PHI1, -PHI2])[0]
    assert abs(np.log(root)) / PERIOD == pytest.approx(2225, abs=0.5)
    assert natural.low < 2225 < natural.high
    assert natural.high < 2478
    assert natural.value == pytest.approx(2225, rel=0.01)
    assert mode.damping.value == pytest.approx(0.1685, rel=0.05)
    assert mode.damping.low < 0.1685 < mode.damping.high
    assert "omega_n [rad/s]" in table
    assert model.ar == pytest.approx([PHI1, PHI2], abs=0.02)
    assert model.ma[0] == pytest.approx(-THETA, abs=0.03)
    # With φ2 as printed there is no such process: a root lies outside the unit circle.
    assert not is_stationary(np.array([PHI1, -PHI2]))
    assert is_stationary(np.array([PHI1, PHI2]))


def test_order_is_chosen_by_bic(bar):
    done = run(bar, "-C", "d_bar_um", "--stop", 1.0, "--json")
    document = json.loads(done.stdout)
    assert (len(document["ar"]), len(document["ma"])) == (2, 1)
    assert "order 2,1 chosen by BIC" in done.stderr


@pytest.mark.slow
def test_intervals_cover():
    """95 % intervals of ω_n hold the truth about as often as they say."""
    from thermaltool.timeseries.fit import fit_arma
    from thermaltool.timeseries.runs import even_record

    hits = 0
    for seed in range(100):
        noise = np.random.default_rng(seed).standard_normal(700)
        x = lfilter([1.0, -THETA], [1.0, -PHI1, -PHI2], noise)[200:]
        natural = modes(fit_arma(even_record(x), 2, 1, period_s=PERIOD))[0].natural
        hits += natural.low < 2224.6 < natural.high
    assert 88 <= hits <= 100


def test_every_method_fits(bar):
    assert METHODS == KNOWN
    for method in METHODS:
        order = "2,1" if method in ("ml", "hannan-rissanen", "innovations") else "8,0"
        text = run(
            bar, "-C", "d_bar_um", "--order", order, "--method", method, "--stop", 2.0, "--json"
        ).stdout
        document = json.loads(text)
        assert document["fit"]["method"] == method
        assert document["sigma2"] == pytest.approx(1.0, abs=0.08)
    with pytest.raises(FitError, match="AR models only"):
        run(bar, "-C", "d_bar_um", "--order", "2,1", "--method", "burg")


def test_unit_root_and_short_series_are_told(tmp_path):
    walk = tmp_path / "walk.csv"
    walk.write_text(
        "value\n" + "\n".join(map(str, np.cumsum(np.random.default_rng(2).standard_normal(400))))
    )
    assert "--difference 1" in run(walk, "-C", "value", "--order", "1,0").stderr
    with pytest.raises(FitError, match="too few"):
        run(walk, "-C", "value", "--order", "9,9", "--stop", 10)
    bad = CliRunner().invoke(command, [str(walk), "-C", "value", "--order", "two"])
    assert bad.exit_code == 2


def test_a_model_that_is_none_is_refused():
    from thermaltool.errors import ModelError

    for text in ("", "{}", '{"format": "thermaltool-model", "version": 1}', "[1]"):
        with pytest.raises(ModelError):
            loads(text)


@pytest.mark.parametrize("order", ["300,0", "1,201"])
def test_orders_end_somewhere(bar, order):
    done = CliRunner().invoke(command, [str(bar), "-C", "d_bar_um", "--order", order])
    assert done.exit_code == 2
    assert "orders go up to 200" in done.stderr
