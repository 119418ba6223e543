"""The estimators that stay own beside those of statsmodels, on a series without a hole."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from statsmodels.regression.linear_model import burg as sm_burg
from statsmodels.tsa.arima.estimators.hannan_rissanen import hannan_rissanen as sm_hannan
from statsmodels.tsa.innovations.arma_innovations import arma_loglike
from statsmodels.tsa.stattools import acovf, adfuller, innovations_algo, levinson_durbin

from thermaltool.timeseries.ar import autocovariance, burg, yule_walker
from thermaltool.timeseries.hannan import hannan_rissanen
from thermaltool.timeseries.innovations import innovations
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.runs import even_record
from thermaltool.timeseries.screening import unit_root_statistic

AR, MA = np.array([1.2, -0.8, 0.3]), np.array([0.5, 0.4])


@pytest.fixture
def x() -> np.ndarray:
    noise = np.random.default_rng(12).standard_normal(1400)
    x = np.asarray(lfilter(np.r_[1.0, MA], np.r_[1.0, -AR], noise)[400:])
    return x - x.mean()


def test_likelihood(x: np.ndarray) -> None:
    at = ArmaLikelihood(even_record(x), -1).at(AR, MA)
    assert -0.5 * at.deviance == pytest.approx(arma_loglike(x, AR, MA, at.sigma2), abs=1e-8)


def test_burg(x: np.ndarray) -> None:
    coefficients, _ = sm_burg(x, 12, demean=False)
    np.testing.assert_allclose(burg(even_record(x), 12).coefficients[12], coefficients, atol=1e-12)


def test_autocovariances_with_and_without_holes(x: np.ndarray) -> None:
    np.testing.assert_allclose(
        autocovariance(even_record(x), 20), acovf(x, nlag=20, demean=False, fft=False), rtol=1e-12
    )
    x[::7] = np.nan
    x[0] = 0.0
    pairwise = acovf(x, nlag=20, demean=False, fft=False, adjusted=True, missing="conservative")
    # Here each lag is weighted as without holes: by the pairs that a whole series of its span has.
    span = np.flatnonzero(np.isfinite(x))[-1] + 1
    np.testing.assert_allclose(
        autocovariance(even_record(x), 20), pairwise * (1 - np.arange(21) / span), rtol=1e-12
    )


def test_yule_walker(x: np.ndarray) -> None:
    sigma2, coefficients, *_ = levinson_durbin(autocovariance(even_record(x), 15), 15, isacov=True)
    table = yule_walker(even_record(x), 15)
    np.testing.assert_allclose(table.coefficients[15], coefficients, atol=1e-12)
    assert table.variance[15] == pytest.approx(sigma2, rel=1e-12)


def test_innovations(x: np.ndarray) -> None:
    theta, _ = innovations_algo(autocovariance(even_record(x), 30), nobs=31)
    _, ma = innovations(even_record(x), 0, 4, 30)
    np.testing.assert_allclose(ma, theta[30, :4], atol=1e-10)


def test_hannan_rissanen_to_the_window_of_its_regression(x: np.ndarray) -> None:
    theirs, _ = sm_hannan(x, 2, 1, initial_ar_order=15, demean=False, unbiased=False)
    ours = hannan_rissanen(even_record(x), 2, 1, 15, correct=False)
    np.testing.assert_allclose(ours.ar, theirs.ar_params, atol=5e-3)
    np.testing.assert_allclose(ours.ma, theirs.ma_params, atol=5e-3)


@pytest.mark.filterwarnings("ignore:adfuller currently returns:FutureWarning")
def test_dickey_fuller(x: np.ndarray) -> None:
    walk = np.cumsum(x)
    lags = burg(even_record(np.diff(walk)), 12).best
    theirs = adfuller(walk, lags, regression="c", autolag=None)[0]
    assert unit_root_statistic(even_record(walk)) == pytest.approx(theirs, rel=1e-6)
