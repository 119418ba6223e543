"""Fits where the likelihood has many maxima; what is said of roots that nearly cancel."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.errors import FitError, ModelError
from thermaltool.timeseries.cancellation import needless_pairs
from thermaltool.timeseries.fit import fit_arma
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import climb, start
from thermaltool.timeseries.model import dumps, loads
from thermaltool.timeseries.roots import near_unit
from thermaltool.timeseries.runs import even_record
from thermaltool.timeseries.screening import check_size, find_outliers


def simulated(ar, ma, size, seed):
    noise = np.random.default_rng(seed).standard_normal(size + 300)
    return lfilter(np.r_[1.0, ma], np.r_[1.0, -np.array(ar)], noise)[300:]


@pytest.mark.slow
@pytest.mark.parametrize(("ar", "ma"), [([0.8], []), ([0.9], [-0.5])])
def test_every_second_sample_missing(ar, ma):
    # The odd lags are nowhere in the record: zero coefficients are a saddle of the likelihood.
    x = simulated(ar, ma, 300, [4, len(ma)])
    x[1::2] = np.nan
    record = even_record(x)
    likelihood = ArmaLikelihood(record, 0)
    truth = climb(likelihood, start(likelihood, np.array(ar), np.array(ma)), 40, 1e-3)[0]
    assert fit_arma(record, len(ar), len(ma)).entry.deviance < truth.deviance + 0.1


def test_cancelling_roots_of_white_noise_are_needless_and_those_of_a_line_are_not():
    rng = np.random.default_rng(21)
    noise, angle = rng.standard_normal(1000), 1.0
    line = lfilter([1.0], [1.0, -2 * 0.99 * np.cos(angle), 0.99**2], rng.standard_normal(1000))
    for x, count in ((noise, 1), (noise + 0.1 * line, 0)):
        likelihood = ArmaLikelihood(even_record(x), 0)
        ar = np.array([2 * 0.97 * np.cos(angle), -(0.97**2)])
        ma = np.array([-2 * 0.9 * np.cos(angle), 0.9**2])
        fit = climb(likelihood, start(likelihood, ar, ma), 60, 1e-4)[0]
        assert len(needless_pairs(likelihood, fit.ar, fit.ma, fit.deviance)) == count


def test_a_root_near_one_is_told_from_it_by_many_samples():
    assert near_unit(np.array([0.99]), 300)
    assert not near_unit(np.array([0.99]), 3000)
    assert not near_unit(np.array([-0.999]), 100)
    assert not near_unit(np.array([-0.274]), 5)


def test_a_shock_that_the_series_follows_is_no_outlier():
    noise = np.random.default_rng(2).standard_normal(400)
    noise[200] += 15.0
    x = lfilter([1.0], [1.0, -1.8, 0.85], noise)
    assert not find_outliers(even_record(x)).size
    x[300] += 40.0
    assert find_outliers(even_record(x)).tolist() == [300]


@pytest.mark.parametrize("scale", [1e150, 1e-150])
def test_numbers_without_squares_are_refused(scale):
    with pytest.raises(FitError, match="another unit"):
        check_size(even_record(scale * np.random.default_rng(1).standard_normal(50)))


@pytest.mark.parametrize(
    ("key", "value"),
    [("ar", [1.5]), ("ma", [-3.0]), ("difference", -1), ("difference", 1.5), ("difference", 4),
     ("sigma2", -1.0), ("sigma2", 0.0)],
)  # fmt: skip
def test_a_model_file_that_was_tampered_with(key, value):
    document = json.loads(dumps(fit_arma(even_record(simulated([0.5], [0.3], 200, 6)), 1, 1)))
    loads(json.dumps(document))
    with pytest.raises(ModelError, match="not what thermaltool fit"):
        loads(json.dumps(document | {key: value}))
