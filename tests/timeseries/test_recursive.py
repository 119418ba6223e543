"""Recursive estimation against batch least squares, theory, and inputs that break other forms."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.timeseries.recursive.arma import RecursiveArma, is_invertible
from thermaltool.timeseries.recursive.least_squares import RecursiveLeastSquares

AR, MA = [1.2, -0.6, 0.1], [0.5, 0.2]
SEED = np.random.SeedSequence().entropy


def covariance(rls: RecursiveLeastSquares) -> np.ndarray:
    """P = U D Uᵀ of a recursion."""
    U = np.eye(rls.size)
    U.T[np.tril_indices(rls.size, -1)] = rls._U
    return U * rls._D @ U.T


def series(count, ar=AR, ma=MA, sigma=1.0):
    """ARMA series past its transient, and its innovations."""
    print("seed", SEED)  # drawn fresh; pytest shows it where a test fails
    a = sigma * np.random.default_rng(SEED).standard_normal(count + 500)
    x = lfilter([1, *ma], [1, *[-v for v in ar]], a)
    return x[500:], a[500:]


def followed(x, *args, **kwargs):
    model = RecursiveArma(*args, **kwargs)
    errors = np.array([model.update(value) for value in x])
    return model, errors


def inner_state(model):
    rls = model._rls
    learnt = (rls.theta, rls._D, rls._U) if rls else ()
    return repr((model._x, model._a, model._loss, model._weight, learnt))


@pytest.mark.parametrize("forgetting", [1.0, 0.97])
def test_is_weighted_least_squares(forgetting):
    rng = np.random.default_rng(3)
    Phi, truth, beta = rng.standard_normal((60, 4)), np.array([1.0, -2.0, 0.5, 3.0]), 1e6
    y = Phi @ truth + 0.1 * rng.standard_normal(60)
    rls = RecursiveLeastSquares(4, beta, forgetting)
    for phi, value in zip(Phi, y, strict=True):
        after = rls.update(phi.tolist(), value - float(np.dot(rls.theta, phi)))
        assert after == pytest.approx(value - np.dot(rls.theta, phi), abs=1e-12)
    w = forgetting ** np.arange(59, -1, -1.0)
    information = Phi.T @ (w[:, None] * Phi) + forgetting**60 * np.eye(4) / beta
    np.testing.assert_allclose(rls.theta, np.linalg.solve(information, Phi.T @ (w * y)), rtol=1e-9)
    np.testing.assert_allclose(covariance(rls), np.linalg.inv(information), rtol=1e-9, atol=1e-15)


def test_covariance_stays_positive_and_no_less_known_than_at_the_start():
    rng = np.random.default_rng(4)
    rls = RecursiveLeastSquares(3, 100.0, 0.9)
    for k in range(5000):
        # one direction for long, then all, then nearly parallel ones
        phi = [1.0, 2.0, 3.0 + (1e-9 * rng.standard_normal() if k % 3 else k % 7 == 0)]
        rls.update(phi, rng.standard_normal())
        assert max(rls._D) <= 100.0
    P = np.array(covariance(rls))
    assert np.linalg.eigvalsh(P).min() > 0
    assert np.all(np.isfinite(P))


@pytest.mark.parametrize(
    "wave",
    [lambda k: 5.0, lambda k: (1.0, -1.0)[k % 2], lambda k: 1e50, lambda k: 1e-50],
    ids=["constant", "alternating", "huge", "tiny"],
)
@pytest.mark.parametrize("intercept", [True, False])
def test_unexciting_input_comes_to_a_state_that_repeats_bit_for_bit(wave, intercept):
    """The recursion is a function of its state and its input: a state that has come back once
    comes back for ever, so 10⁸ further samples pass through no state that is not finite here."""
    model = RecursiveArma(3, 2, intercept, 0.99)
    for k in range(20000):
        model.update(wave(k))
    state = inner_state(model)
    for k in range(20000, 20002):
        model.update(wave(k))
    assert inner_state(model) == state
    forecast = model.forecast(10)
    assert np.all(np.isfinite(forecast.mean))
    assert np.all(np.isfinite(forecast.variance))
    expected = [wave(k) for k in range(20002, 20012)]
    np.testing.assert_allclose(forecast.mean, expected, rtol=1e-6)


@pytest.mark.slow
def test_a_constant_with_the_usual_forgetting_repeats_too():
    model = RecursiveArma(1, 1, intercept=False)
    for _ in range(760_000):  # 760 memory lengths
        model.update(5.0)
    state = inner_state(model)
    model.update(5.0)
    assert inner_state(model) == state
    assert model.forecast(10).mean[-1] == pytest.approx(5.0)


@pytest.mark.parametrize("count", [10, 10_000])
def test_without_forgetting_the_covariance_shrinks_to_no_less_than_theory_leaves_it(count):
    """With λ = 1 no state repeats, but P⁻¹ = I/β + Σ φφᵀ. So no entry of D ever grows, and none
    falls below 1/(1/β + N |φ|²): for 10⁸ samples a number of ordinary size."""
    beta, phi = 10.0, [1.0, 1.0, 1.0, 0.5]
    rls, square = RecursiveLeastSquares(4, beta), sum(p * p for p in phi)
    for _ in range(count):
        before = list(rls._D)
        rls.update(phi, 5.0 - float(np.dot(rls.theta, phi)))
        assert all(now <= old for now, old in zip(rls._D, before, strict=True))
    assert min(rls._D) >= (1 - 1e-9) / (1 / beta + count * square)
    np.testing.assert_allclose(np.dot(rls.theta, phi), 5.0, rtol=1 / count)


def test_without_forgetting_after_a_hundred_million_samples():
    """From the covariance and the weights that 10⁸ samples leave, on a constant."""
    model = RecursiveArma(3, 2, forgetting=1.0)
    model.begin(SimpleNamespace(ar=AR, ma=MA, mean=5.0, sigma2=1.0), 1e8)
    for _ in range(20_000):
        model.update(5.0)
    assert model._weight == 1e8 + 20_000 - 3  # the first three fill the lags
    assert min(model._rls._D) > 0
    assert max(model._rls._D) <= 1e-8
    forecast = model.forecast(10)
    np.testing.assert_allclose(forecast.mean, 5.0)
    assert np.all(np.isfinite(forecast.variance))


def test_a_stream_that_falls_silent_repeats_too():
    # the sum of squared errors has to underflow: 750 memory lengths
    model, _ = followed([*series(3000)[0], *[3.3] * 40000], 3, 2, forgetting=0.97)
    state, cycle = inner_state(model), 0
    while cycle < 100:
        model.update(3.3)
        cycle += 1
        if inner_state(model) == state:
            break
    # mostly 1; rounding may leave a cycle of a few samples
    assert cycle < 100
    np.testing.assert_allclose(model.forecast(10).mean, 3.3, rtol=1e-6)


def test_zeros_alone_teach_nothing_and_break_nothing():
    model, errors = followed([0.0] * 5000, 3, 2)
    assert model.forecast(2) == ([0.0, 0.0], [0.0, 0.0])
    assert not errors.any()
    x, a = series(4000)
    errors = np.array([model.update(value) for value in x])
    assert np.std(errors[2000:]) < 1.02 * np.std(a[2000:])


def test_huge_values_and_what_is_no_number():
    x, _ = series(3000)
    x[::7] *= 1e59
    x[5::100] = math.nan
    x[6::100] = math.inf
    x[7::100] = 1e300
    model, errors = followed(x, 3, 2, forgetting=0.98)
    assert np.all(np.isfinite(errors))
    assert np.all(np.isfinite(model.forecast(5).mean))
    assert np.linalg.eigvalsh(1e118 * np.array(covariance(model._rls))).min() > 0


def test_one_step_error_is_that_of_the_innovations():
    x, a = series(30000)
    _, errors = followed(x, 3, 2, forgetting=0.999)
    ratio = np.sqrt(np.mean(errors[3000:] ** 2) / np.mean(a[3000:] ** 2))
    assert 0.99 < ratio < 1.02


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e12])
def test_the_unit_of_the_series_does_not_matter(unit):
    x, _ = series(500)
    one, _ = followed(x, 3, 2)
    other, _ = followed(unit * x, 3, 2)
    np.testing.assert_allclose(other.ar + other.ma, one.ar + one.ma, rtol=1e-6)
    assert other.constant == pytest.approx(unit * one.constant, rel=1e-6)
    assert other.sigma2 == pytest.approx(unit**2 * one.sigma2, rel=1e-6)


def test_parameters_mean_and_variance_are_found():
    ar, ma = [0.7575, -0.6874], [-0.2743]  # Gao 2000, sec. 5.2, with the sign that is missing there
    x, _ = series(60000, ar, ma)
    model, _ = followed(x + 40.0, 2, 1, forgetting=1.0)
    mean = model.constant / (1 - sum(model.ar))
    assert mean == pytest.approx(40.0, abs=0.1)
    assert model.sigma2 == pytest.approx(1.0, abs=0.03)
    np.testing.assert_allclose(model.ar + model.ma, ar + ma, atol=0.03)


@pytest.mark.parametrize(("ar", "ma"), [(AR, MA), ([0.9], []), ([], [0.6, 0.3]), ([0.5], [0.4])])
@pytest.mark.parametrize("steps", [1, 2, 7])
def test_forecasts_are_conditional_expectations(ar, ma, steps):
    """Against the filter run on with no innovations, and the impulse response."""
    x, a = series(400, ar, ma, 0.3)
    model = RecursiveArma(len(ar), len(ma), forgetting=1.0)
    model.begin(SimpleNamespace(ar=ar, ma=ma, mean=7.0, sigma2=0.09), 1e9)
    for value in x:
        model.update(value + 7.0)
    forecast = model.forecast(steps)
    state = np.zeros(max(len(ar), len(ma)))
    for p in range(len(state)):
        now = ([*ar, *[0.0] * len(state)], [*ma, *[0.0] * len(state)])
        state[p] = sum(
            now[0][p + i] * x[-1 - i] + now[1][p + i] * a[-1 - i] for i in range(len(state) - p)
        )
    b, c = [1.0, *ma], [1.0, *[-v for v in ar]]
    size = len(state) + 1
    b, c = b + [0.0] * (size - len(b)), c + [0.0] * (size - len(c))
    expected, _ = lfilter(b, c, np.zeros(steps), zi=state)
    np.testing.assert_allclose(forecast.mean, expected + 7.0, atol=1e-4)
    green = lfilter(b, c, np.eye(1, steps)[0])
    np.testing.assert_allclose(forecast.variance, model.sigma2 * np.cumsum(green**2), rtol=1e-4)


def test_intervals_hold_what_they_say():
    x, _ = series(12000)
    model, inside = RecursiveArma(3, 2), []
    for now, later in zip(x[:-5], x[5:], strict=True):
        model.update(now)
        if model._weight > 900:
            mean, variance = model.forecast(5)
            inside.append(abs(later - mean[-1]) <= 1.959964 * math.sqrt(variance[-1]))
    # about 0.5 % of standard error: neighbouring forecasts overlap
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


def test_missing_samples_are_bridged_and_gaps_forget_the_lags():
    x, _ = series(3000)
    model, _ = followed(x, 3, 2)
    theta = list(model._rls.theta)
    expected = model.forecast(3)
    model.miss()
    model.miss()
    assert model.forecast(1).mean[0] == pytest.approx(expected.mean[2])
    model.forget_lags()
    assert not model.ready
    assert model._rls.theta == theta
    for value in x[:3]:
        model.update(value)
    assert model.ready


def test_one_enormous_outlier_is_kept_out_but_a_new_level_is_followed():
    x, a = series(4000)
    model, _ = followed(x[:2000], 3, 2, gate=10.0)
    ar = model.ar
    model.update(1e6)
    assert model.refused == 1
    assert model.ar == ar
    errors = [model.update(value) for value in x[2000:] + 1000.0]
    assert model.refused == 0
    assert np.std(errors[1500:]) < 1.1 * np.std(a[3500:])


@pytest.mark.parametrize("ma", [[0.9], [1.1], [1.5, 0.6], [1.7, 0.6], [0.2, -0.9], [0.5, 0.2, 1.2]])
def test_invertible_is_what_the_roots_say(ma):
    assert is_invertible(ma) == bool(np.all(np.abs(np.roots([1, *ma])) < 1))


def test_the_moving_average_stays_invertible():
    rng = np.random.default_rng(5)
    x = np.cumsum(rng.standard_normal(3000))
    over_differenced = np.diff(x, 3, prepend=[0, 0, 0])
    model = RecursiveArma(1, 2, forgetting=0.95)
    for value in over_differenced:
        model.update(float(value))
        assert is_invertible(model.ma)


@pytest.mark.parametrize("order", [(0, 0), (-1, 2)])
def test_no_order(order):
    with pytest.raises(ValueError, match="no model of order"):
        RecursiveArma(*order)


@pytest.mark.parametrize("forgetting", [0.0, 1.5, math.nan])
def test_forgetting_out_of_range(forgetting):
    with pytest.raises(ValueError, match="forgetting factor"):
        RecursiveArma(2, forgetting=forgetting)
