"""Outputs that follow an input of the same row, against recursions by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.record import Record

DT, TAU, ROWS = 5.0, 60.0, 900
NAMES = ("Q_a_W", "Q_b_W")


def log(seed, *, logged_late, held=True, rows=ROWS, gains=(2, 1)):
    """Two inputs through a lag, the first also at once; or both read at the end of their sample."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0, 10, (2, rows // 6 + 2)), 6, axis=1)[:, : rows + 1]
    u[:, :20] = 0.0
    if not held:
        u = np.cumsum(u - u.mean(axis=1, keepdims=True), axis=1) / 20
    pole = np.exp(-DT / TAU)
    y = sum(gain * lfilter([0, 1 - pole], [1, -pole], x) for gain, x in zip(gains, u, strict=True))
    if logged_late:
        u = np.hstack([u[:, :1], u[:, :-1]])
    else:
        y = y + 1.5 * u[0]
    y = y[:rows] + 0.1 * lfilter([0.6], [1, -0.8], rng.standard_normal(rows))
    columns = dict(zip((*NAMES, "T_a_degC"), (*u[:, :rows], 20 + y), strict=True))
    return Record(DT * np.arange(rows), columns, name="log")


def test_feedthrough_is_found_for_the_input_that_has_it():
    found = tt.identify(log(1, logged_late=False), NAMES, "T_a_degC", structure="arx")
    direct, lagging = found.fits[0].model.orders.nk
    assert (direct, lagging) == (0, 1)
    terms = found.document()["models"][0]["terms"]
    assert [term["feedthrough"] for term in terms] == [True, False]
    assert found.model.terms[0].response.direct == pytest.approx(1.5, rel=0.05)


@pytest.mark.slow
def test_feedthrough_is_found_by_output_error_of_two_inputs():
    found = tt.identify(log(1, logged_late=False), NAMES, "T_a_degC")
    assert found.fits[0].model.orders.nk == (0, 1)
    assert found.fits[0].model.time_constants(1)[0].value == pytest.approx(TAU, rel=0.1)
    assert found.model.terms[0].response.direct == pytest.approx(1.5, rel=0.02)


@pytest.mark.slow
def test_inputs_read_at_the_end_of_their_sample_act_at_once():
    """Chosen, and the model file runs as the fit does."""
    record = log(3, logged_late=True, rows=400, gains=(2, 0))
    found = tt.identify(record, "Q_a_W", "T_a_degC", split=0.8, initial="rest")
    fit = found.fits[0]
    assert fit.model.orders.nk == (0,)
    # The noise has a deviation of 0.1 K.
    assert fit.validation.carried_on.rmse < 0.12
    response = found.model.terms[0].response
    assert response.direct == pytest.approx(2 * (1 - np.exp(-DT / TAU)), rel=0.1)
    assert response.dc_gain() == pytest.approx(2, rel=0.03)
    assert "0, direct 0.1" in found.table()
    simulated = found.model.simulate(record)["T_a_degC"][: fit.data.rows]
    assert np.ptp(simulated - fit.model.run(fit.data)) < 1e-6


@pytest.mark.slow
def test_a_static_output_is_a_model_that_can_be_written():
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(0, 10, 100), 4)
    columns = {"Q_a_W": u, "T_a_degC": 20 + 2 * u + 0.3 * rng.standard_normal(400)}
    found = tt.identify(Record(DT * np.arange(400), columns, name="log"), "Q_a_W", "T_a_degC",
                        split=0.6)  # fmt: skip
    assert found.model.terms[0].response.dc_gain() == pytest.approx(2, rel=0.02)
    assert found.fits[0].validation.carried_on.fit_percent > 93


@pytest.mark.parametrize("direct", [True, False])
def test_an_input_that_runs_on_has_feedthrough_where_it_is_sure(direct):
    """A temperature, whose straight lines reach the same row in part."""
    rng = np.random.default_rng(5)
    record = log(6, logged_late=False, held=False)
    drive = record.column("Q_a_W")
    pole, s = np.exp(-DT / TAU), DT / TAU
    now, before = 1 - (1 - pole) / s, (1 - pole) / s - pole
    y = lfilter([2 * now, 2 * before], [1, -pole], drive - drive[0]) + direct * 1.5 * drive
    columns = {"T_a_degC": drive, "d_z_um": y + 0.1 * rng.standard_normal(len(y))}
    found = tt.identify(
        Record(record.time, columns, name="log"), "T_a_degC", "d_z_um", orders=[(2, 1, 0)]
    )
    response = found.model.terms[0].response
    assert response.kind == ("rational1_direct" if direct else "rational1")
    assert response.dc_gain() == pytest.approx(2 + 1.5 * direct, rel=0.03)
