"""Few lags for a transient: from non-negative least squares to lines, as many as have evidence.

Non-negative least squares on a grid is the likeliest spectrum of all; it has few positive places.
Their clusters start a separable search (variable projection, Golub and Pereyra 1973), then
neighbours are merged pair by pair; the number of lines is that of the least BIC (Schwarz 1978).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array
from thermaltool.fitting.spectrum.compressed import CompressedTransient
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.gauss_newton import inverse_of, minimize

# Lines that a model document takes.
MAX_LINES = 10
# A step that lowers the deviance by less is the last one; linearizations; those of a trial.
DEVIANCE_TOLERANCE, MAX_ITERATIONS, TRIAL_ITERATIONS = 1e-4, 100, 8
# Largest step in the logarithm of a time constant.
MAX_STEP = 1.0


@dataclass(frozen=True)
class LineFit:
    """So many lines at their likeliest places.

    Attributes
    ----------
    logs : ndarray, shape (N,) [ln s]
        Ascending.
    resistances : ndarray, shape (N,) [K/W]
        Above zero.
    offset : float [K]
        Level without power.
    loss : float [K²]
    problem : CompressedTransient
    """

    logs: Array
    resistances: Array
    offset: float
    loss: float
    problem: CompressedTransient

    @property
    def criteria(self) -> Criteria:
        """Two parameters for each line, and the offset where it is free."""
        rows, count = self.problem.rows, 2 * len(self.logs) + self.problem.linear
        return Criteria.of_squares(self.loss, rows, count)

    @property
    def variance(self) -> float:
        """Of the noise of a row [K²]."""
        free = max(self.problem.rows - self.criteria.parameters, 1)
        return max(self.loss / free, np.finfo(float).tiny)

    def covariance(self) -> Array:
        """Of (ln τ, R) where there are these lines and no others, shape (2N, 2N)."""
        slopes = self.problem.slopes(self.logs) * self.resistances
        parts = [slopes, self.problem.columns(self.logs)]
        if self.problem.linear:
            parts.append(self.problem.offset[:, None])
        whole = np.hstack(parts)
        n = 2 * len(self.logs)
        return inverse_of(whole.T @ whole)[:n, :n] * self.variance


@dataclass(frozen=True)
class _Point:
    """A place of the search."""

    logs: Array
    resistances: Array
    offset: float
    loss: float


def fit_lines(problem: CompressedTransient, logs: Array, max_iterations: int) -> LineFit:
    """The likeliest places near a start; lines that get no resistance are left out.

    Parameters
    ----------
    problem : CompressedTransient
    logs : ndarray, shape (N,) [ln s]
    max_iterations : int
    """

    def at(theta: Array) -> _Point:
        bounded = np.clip(theta, problem.grid[0], problem.grid[-1])
        return _Point(bounded, *problem.resistances(bounded))

    def normal_equations(here: _Point) -> tuple[Array, Array]:
        columns = problem.columns(here.logs)
        linear = columns[:, here.resistances > 0]
        error = problem.y - columns @ here.resistances
        if problem.linear:
            linear = np.column_stack([linear, problem.offset])
            error = error - here.offset * problem.offset
        slopes = problem.slopes(here.logs) * here.resistances
        basis = np.linalg.qr(linear)[0]
        left = slopes - basis @ (basis.T @ slopes)
        return left.T @ left, left.T @ error

    end = minimize(
        at(logs),
        lambda here: here.loss,
        normal_equations,
        lambda here, step: at(here.logs + np.clip(step, -MAX_STEP, MAX_STEP)),
        lambda here: DEVIANCE_TOLERANCE * here.loss / problem.rows,
        max_iterations,
    ).point
    kept = np.flatnonzero(end.resistances > 0)
    order = kept[np.argsort(end.logs[kept])]
    return LineFit(end.logs[order], end.resistances[order], end.offset + problem.level,
                   end.loss, problem)  # fmt: skip


def candidates(problem: CompressedTransient) -> list[LineFit]:
    """The best fit of every number of lines up to that of the likeliest spectrum, fewest first.

    Parameters
    ----------
    problem : CompressedTransient

    Raises
    ------
    FitError
        No resistance above zero has evidence: the output does not follow, or falls where the input
        rises.
    """
    none = LineFit(np.zeros(0), *problem.resistances(np.zeros(0)), problem)
    spectrum, _, _ = problem.resistances(problem.grid)
    places = np.flatnonzero(spectrum > 0)
    if not len(places):
        raise FitError("the output does not rise with the power: no resistance is above zero")
    clusters = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    logs = np.array([np.average(problem.grid[c], weights=spectrum[c]) for c in clusters])
    found: dict[int, LineFit] = {}
    here = fit_lines(problem, logs, MAX_ITERATIONS)
    while len(here.logs):
        n = len(here.logs)
        if n not in found or here.loss < found[n].loss:
            found[n] = here
        if n == 1:
            break
        trials = [fit_lines(problem, _merged(here, k), TRIAL_ITERATIONS) for k in range(n - 1)]
        best = min((t for t in trials if len(t.logs)), key=lambda t: t.loss)
        here = fit_lines(problem, best.logs, MAX_ITERATIONS)
    if min(fit.criteria.bic for fit in found.values()) > none.criteria.bic:
        raise FitError("the output does not follow the power: noise would do as well")
    return [found[n] for n in sorted(found)]


def _merged(fit: LineFit, k: int) -> Array:
    """Line k and the next one as one."""
    both = np.average(fit.logs[k : k + 2], weights=fit.resistances[k : k + 2])
    return np.concatenate([fit.logs[:k], [both], fit.logs[k + 2 :]])


def choose(fits: list[LineFit], lines: int | None = None) -> LineFit:
    """The fit of so many lines, or of the least BIC.

    Parameters
    ----------
    fits : list of LineFit
    lines : int, optional

    Raises
    ------
    FitError
        The log carries no so many lines.
    """
    if lines is None:
        some = [f for f in fits if len(f.logs) <= MAX_LINES]
        return min(some, key=lambda f: f.criteria.bic)
    for fit in fits:
        if len(fit.logs) == lines:
            return fit
    most = len(fits[-1].logs)
    raise FitError(f"the log carries up to {most} lines, not {lines}: further ones get nothing")
