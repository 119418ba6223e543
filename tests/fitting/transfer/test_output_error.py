"""OE by refined instrumental variables on systems that are known."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from reference.random_systems import case, fit_percent
from reference.training import fitted, training
from scipy.signal import lfilter

from thermaltool.fitting.transfer import search
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.registry import structure_of
from thermaltool.fitting.transfer.search import (
    GAUSS_NEWTON,
    REFINED,
    at,
    gauss_newton,
    refine,
)
from thermaltool.fitting.transfer.structure import real_poles


def data(u, y, dt=1.0):
    return training((u, y), period=dt)


@pytest.mark.parametrize("seed", range(24))
def test_random_systems_reach_what_the_true_system_reaches(seed):
    known = case(seed, 10000)
    model = fitted(data(known.u, known.y), "oe", (2,), 2, (known.nk,))
    assert model.converged
    # Against the noise-free output the true system reaches 100 %.
    assert fit_percent(known.x, model.respond(known.u[None])) >= 99.0
    assert model.offsets[0] == pytest.approx(3.0, abs=0.2 * known.x.std())


@pytest.mark.parametrize("seed", range(12))
def test_three_inputs_each_with_its_own_denominator(seed):
    parts = [case(100 * seed + k, 10000) for k in range(3)]
    x = sum(p.x for p in parts)
    y = x + 0.1 * x.std() * np.random.default_rng(10**6 + seed).standard_normal(len(x)) - 5.0
    u = np.array([p.u for p in parts])
    orders = structure_of("oe").orders((2,) * 3, 2, tuple(p.nk for p in parts))
    model = structure_of("oe").fit(data(u, y), orders)
    assert fit_percent(x, model.respond(u)) >= 99.0


def test_without_noise_the_coefficients_are_exact():
    known = case(5, 2000, noise=0.0)
    model = fitted(data(known.u, known.y), "oe", (2,), 2, (known.nk,))
    np.testing.assert_allclose(model.coefficients, [*known.F[1:], *known.B], rtol=1e-6, atol=1e-7)


def test_an_unknown_start_does_not_matter():
    known = case(8, 6000)
    late = slice(800, 3000)
    begun = known.y[late] + 40 * np.linalg.norm(known.x.std()) * lfilter(
        [1.0], known.F, np.eye(1, 2200)[0]
    )
    model = fitted(data(known.u[late], begun), "oe", (2,), 2, (known.nk,))
    assert fit_percent(known.x, model.respond(known.u[None])) >= 99.0
    assert model.simulate(data(known.u[late], begun).records[0])[400:] == pytest.approx(
        known.x[late][400:] + model.offsets[0], abs=0.1 * known.x.std()
    )


def test_gaps_part_the_record_and_every_log_has_its_offset():
    known = case(2, 9000)
    u = known.u[None]
    cuts = [(slice(0, 2500), 0), (slice(2600, 5000), 0), (slice(5000, 9000), 1)]
    parts = ((u[:, rows], known.y[rows] + 10.0 * origin, origin) for rows, origin in cuts)
    model = fitted(training(*parts), "oe", (2,), 2, (7,))
    assert fit_percent(known.x, model.respond(u)) >= 99.0
    assert model.offsets == pytest.approx((3.0, 13.0), abs=0.1 * known.x.std())


def test_a_single_step_from_rest_needs_the_rest():
    t = np.arange(3000.0)
    u = (t >= 20).astype(float)
    x = 2.0 * -np.expm1(-np.maximum(t - 20, 0) / 300) - 0.5 * np.expm1(-np.maximum(t - 20, 0) / 25)
    y = x + 0.01 * np.random.default_rng(1).standard_normal(3000) + 7.0
    orders = structure_of("oe").orders((2,), 2, (1,))
    model = structure_of("oe").fit(data(u, y).from_rest(), orders)
    assert model.gain(0).value == pytest.approx(2.5, rel=0.01)
    slow, fast = (e.value for e in model.time_constants())
    assert slow == pytest.approx(300, rel=0.05)
    assert fast == pytest.approx(25, rel=0.2)
    assert model.offsets[0] == pytest.approx(7.0, abs=0.01)


def test_both_searches_end_at_the_same_minimum():
    known = case(6, 5000)
    problem = Problem(data(known.u, known.y), structure_of("oe").orders((2,), 2, (1,)))
    start = (np.poly([0.9, 0.6]),)
    refined = refine(problem, start)
    newton = gauss_newton(problem, at(problem, start, "start"))
    assert refined.method == REFINED
    assert newton.method.startswith(GAUSS_NEWTON)
    assert refined.converged
    assert newton.converged
    assert refined.loss == pytest.approx(newton.loss, rel=1e-6)
    np.testing.assert_allclose(refined.F[0], newton.F[0], atol=1e-3)


def test_slow_poles_beyond_the_short_record_are_found():
    rng = np.random.default_rng(11)
    F, n = np.poly(np.exp(-1 / np.array([40000.0, 30.0]))), 300000
    u = np.repeat(rng.standard_normal(n // 3000), 3000)
    B = np.array([1.0, -0.98])
    B *= 2 * F.sum() / B.sum()
    x = lfilter(np.r_[0, B], F, u)
    y = x + 0.1 * x.std() * rng.standard_normal(n)
    model = fitted(data(u, y), "oe", (2,), 2, (1,))
    assert fit_percent(x, model.respond(u[None])) >= 99.0


def test_real_poles_where_the_free_fit_has_a_pair():
    """Nearly equal time constants in noise: a pair fits as well, an overdamped body has none."""
    rng = np.random.default_rng(5)
    poles = np.exp(-1 / np.array([60.0, 50.0]))
    F, u = np.poly(poles), np.repeat(rng.standard_normal(60), 30)
    x = lfilter([0, 2 * F.sum()], F, u)
    for _ in range(20):
        record = data(u, x + 0.2 * x.std() * rng.standard_normal(len(u)))
        orders = structure_of("oe").orders((1,), 2, (1,))
        free = structure_of("oe").fit(record, orders)
        if np.any(np.roots(free.F[0]).imag):
            break
    assert np.any(np.roots(free.F[0]).imag)
    real = structure_of("oe", real=True).fit(record, orders)
    assert real.converged
    assert real_poles(real)
    assert free.loss <= real.loss < 1.02 * free.loss
    assert fit_percent(x, real.respond(u[None])) > 95


def test_where_refined_instruments_do_not_settle_gauss_newton_does_and_says_so(monkeypatch):
    known = case(1, 4000)
    monkeypatch.setattr(search, "refine", partial(refine, steps=1))
    model = fitted(data(known.u, known.y), "oe", (2,), 2, (known.nk,))
    assert model.method.startswith(GAUSS_NEWTON)
    assert model.converged
    assert fit_percent(known.x, model.respond(known.u[None])) >= 99.0
