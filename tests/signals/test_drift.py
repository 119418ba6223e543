"""Maximum-likelihood drift: against the dense Gaussian likelihood, and by simulation."""

import mpmath
import numpy as np
import pytest

from thermaltool.signals.allan import allan_deviation
from thermaltool.signals.drift import DriftFit, fit_drift, model_allan, model_density
from thermaltool.signals.likelihood import ColouredNoise, RestrictedLikelihood

ONE_BLOCK = np.array([0])


@pytest.mark.parametrize(("starts", "degree"), [([0], 0), ([0, 14, 25], 2)])
def test_likelihood_equals_the_dense_one(starts, degree):
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.2, 3.0, 40))
    values = rng.standard_normal(40)
    starts = np.array(starts)
    block = np.searchsorted(starts, np.arange(40), side="right")
    fast = RestrictedLikelihood(time, values, starts, degree)
    basis = np.hstack(
        [(block == b)[:, None] * time[:, None] ** np.arange(degree + 1) for b in np.unique(block)]
    )

    def dense(walk, tau):
        ratio = walk * tau / (2.0 * fast.period)
        same = block[:, None] == block
        cov = np.eye(40) + ratio * same * np.exp(-np.abs(time[:, None] - time) / tau)
        inverse = np.linalg.inv(cov)
        gram = basis.T @ inverse @ basis
        project = inverse - inverse @ basis @ np.linalg.solve(gram, basis.T @ inverse)
        return np.linalg.slogdet(cov)[1] + np.linalg.slogdet(gram)[1], values @ project @ values

    points = [(0.01, 5.0), (1.0, 2.0), (30.0, 20.0)]
    ours = np.array([fast.terms(*p) for p in points])
    theirs = np.array([dense(*p) for p in points])
    # Steps are rounded to 1e-7 periods.
    np.testing.assert_allclose(ours[:, 1], theirs[:, 1], rtol=1e-6)
    # The scale of the polynomials adds a constant to the determinant.
    np.testing.assert_allclose(np.diff(ours[:, 0]), np.diff(theirs[:, 0]), rtol=1e-6)


@pytest.mark.slow
def test_coverage_and_bias(drifting):
    white, sigma, tau, records = 0.02, 0.03, 20.0, 120
    time = 0.5 * np.arange(3000)
    fits = [
        fit_drift(
            time, drifting(np.random.default_rng([10, k]), time, white, sigma, tau), ONE_BLOCK
        )
        for k in range(records)
    ]

    def covered(interval, truth):
        return np.mean([low <= truth <= high for low, high in map(interval, fits)])

    # 95 % intervals: within three standard errors of the binomial count.
    slack = 3.0 * np.sqrt(0.95 * 0.05 / records)
    assert covered(lambda f: f.white_interval, white) > 0.95 - slack
    assert covered(lambda f: f.sigma_interval, sigma) > 0.95 - slack
    assert covered(lambda f: f.time_constant_interval, tau) > 0.95 - slack
    assert covered(lambda f: f.rate_interval, sigma * np.sqrt(2.0 / tau)) > 0.95 - slack
    assert np.median([f.white_sigma for f in fits]) == pytest.approx(white, rel=0.01)
    assert np.median([f.sigma for f in fits]) == pytest.approx(sigma, rel=0.03)
    # Intervals as wide as they need to be, no wider.
    spread = np.std([np.log(f.sigma) for f in fits])
    width = np.mean([np.log(f.sigma_interval[1] / f.sigma_interval[0]) / 3.92 for f in fits])
    assert width == pytest.approx(spread, rel=0.25)


@pytest.mark.slow
def test_white_alone_is_not_called_drift():
    time = np.arange(1500.0)
    fits = [
        fit_drift(time, 0.02 * np.random.default_rng([11, k]).standard_normal(1500), ONE_BLOCK)
        for k in range(40)
    ]
    assert sum(f.sigma > 0.0 for f in fits) <= 3  # one in a hundred each
    assert all(f.white_sigma == pytest.approx(0.02, rel=0.07) for f in fits)


@pytest.mark.parametrize("n", [20000])
def test_long_record_through_its_short_stand_in(n, drifting):
    time = 0.5 * np.arange(n)
    fit = fit_drift(time, drifting(np.random.default_rng(12), time, 0.02, 0.03, 120.0), ONE_BLOCK)
    assert fit.white_sigma == pytest.approx(0.02, rel=0.03)
    assert fit.sigma_interval[0] < 0.03 < fit.sigma_interval[1]


