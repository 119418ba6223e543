"""``thermaltool estimate --method`` from outside."""

from __future__ import annotations

import csv

import numpy as np
import pytest

METHODS = "tikhonov0", "tikhonov1", "tikhonov2", "tv", "beck"
RULES = ["likelihood", "gcv", "quasi-optimality", "discrepancy", "l-curve"]


def table(text):
    rows = list(csv.reader(text.splitlines()))
    return rows[0], np.array(rows[1:], float)


@pytest.mark.parametrize("method", METHODS)
def test_every_rule_is_told_and_one_is_taken(thermaltool, files, method):
    result = thermaltool("estimate", files.kalman, files.log, "--method", method, "-q")
    assert result.code == 0
    names, values = table(result.out)
    assert names == ["time_s", "Q_main_1", "d_x_um"]
    # Order 0 prefers a small heat to a steady one.
    near = 0.1 if method == "tikhonov0" else 0.05
    assert np.mean(values[60:120, 1]) == pytest.approx(1.0, abs=near)
    loud = thermaltool("estimate", files.kalman, files.log, "--method", method)
    assert loud.out == result.out
    lines = loud.err.splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("rule"))
    assert [line.split()[0] for line in lines[first + 1 : first + 6]] == RULES
    assert lines[first + 6].startswith(f"Q_main_1 by {method}: ")
    assert lines[first + 7].split() == ["estimate", "band", "steady", "rmse", "max", "rows"]


def test_json_has_the_rules(thermaltool, files):
    target = files.folder / "out.csv"
    options = ("--method", "tikhonov1", "--at-least", 0, "--at-most", 1.2, "--json", "-o", target)
    result = thermaltool("estimate", files.kalman, files.log, *options)
    assert set(result.json) == {"agreement", "deconvolution"}
    found = result.json["deconvolution"]
    assert [each["rule"] for each in found["rules"]] == RULES
    assert (found["method"], found["rule"], found["at_most"]) == ("tikhonov1", "likelihood", 1.2)
    _, values = table(target.read_text())
    assert (values[:, 1].min() >= 0, values[:, 1].max() <= 1.2) == (True, True)


def test_tikhonov_of_order_1_is_near_the_smoother(thermaltool, files):
    smooth = table(thermaltool("estimate", files.kalman, files.log, "--smooth").out)[1]
    run = ("estimate", files.kalman, files.log, "--method", "tikhonov1")
    assert np.sqrt(np.mean((table(thermaltool(*run).out)[1][:, 1] - smooth[:, 1]) ** 2)) < 0.05


def test_a_sensor_that_is_dead_for_a_while_is_named(thermaltool, files):
    lines = files.log.read_text().splitlines()
    column = lines[0].split(",").index("dT_pair1_K")
    for k in range(100, 130):
        cells = lines[k].split(",")
        cells[column] = ""
        lines[k] = ",".join(cells)
    run = ("estimate", files.kalman, "-", "--method", "tv", "--nan-policy", "hold")
    result = thermaltool(*run, stdin="\n".join(lines) + "\n")
    assert (result.code, result.out) == (1, "")
    assert "dT_pair1_K has no reading in 30 rows" in result.err


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (("--rule", "gcv"), 2, "--rule, --at-least, --at-most and --future go with --method"),
        (("--method", "tv", "--smooth"), 2, "--method and --smooth are two"),
        (("--method", "tv", "--bands"), 2, "--method and --bands are two: --method has no bands"),
        (("--method", "tv", "--at-least", 2, "--at-most", 1), 2, "--at-least 2 --at-most 1 leaves"),
        (("--method", "tv", "--future", 3), 2, "--future goes with --method beck"),
        (("--method", "beck", "--future", 9999), 1, "more than half of the record's 240"),
        (("--method", "tv", "--initial", "settled"), 1, "takes a machine at rest"),
        (("--method", "tv", "--rule", "likelihood"), 1, "has no likelihood in closed form"),
    ],
)
def test_what_does_not_go_together(thermaltool, files, options, code, message):
    result = thermaltool("estimate", files.kalman, files.log, *options)
    assert (result.code, result.out) == (code, "")
    assert message in result.err


def test_an_uneven_clock_and_another_form(thermaltool, files):
    lines = files.log.read_text().splitlines()
    text = "\n".join(lines[:50] + lines[51:]) + "\n"
    result = thermaltool("estimate", files.kalman, "-", "--method", "tv", stdin=text)
    assert (result.code, result.out) == (1, "")
    assert "the clock is uneven: a sample of 20 s" in result.err
    result = thermaltool("estimate", files.kernel, files.log, "--method", "tv")
    assert "take the Kalman form" in result.err
