"""The vector of largest likelihood of one form, by damped Gauss-Newton from given starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array
from thermaltool.fitting.lpv.problem import LpvPoint, LpvProblem
from thermaltool.signals.gauss_newton import minimize

# A step that raises the logarithm of the likelihood by no more is the last one, of a final fit and
# of a candidate; the largest step of a logarithm; linearizations.
LIKELIHOOD_TOLERANCE, ROUGH_TOLERANCE, MAX_STEP, MAX_ITERATIONS = 1e-4, 0.1, 1.0, 30
# Logarithms of time constants are no nearer to each other.
MIN_APART = 0.2
# Fastest and slowest time constant of the grid of starts, in sample periods and in records.
START_PERIODS, START_RECORDS = 2.0, 0.2


@dataclass(frozen=True)
class LpvSearchResult:
    """Where a search ended.

    Attributes
    ----------
    point : LpvPoint
    converged : bool
    """

    point: LpvPoint
    converged: bool


def refine(
    problem: LpvProblem, theta: Array, tolerance: float = LIKELIHOOD_TOLERANCE
) -> LpvSearchResult:
    """The nearest maximum of the likelihood.

    Parameters
    ----------
    problem : LpvProblem
    theta : ndarray, shape (searched,)
    tolerance : float
        Gain of the logarithm of the likelihood by the last step.
    """
    low, high = problem.form.bounds(problem.data.period, problem.data.duration)

    def normal_equations(here: LpvPoint) -> tuple[Array, Array]:
        parts = problem.linearized(here)
        matrix = sum(f.rows / f.loss * f.reduced for f in parts)
        return np.asarray(matrix), np.asarray(sum(f.rows / f.loss * f.pull for f in parts))

    def stepped(here: LpvPoint, step: Array) -> LpvPoint:
        moved = here.theta + np.clip(step, -MAX_STEP, MAX_STEP)
        return problem.project(_apart(np.clip(moved, low, high), problem.form.modes))

    end = minimize(
        problem.project(_apart(np.clip(theta, low, high), problem.form.modes)),
        lambda here: 2 * here.criterion,
        normal_equations,
        stepped,
        lambda here: 2 * tolerance,
        MAX_ITERATIONS,
    )
    return LpvSearchResult(end.point, end.converged)


def _apart(theta: Array, modes: int) -> Array:
    """The vector with its time constants in order, none too near to the next.

    Gains of two that fall together grow without end, and say nothing.
    """
    taus = np.sort(theta[:modes])[::-1]
    for k in range(1, modes):
        lacking = MIN_APART - (taus[k - 1] - taus[k])
        if lacking > 0:
            taus[k - 1] += lacking / 2 if k == 1 else 0.0
            taus[k] = taus[k - 1] - MIN_APART
    return np.concatenate([taus, theta[modes:]])


def search(
    problem: LpvProblem, starts: Sequence[Array] = (), tolerance: float = LIKELIHOOD_TOLERANCE
) -> LpvSearchResult:
    """The best of what each start leads to.

    Parameters
    ----------
    problem : LpvProblem
    starts : sequence of ndarray, shape (searched,)
        Those of a grid of time constants where there are none.
    tolerance : float

    Raises
    ------
    FitError
        Too few rows, or no start from which the model stays finite.
    """
    need = problem.size + problem.form.searched
    if min(np.isfinite(np.hstack(problem.measured)).sum(axis=1)) < 2 * need:
        raise FitError(
            f"{problem.data.outputs[0]}: {problem.data.rows} rows do not carry {need} parameters: "
            "take fewer modes or levels, or more data"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        ends = [refine(problem, theta, tolerance) for theta in starts or grid_starts(problem)]
    best = min(ends, key=lambda end: end.point.criterion)
    if not np.isfinite(best.point.criterion):
        raise FitError(f"{problem.data.outputs[0]}: the model of these levels is not stable")
    return best


def grid_starts(problem: LpvProblem) -> list[Array]:
    """Time constants that divide what the record shows, as logarithms, with no rate and no power.

    Parameters
    ----------
    problem : LpvProblem
    """
    form, data = problem.form, problem.data
    ends = START_PERIODS * data.period, max(START_RECORDS * data.duration, 4 * data.period)
    grid = np.log(np.geomspace(*ends, 2 * form.modes + 3))
    found = []
    for first in range(3 if form.modes > 1 else 5):
        theta = np.zeros(form.searched)
        theta[: form.modes] = grid[first : first + 2 * form.modes : 2][::-1]
        found.append(theta)
    return found
