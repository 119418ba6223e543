"""The search for the time constants that all outputs share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array
from thermaltool.fitting.network.problem import Problem, Projected, Sums, criterion
from thermaltool.fitting.transfer.search import SLOWEST
from thermaltool.signals.gauss_newton import minimize, solve

# Starts are found on so many rows; the modes are followed over all. Of many records, each with
# decays of its own, the longest ones do.
THINNED, RECORDS = 20000, 6
# Time constants that a start chooses from, for each decade; the shortest one, in sample periods.
PER_DECADE, FASTEST = 6, 0.2
# The likelihood that counts as settled.
SETTLED = 1e-5
# Neighbours nearer than the first ratio are one mode; a search that brings them nearer than the
# second is given up.
TWICE, MERGED = 1.1, 1.02
# Rounds in which one choice of the start is exchanged.
EXCHANGES = 4
METHOD = "variable projection"


@dataclass(frozen=True)
class Found:
    """Where a search ended.

    Attributes
    ----------
    lags : ndarray, shape (N,) [s], the slowest first
    projected : list of Projected, one for each output
    converged : bool
    """

    lags: Array
    projected: list[Projected]
    converged: bool

    @property
    def criterion(self) -> float:
        return criterion(self.projected)


def search(problem: Problem, modes: int) -> Found:
    """The time constants of largest likelihood.

    Raises
    ------
    FitError
        Two modes fall together: the data carry fewer.
    """
    stride = max(1, problem.data.rows // THINNED)
    thin = replace(problem, stride=problem.stride * stride)
    tries = [refine(thin, start) for start in starts(thin, modes)]
    best = min(tries, key=lambda found: found.criterion)
    found = refine(problem, best.lags) if stride > 1 else best
    ratio = found.lags[:-1] / found.lags[1:]
    if np.any(ratio < TWICE):
        twice = float(found.lags[1:][int(np.argmin(ratio))])
        raise FitError(
            f"two of {modes} modes fall together at a time constant of {twice:.4g} s: the data "
            "carry fewer"
        )
    return found


def box(problem: Problem) -> tuple[float, float]:
    """Shortest and longest time constant of the search [s]."""
    return FASTEST * problem.data.period, SLOWEST * problem.data.duration


def refine(problem: Problem, lags: Array, most: int = 60) -> Found:
    """Damped Gauss-Newton over the logarithms of the time constants.

    Outputs are weighted by the inverse of their error variance, which the likelihood gives anew at
    every step.
    """
    low, high = np.log(box(problem))

    def found(theta: Array) -> Found:
        return Found(np.exp(theta), problem.project(np.exp(theta)), False)

    def normal_equations(here: Found) -> tuple[Array, Array]:
        n = len(here.lags)
        weights = [f.rows / f.loss for f in here.projected]
        matrix = sum((w * f.reduced for w, f in zip(weights, here.projected, strict=True)),
                     np.zeros((n, n)))  # fmt: skip
        score = sum((w * f.pull for w, f in zip(weights, here.projected, strict=True)), np.zeros(n))
        return matrix, score

    def moved(here: Found, step: Array) -> Found:
        return found(np.clip(np.log(here.lags) + np.clip(step, -1.0, 1.0), low, high))

    def merged(here: Found) -> bool:
        return bool(np.any(-np.diff(np.sort(np.log(here.lags))[::-1]) < np.log(MERGED)))

    end = minimize(
        found(np.clip(np.log(np.sort(lags)[::-1]), low, high)), lambda here: 2 * here.criterion,
        normal_equations, moved, lambda here: 2 * SETTLED, most, merged,
    )  # fmt: skip
    order = np.argsort(-end.point.lags)
    if np.all(np.diff(order) == 1):
        return replace(end.point, converged=end.converged)
    lags = end.point.lags[order]
    return Found(lags, problem.project(lags), end.converged)


def starts(problem: Problem, modes: int) -> list[Array]:
    """Time constants on a logarithmic grid, chosen together for all outputs; and spread ones."""
    low, high = box(problem)
    low, high = 3 * low, high / 5
    count = max(modes + 2, round(PER_DECADE * np.log10(high / low)))
    grid = np.geomspace(high, low, count)
    few = replace(problem, data=problem.data.longest_records(RECORDS))
    chosen = _chosen(_Bank(few, grid), modes)
    spread = np.geomspace(high / 10, max(low * 5, high / 1000), modes)
    return [grid[list(chosen)], spread]


class _Bank:
    """Losses of any choice from a grid of time constants, from one pass over the rows."""

    def __init__(self, problem: Problem, grid: Array) -> None:
        self.count, self.inputs = len(grid), len(problem.data.inputs)
        self.origins = problem.data.experiments
        self.sums: list[Sums] = problem.sums(grid, slopes=False)
        self.shared: dict[int, list[int]] = {}
        for k, s in enumerate(self.sums):
            self.shared.setdefault(id(s.gram), []).append(k)

    def __call__(self, chosen: Sequence[int]) -> float:
        own, count, edge = np.array(chosen), self.count, self.count * self.inputs
        decays = (len(self.sums[0].cross) - edge - self.origins) // count
        place = np.concatenate([
            *(own + count * i for i in range(self.inputs)),
            edge + np.arange(self.origins),
            *(own + edge + self.origins + count * i for i in range(decays)),
        ])  # fmt: skip
        value = 0.0
        for outputs in self.shared.values():
            gram = self.sums[outputs[0]].gram[np.ix_(place, place)]
            right = np.array([self.sums[k].cross[place] for k in outputs]).T
            linear = solve(gram, right)
            for k, c in zip(outputs, linear.T, strict=True):
                s = self.sums[k]
                loss = max(s.power - float(c @ s.cross[place]), 1e-12 * s.power, 1e-300)
                value += criterion([(loss, s.rows)])
        return value


def _chosen(bank: _Bank, modes: int) -> tuple[int, ...]:
    """The best pair, then one by one, then exchanges of one while they help."""
    each = range(bank.count)
    if modes == 1:
        return (min(each, key=lambda j: bank((j,))),)
    best: tuple[int, ...] = min(itertools.combinations(each, 2), key=bank)
    for _ in range(modes - 2):
        best = min((tuple(sorted({*best, j})) for j in each if j not in best), key=bank)
    for _ in range(EXCHANGES):
        known = bank(best)
        others = [tuple(sorted({*best, j} - {out})) for out in best for j in each if j not in best]
        other = min(others, key=bank)
        if not bank(other) < known:
            break
        best = other
    return best
