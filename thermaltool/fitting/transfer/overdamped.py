"""Denominators with real, stable poles: the body is overdamped."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from thermaltool.fitting.data import Array
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.search import (
    GAUSS_NEWTON,
    TOLERANCE,
    SearchResult,
    at,
    reduced_equations,
)
from thermaltool.fitting.transfer.starts import grid
from thermaltool.signals.gauss_newton import minimize

# Shortest time constant of the search [samples]; the longest in lengths of the record.
MIN_TIME_CONSTANT, MAX_TIME_CONSTANT_RECORDS = 0.1, 10
# A step moves the logarithm of a time constant by no more than this.
MAX_STEP = 1.0
# Starts of the coarse grid that are followed.
FOLLOWED_STARTS = 3
# Time constants of a start are at least this far apart, as a ratio; the shortest of them [samples].
MIN_RATIO, MIN_START_TIME_CONSTANT = 1.5, 0.3
# Steps from every start, at most.
MAX_STEPS = 60
# Step of a logarithm by which a denominator is differentiated.
LOG_DIFFERENCE = 1e-5


def overdamped(problem: Problem, start: SearchResult) -> SearchResult:
    """Real, stable poles: damped Gauss-Newton over the logarithms of the time constants.

    A start that is overdamped already is the answer. Else of a pair each pole takes its decay, a
    little apart; and poles of the coarse grid, or with several denominators some that divide the
    record among them, are tried, too, for the pair may have stood for something else.
    """
    roots = [np.roots(problem.recursion(f)) for f in start.F]
    if all(bool(np.all((z.imag == 0) & (z.real > 0))) for z in roots):
        return start
    longest = problem.data.longest
    tau = [_apart(-1 / np.log(np.clip(np.abs(z), 1e-6, 1 - 1e-9))) for z in roots]
    if len(roots) == 1:
        coarse = grid(problem)
        outputs = [problem.output(k) for k in problem.used]
        others = [[-1 / np.log(np.roots(problem.recursion(s.F)).real.clip(1e-6))]
                  for s in coarse.ranked(outputs, FOLLOWED_STARTS)]  # fmt: skip
    else:
        others = [[np.geomspace(longest / 6, max(longest / 600, 1.0), len(z)) for z in roots]]
    ends = [_over_time_constants(problem, each) for each in (tau, *others)]
    return min(ends, key=lambda end: end.loss)


def _over_time_constants(problem: Problem, tau: list[Array]) -> SearchResult:
    """Gauss-Newton from these time constants of each denominator [samples]."""
    bounds = np.log(MIN_TIME_CONSTANT), np.log(MAX_TIME_CONSTANT_RECORDS * problem.data.longest)
    edges = np.cumsum([0, *map(len, tau)])

    def denominators(theta: Array) -> tuple[Array, ...]:
        return tuple(problem.start(np.exp(theta[a:b])) for a, b in itertools.pairwise(edges))

    def point(theta: Array) -> tuple[Array, SearchResult]:
        theta = np.clip(theta, *bounds)
        return theta, at(problem, denominators(theta))

    def normal_equations(here: tuple[Array, SearchResult]) -> tuple[Array, Array]:
        theta, found = here
        matrix, score = reduced_equations(problem, found)
        turn = _jacobian(problem, found.F, theta)
        return turn.T @ matrix @ turn, turn.T @ score

    end = minimize(
        point(np.log(np.concatenate(tau))),
        lambda here: here[1].loss,
        normal_equations,
        lambda here, step: point(here[0] + np.clip(step, -MAX_STEP, MAX_STEP)),
        lambda here: TOLERANCE * here[1].loss / problem.rows,
        MAX_STEPS,
    )
    return replace(end.point[1], converged=end.converged, method=f"{GAUSS_NEWTON} over real poles")


def _apart(tau: Array) -> Array:
    """Time constants drawn apart, the slowest first."""
    tau = np.sort(np.clip(tau, MIN_START_TIME_CONSTANT, None))[::-1]
    for k in range(1, len(tau)):
        tau[k] = min(tau[k], tau[k - 1] / MIN_RATIO)
    return tau


def _jacobian(problem: Problem, F: tuple[Array, ...], theta: Array) -> Array:
    """How steps of the denominators follow the logarithms of the time constants."""
    turn, at = np.zeros((len(theta), len(theta))), 0
    for f in F:
        own = slice(at, at + len(f) - 1)
        beside = theta[own] + LOG_DIFFERENCE * np.eye(len(f) - 1)
        after = np.array([problem.start(lags) for lags in np.exp(beside)]).reshape(-1, len(f))
        turn[own, own] = problem.steps_between(f, after) / LOG_DIFFERENCE
        at = own.stop
    return turn
