"""Commands that switch between the rows of a minute, and feedthrough beside them: numpy, scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.fitting.between_rows import find_between_rows
from thermaltool.fitting.data import even_training_data
from thermaltool.record import Record

ROWS, ROW, TAU, GAIN = 400, 60, 400.0, 2.0


def log(seed, *, between, direct=0.0, noise=0.02):
    """One lag, followed by the second; the log has the level and the output of every minute."""
    rng = np.random.default_rng([20261126, seed])
    u, at = np.zeros(ROWS * ROW), 5 * ROW
    while at < len(u):
        u[at:] = rng.choice([0.0, 20.0, 50.0, 100.0])
        step = int(rng.uniform(10, 40) * ROW)
        at += step if between else step // ROW * ROW
    pole = np.exp(-1 / TAU)
    y = (GAIN * lfilter([0, 1 - pole], [1, -pole], u) + direct * u)[::ROW]
    y = 20 + y + noise * y.std() * rng.standard_normal(ROWS)
    columns = {"Q_a_W": u[::ROW], "T_a_degC": y}
    return Record(ROW * np.arange(float(ROWS)), columns, name="log")


def found_in(record):
    return find_between_rows(even_training_data([record], ["Q_a_W"], ["T_a_degC"]))


@pytest.mark.parametrize("seed", range(3))
def test_switches_between_rows_are_no_feedthrough(seed):
    found = found_in(log(seed, between=True))
    assert found.lines == found.lagging == ("Q_a_W",)


@pytest.mark.parametrize("direct", [0.0, 0.15, 1.0])
def test_switches_at_the_rows_are_none_between_them(direct):
    """Also where feedthrough is what half a row of the lag would be."""
    assert found_in(log(3, between=False, direct=direct)).lines == ()


def test_feedthrough_that_instants_do_not_explain_is_left():
    found = found_in(log(4, between=True, direct=0.6))
    assert found.lines == ("Q_a_W",)
    assert found.lagging == ()


@pytest.mark.slow
def test_a_model_of_commands_between_rows_has_no_feedthrough():
    """And the model file runs along straight lines, as the fit does."""
    record = log(5, between=True)
    found = tt.identify(record, "Q_a_W", "T_a_degC", structure="subspace")
    (term,) = found.model.terms
    assert "direct" not in term.response.kind
    assert term.response.slowest() == pytest.approx(TAU, rel=0.05)
    assert term.response.dc_gain() == pytest.approx(GAIN, rel=0.02)
    assert [drive.hold for drive in found.model.drives] == ["first"]
    assert [note for note in found.notes if "straight lines" in note]


def test_orders_that_are_given_count_from_a_held_input():
    found = tt.identify(log(7, between=True), "Q_a_W", "T_a_degC", orders=[(1, 1, 1)])
    assert [drive.hold for drive in found.model.drives] == ["zero"]
    assert found.model.terms[0].response.delay == 0


@pytest.mark.slow
@pytest.mark.parametrize("structure", [None, "network"])
def test_no_structure_takes_the_instants_for_feedthrough(structure):
    found = tt.identify(log(6, between=True), "Q_a_W", "T_a_degC", structure=structure)
    assert "direct" not in found.model.terms[0].response.kind
    found = tt.identify(log(6, between=False, direct=1.0), "Q_a_W", "T_a_degC", structure=structure)
    assert found.model.terms[0].response.direct == pytest.approx(1.0, abs=0.05)
