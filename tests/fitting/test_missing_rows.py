"""Logs that lack rows: plants are recursions of numpy and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.errors import FitError
from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.even_clock import even_records
from thermaltool.fitting.identification import identify
from thermaltool.fitting.missing_inputs import with_missing_inputs
from thermaltool.fitting.subspace.choose import again, choose_order
from thermaltool.fitting.subspace.plan import SubspacePlan
from thermaltool.record import Record

INS, OUTS = ("Q_a_W",), ("dT_a_K", "dT_b_K")
PLAN = SubspacePlan(modes=2, initial="rest")


def log(rows=1500, *, each=20, noise=0.02, seed=20261127):
    """Two lags of 10 and 200 rows of one power, read in two places."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(rows // each + 1), each)[:rows]
    u[:20] = 0.0
    lags = [lfilter([0, 1 - a], [1, -a], u) for a in np.exp(-1 / np.array([10.0, 200.0]))]
    y = np.array([[1.0, 2.0], [0.5, -1.0]]) @ lags
    y += noise * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    columns = dict(zip((*INS, *OUTS), (u, *y), strict=True))
    return Record(np.arange(float(rows)), columns, name="log")


def with_lost(record, share=0.01, seed=1):
    kept = np.random.default_rng(seed).random(len(record)) >= share
    kept[0] = True
    return record.where(kept), ~kept


def near(estimate, truth):
    """Within four standard errors: beside that once in 16 000."""
    return abs(estimate.value - truth) < 2 * (estimate.high - estimate.low) / 1.96


def test_a_record_goes_on_over_a_few_missing_rows():
    time = np.array([0.0, 1, 2, 4, 5, 8, 9, 14, 15])
    columns = {"Q_a_W": time**2, "dT_a_K": time, "dT_b_K": 2 * time}
    columns["dT_b_K"][4] = np.nan
    first, last = even_records(Record(time, columns), INS, OUTS, 1.0)
    np.testing.assert_array_equal(first.time, np.arange(10.0))
    np.testing.assert_array_equal(first.columns["Q_a_W"], [0, 1, 4, 10, 16, 25, 38, 51, 64, 81])
    nan = np.nan
    np.testing.assert_array_equal(first.columns["dT_a_K"], [0, 1, 2, nan, 4, 5, nan, nan, 8, 9])
    np.testing.assert_array_equal(first.columns["dT_b_K"], [0, 2, 4, nan, 8, nan, nan, nan, 16, 18])
    np.testing.assert_array_equal(last.time, [14, 15])
    whole, _ = even_records(Record(time, columns), INS, OUTS, 1.0, "row")
    a, b = (np.isnan(whole.columns[name]) for name in OUTS)
    np.testing.assert_array_equal(a, b)
    drawn, _ = even_records(Record(time, columns), INS, OUTS, 1.0, "end")
    np.testing.assert_allclose(drawn.columns["dT_b_K"], 2 * drawn.time)


@pytest.mark.parametrize("each", [20, 1])
def test_commands_in_missing_rows_are_told_by_the_outputs(each):
    """As the plant had them; what lies on a line between its neighbours is off by far more."""
    record = log(each=each)
    short, lost = with_lost(record, 0.02)
    (found,) = with_missing_inputs([short], INS, OUTS)
    added = np.flatnonzero(lost)[np.isin(np.flatnonzero(lost), found.time)]
    at = np.searchsorted(found.time, added)
    assert len(added)
    assert np.isnan(found.columns["dT_a_K"][at]).all()
    truth, own = record.columns["Q_a_W"][added], found.columns["Q_a_W"][at]
    line = np.interp(added, short.time, short.columns["Q_a_W"])
    assert np.std(own - truth) < 0.3 * np.std(line - truth)
    unchanged = np.isin(found.time, short.time)
    np.testing.assert_array_equal(found.columns["Q_a_W"][unchanged], short.columns["Q_a_W"])


def test_rows_that_are_held_out_tell_nothing():
    short, lost = with_lost(log(each=1), 0.02)
    (found,) = with_missing_inputs([short], INS, OUTS, split=0.6)
    added = found.time[~np.isin(found.time, short.time)]
    assert 0 < added.max() < 0.6 * 1500
    assert np.flatnonzero(lost).max() > 0.6 * 1500
    (whole,) = with_missing_inputs([log()], INS, OUTS)
    assert len(whole) == 1500


@pytest.mark.slow
@pytest.mark.parametrize("each", [20, 1])
def test_a_fit_with_missing_rows_is_that_with_all(each):
    record = log(each=each)
    short, _ = with_lost(record)
    models = [fit.model for fit in identify([short], INS, OUTS, PLAN)]
    data = even_training_data([short], INS, OUTS, missing="row")
    assert len(data.records) == 1
    for estimate, tau in zip(models[0].time_constant_estimates(), (200.0, 10.0), strict=True):
        assert near(estimate, tau)
        assert estimate.high < 1.1 * estimate.low
    for model, gain in zip(models, (3.0, -0.5), strict=True):
        assert near(model.gain(0), gain)


def test_a_row_counts_where_no_output_is_missing():
    record = log()
    holes = {name: values.copy() for name, values in record.columns.items()}
    holes["dT_b_K"][np.random.default_rng(2).random(len(record)) < 0.2] = np.nan
    holes["dT_a_K"][400:600] = np.nan
    said = []
    found = tt.identify(Record(record.time, holes, name="log"), INS, OUTS, structure="subspace",
                        modes=2, initial="rest", warn=said.append, nan_policy="omit")  # fmt: skip
    assert any("a row counts where no output is missing" in message for message in said)
    slow, _ = found.fits[0].model.time_constant_estimates()
    assert near(slow, 200.0)
    assert all(fit.training.fit_percent > 97 for fit in found.fits)


def test_a_structure_that_does_not_fit_leaves_the_others():
    data = even_training_data([log(600)], INS, OUTS).from_rest()
    models = [each.model for each in choose_order(data, orders=[1, 3])]
    assert len(models) > 1
    few = even_training_data([log().rows(slice(14, 36))], INS, OUTS).from_rest()
    large = max(models, key=lambda model: model.order)
    with pytest.raises(FitError, match="do not carry 3 modes"):
        again(few, [large], None, False)
    small = min(models, key=lambda model: model.order)
    found = again(few, [large, small], None, False)
    assert [each.model.order for each in found] == [small.order]