def test_bursts(drifting):
    # Three readings 4 s apart, once a minute.
    time = (60.0 * np.arange(700)[:, None] + 4.0 * np.arange(3)).ravel()
    fit = fit_drift(time, drifting(np.random.default_rng(13), time, 0.02, 0.05, 600.0), ONE_BLOCK)
    assert fit.white_interval[0] < 0.02 < fit.white_interval[1]
    assert fit.sigma_interval[0] < 0.05 < fit.sigma_interval[1]


def test_walk_tells_its_rate_but_no_size():
    rng = np.random.default_rng(14)
    values = np.cumsum(0.01 * rng.standard_normal(4000)) + 0.02 * rng.standard_normal(4000)
    fit = fit_drift(np.arange(4000.0), values, ONE_BLOCK)
    assert fit.at_bound
    assert fit.sigma_interval is None
    assert fit.rate_interval[0] < 0.01 < fit.rate_interval[1]


def test_walk_alone_gives_white_an_upper_limit():
    values = np.cumsum(0.01 * np.random.default_rng(15).standard_normal(2000))
    fit = fit_drift(np.arange(2000.0), values, ONE_BLOCK)
    assert not fit.white_resolved
    assert fit.white_interval[0] == 0.0
    assert fit.white_sigma < 0.005


def test_model_curves_agree_with_measurement(drifting):
    fit = DriftFit(0.02, (0, 1), True, 0.03, None, 10.0, None, 0.03 * np.sqrt(0.2), None, False)
    time = 0.5 * np.arange(100000)
    y = drifting(np.random.default_rng(16), time, 0.02, 0.03, 10.0)
    factors = np.array([1, 4, 16, 64, 256])
    measured = allan_deviation(y, 0.5, factors)
    model = model_allan(factors, 0.5, fit)
    np.testing.assert_allclose(measured.deviation, model, rtol=0.05)
    # Parseval: the density integrates to the variance.
    frequency = np.linspace(0.0, 1.0, 20001)
    variance = np.trapezoid(model_density(frequency, 0.5, fit), frequency)
    assert variance == pytest.approx(0.02**2 + 0.03**2, rel=1e-3)


def test_no_scatter():
    with pytest.raises(ValueError, match="scatter"):
        fit_drift(np.arange(100.0), np.ones(100), ONE_BLOCK)


@pytest.mark.slow
def test_slow_signals_under_a_large_drift_keep_their_digits():
    """Beside the dense matrix in 40 digits: the products that a diagnosis compares."""
    time = np.cumsum(np.random.default_rng(5).choice([20.0, 40.0, 40.0, 80.0], 60))
    starts, tau, ratio = np.array([0, 25]), 5e4, 1e6
    columns = np.column_stack([20 * np.exp(-time / 1e5), np.full(60, 3.0), time / 1e3])
    weight = np.where(np.arange(60) % 3, 1.0, 0.5)
    solved = ColouredNoise(time, starts, weight).factor(ratio, tau).solve(columns)
    with mpmath.workdps(40):
        block = np.searchsorted(starts, np.arange(60), side="right")
        dense = mpmath.matrix(60, 60)
        for i in range(60):
            for j in range(60):
                if block[i] == block[j]:
                    apart = abs(mpmath.mpf(time[i]) - time[j])
                    dense[i, j] = ratio * mpmath.exp(-apart / tau)
            dense[i, i] += mpmath.mpf(weight[i])
        exact = [mpmath.lu_solve(dense, mpmath.matrix(c)) for c in columns.T.tolist()]
    exact = np.array([list(c) for c in exact], float).T
    scale = np.sqrt(np.diag(columns.T @ exact))
    error = columns.T @ (solved - exact) / np.outer(scale, scale)
    assert np.abs(error).max() < 1e-11


@pytest.mark.parametrize("ratio", [0.0, 0.1, 30.0])
def test_whitened_columns_have_the_products_of_the_dense_inverse(ratio):
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.uniform(0.2, 3.0, 50))
    starts, weight, columns = np.array([0, 20]), rng.uniform(0.5, 2.0, 50), rng.random((50, 3))
    block = np.searchsorted(starts, np.arange(50), side="right")
    apart = np.abs(time[:, None] - time)
    dense = np.diag(weight) + ratio * (block[:, None] == block) * np.exp(-apart / 8.0)
    rows = ColouredNoise(time, starts, weight).factor(ratio, 8.0).whitened(columns)
    np.testing.assert_allclose(
        rows.T @ rows, columns.T @ np.linalg.solve(dense, columns), rtol=1e-6
    )
