"""ARX, ARMAX and BJ against systems that are of their structure; intervals; residual tests."""

from __future__ import annotations

import numpy as np
import pytest
from reference.random_systems import case, fit_percent
from reference.training import fitted, training
from scipy.signal import lfilter

from thermaltool.fitting.residuals import residual_tests

NOISES = {
    "oe": lambda F, e: e,
    "bj": lambda F, e: 0.5 * lfilter([1, 0.5], [1, -0.9], e),
    "arx": lambda F, e: 0.3 * lfilter([1.0], F, e),
    "armax": lambda F, e: 0.3 * lfilter([1, 0.6], F, e),
}
structures = pytest.mark.parametrize("structure", NOISES)


def record(seed, structure, rows=4000):
    known = case(seed, rows, noise=0.0)
    e = 0.1 * known.x.std() * np.random.default_rng(500 + seed).standard_normal(rows)
    y = known.y + NOISES[structure](known.F, e)
    return known, training((known.u, y), period=2.0, inputs=("u",))


def errors_in_deviations(model, known):
    truth = np.concatenate([known.F[1:], known.B])
    return (model.coefficients - truth) / np.sqrt(np.diag(model.coefficient_covariance))


@structures
@pytest.mark.parametrize("seed", [0, 2, 4])
def test_its_own_noise_leaves_nothing(structure, seed):
    known, data = record(seed, structure)
    model = fitted(data, structure, (2,), 2, (known.nk,))
    assert model.converged
    assert fit_percent(known.x, model.respond(known.u[None])) > 97
    assert np.max(np.abs(errors_in_deviations(model, known))) < 4
    tests = residual_tests(model, data)
    assert tests.white_p > 1e-3
    assert tests.independent_p["u"] > 1e-3
    if structure in ("bj", "armax"):
        assert model.C[1] == pytest.approx(0.6 if structure == "armax" else 0.5, abs=0.1)
    if structure == "bj":
        assert model.D[1] == pytest.approx(-0.9, abs=0.05)


def test_coloured_noise_is_told_and_too_low_an_order_as_well():
    known, data = record(4, "bj")
    model = fitted(data, "oe", (2,), 2, (known.nk,))
    assert residual_tests(model, data).white_p < 1e-6
    known, data = record(4, "oe")
    low = fitted(data, "oe", (1,), 1, (known.nk,))
    assert residual_tests(low, data).independent_p["u"] < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["oe", "bj"])
def test_intervals_of_oe_cover_in_white_and_coloured_noise(noise):
    """120 repetitions: 95 % intervals hold 0.95 ± 4 binomial standard errors over all."""
    known = case(4, 1500, noise=0.0)
    truth = np.concatenate([known.F[1:], known.B])
    inside = []
    for seed in range(120):
        e = 0.1 * known.x.std() * np.random.default_rng(9000 + seed).standard_normal(1500)
        data = training((known.u, known.y + NOISES[noise](known.F, e)))
        model = fitted(data, "oe", (2,), 2, (known.nk,))
        estimates = [e for _, e in model.named()]
        inside.append([e.low < t < e.high for e, t in zip(estimates, truth, strict=True)])
    share = np.mean(inside, axis=0)
    deviation = np.sqrt(0.95 * 0.05 / 120)
    assert np.all(share > 0.95 - 4 * deviation)
    assert np.mean(share) < 0.995


def test_gain_and_time_constants_have_honest_intervals():
    known, data = record(12, "oe", 3000)
    model = fitted(data, "oe", (2,), 2, (known.nk,))
    gain = model.gain(0)
    assert gain.low < known.B.sum() / known.F.sum() < gain.high
    decay = -2.0 / np.log(np.abs(np.roots(known.F)))
    for estimate, truth in zip(model.time_constants(), np.sort(decay)[::-1], strict=True):
        assert estimate.low < truth < estimate.high


def test_criteria_prefer_the_true_order():
    known, data = record(8, "oe", 3000)
    models = {n: fitted(data, "oe", (n,), n, (known.nk,)) for n in (1, 2, 3)}
    assert min(models, key=lambda n: models[n].criteria.bic) == 2
    assert min(models, key=lambda n: models[n].yic) in (1, 2)
