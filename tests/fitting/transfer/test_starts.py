"""Starts of the search, and what several inputs make of them."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from reference.random_systems import case, fit_percent
from reference.training import training
from scipy.signal import lfilter

from thermaltool.fitting.transfer import search
from thermaltool.fitting.transfer.continuous import ContinuousOeStructure, ContinuousProblem
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.polynomials import (
    MAX_POLE_RADIUS,
    partial_fractions,
    stabilized,
)
from thermaltool.fitting.transfer.registry import structure_of
from thermaltool.fitting.transfer.search import (
    SEPARATE,
    at,
    beside,
    gauss_newton,
    refine,
    thorough,
)
from thermaltool.fitting.transfer.starts import grid

ORDERS = [(1, 1), (1, 2), (2, 2), (1, 3), (2, 3)]
# In continuous time a response has no direct part: nb is at most nf.
KINDS = [(Problem, o) for o in [*ORDERS, (3, 1), (4, 2)]] + [(ContinuousProblem, o) for o in ORDERS]


def two_pieces():
    """One from an unknown state and one from rest, with an offset of its own."""
    known = case(3, 1500)
    u = known.u[None]
    return training((u[:, :900], known.y[:900]), (u[:, 950:], known.y[950:], 1, True))


def count_rows(problem):
    return [problem.output(k) for k in problem.used]


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_losses_of_the_grid_are_those_of_the_models(kind, order):
    nb, nf = order
    orders = structure_of("oe").orders((nb,), nf, (2,))
    problem = kind(two_pieces().about_levels(orders.first), orders)
    starts = grid(problem).ranked(count_rows(problem), 100)
    assert len(starts) >= 5
    for start in starts:
        exact = problem.project((start.F,), keep=False).loss
        assert start.loss == pytest.approx(exact, rel=1e-4)
    assert [s.loss for s in starts] == sorted(s.loss for s in starts)


def test_the_grid_around_a_denominator_changes_one_pole_at_a_time():
    orders = structure_of("oe").orders((2,), 2, (2,))
    problem = Problem(two_pieces().about_levels(orders.first), orders)
    around = np.array([40.0, 3.0])
    kept = np.exp(-1 / around)
    starts = grid(problem, around).ranked(count_rows(problem), 100)
    for start in starts:
        poles = np.roots(start.F)
        near = np.min(np.abs(poles[:, None] - kept), axis=0)
        assert np.sum(near < 1e-9) == 1
        exact = problem.project((start.F,), keep=False).loss
        assert start.loss == pytest.approx(exact, rel=1e-4)


def test_partial_fractions_add_up():
    roots = np.array([[0.9, 0.5, -0.2], [0.99, 0.1, 0.3]])
    found = partial_fractions(roots, (2, 0))
    x = 1.7
    for row, own in zip(roots, found, strict=True):
        sums = [np.sum(r / (x - row)) for r in own]
        whole = np.array([x**2, 1.0]) / np.prod(x - row)
        np.testing.assert_allclose(sums, whole, rtol=1e-12)


def test_only_poles_outside_are_moved():
    rng = np.random.default_rng(7)
    for _ in range(500):
        pair = rng.uniform(0.5, 1.2) * np.exp(1j * rng.uniform(0, np.pi) * np.array([1, -1]))
        F = np.poly([*pair, rng.uniform(-1.2, 1.2)]).real
        stable = np.max(np.abs(np.roots(F))) < MAX_POLE_RADIUS
        assert (stabilized(F) is F) == stable
        assert np.max(np.abs(np.roots(stabilized(F)))) < 1


def test_an_input_that_explains_little_is_looked_at_again():
    """Its quick pole spent on the drift of the noise is one minimum, its own is another."""
    rng = np.random.default_rng(31)
    n = 8000
    u = np.array([rng.standard_normal(n), np.repeat(rng.standard_normal(n // 50), 50)])
    strong, weak = np.poly([0.8, 0.5]), np.poly(np.exp(-1 / np.array([800.0, 3.0])))
    x = lfilter([0, 1.0, -0.3], strong, u[0])
    slow = lfilter([0, 1.0, -0.98], weak, u[1])
    x = x + 0.2 * x.std() / slow.std() * slow
    y = x + 0.1 * x.std() * rng.standard_normal(n)
    orders = structure_of("oe").orders((2, 2), 2, (1, 1))
    problem = Problem(training((u, y)).about_levels(orders.first), orders)
    caught = (strong, np.poly(np.exp(-1 / np.array([800.0, 20000.0]))))
    there = at(problem, caught, SEPARATE)
    better = beside(problem, there)
    assert better is not None
    assert problem.project(better).loss < 0.99 * there.loss
    true = (strong, weak)
    assert problem.project(better).loss < 1.01 * problem.project(true).loss
    start = at(problem, true, SEPARATE)
    assert beside(problem, gauss_newton(problem, start)) is None


@pytest.mark.parametrize("steps", [20, 1])
def test_several_inputs_say_how_they_were_found(monkeypatch, steps):
    """With one step the first input does not settle: all are searched again with more effort."""
    monkeypatch.setattr(search, "refine", partial(refine, steps=steps))
    again = []
    monkeypatch.setattr(search, "thorough", lambda p: again.append(p) or thorough(p))
    parts = [case(k, 3000) for k in (0, 2)]
    x = parts[0].x + parts[1].x
    y = x + 0.1 * x.std() * np.random.default_rng(4).standard_normal(len(x))
    u = np.array([p.u for p in parts])
    orders = structure_of("oe").orders((2, 2), 2, tuple(p.nk for p in parts))
    model = structure_of("oe").fit(training((u, y)), orders)
    assert model.converged
    assert SEPARATE in model.method
    assert bool(again) == (steps == 1)
    assert fit_percent(x, model.respond(u)) >= 99.0


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_held_and_running_inputs_together_in_continuous_time(order):
    """One is held between samples, so that it acts one sample later, and one runs on."""
    rng = np.random.default_rng(0)
    u = np.array([np.repeat(rng.standard_normal(150), 20),
                  lfilter([0.05], [1, -0.95], rng.standard_normal(3000))])  # fmt: skip
    x = lfilter([0, 0.02], [1, -0.98], u[0]) + lfilter([0.05, 0.05], [1, -0.9], u[1])
    y = x + 0.05 * x.std() * rng.standard_normal(3000)
    holds, nk, tau = ("zero", "first"), (1, 0), -1 / np.log([0.98, 0.9])
    model = ContinuousOeStructure().fit(
        training((u[list(order)], y), holds=tuple(holds[k] for k in order)),
        structure_of("oe").orders((1, 1), 1, tuple(nk[k] for k in order)),
    )
    assert model.converged
    for group, k in enumerate(order):
        assert model.time_constants(group)[0].value == pytest.approx(tau[k], rel=0.05)
