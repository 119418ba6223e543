"""The search for the time constants that all outputs share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array
from thermaltool.fitting.joint import ProjectedOutput, criterion
from thermaltool.fitting.network.problem import NetworkProblem, Sums
from thermaltool.signals.gauss_newton import minimize, solve

# Starts are found on so many rows; the modes are followed over all. Of many records, each with
# decays of its own, the longest ones do.
MAX_START_ROWS, MAX_START_RECORDS = 20000, 6
# Longest time constant of the search, in lengths of the record.
LONGEST_IN_RECORDS = 10
# Time constants that a start chooses from, for each decade; the shortest of a search, in periods.
STARTS_PER_DECADE, FASTEST_PERIODS = 6, 0.2
# A step of the search that raises the logarithm of the likelihood by no more is the last one; the
# largest step, in the logarithm of a time constant; linearizations.
LIKELIHOOD_TOLERANCE, MAX_STEP, MAX_ITERATIONS = 1e-5, 1.0, 60
# Neighbours nearer than the first ratio are one mode; a search that brings them nearer than the
# second is given up.
MIN_RATIO, MERGED_RATIO = 1.1, 1.02
# Rounds in which one choice of the start is exchanged.
MAX_EXCHANGES = 4
METHOD = "variable projection"


@dataclass(frozen=True)
class NetworkSearchResult:
    """Where a search ended.

    Attributes
    ----------
    time_constants : ndarray, shape (N,) [s], the slowest first
    projected : list of ProjectedOutput, one for each output
    converged : bool
    """

    time_constants: Array
    projected: list[ProjectedOutput]
    converged: bool

    @property
    def criterion(self) -> float:
        """½ Σ n ln(loss/n) over the outputs."""
        return criterion((f.loss, f.rows) for f in self.projected)


def search(problem: NetworkProblem, modes: int) -> NetworkSearchResult:
    """The time constants of largest likelihood.

    Parameters
    ----------
    problem : NetworkProblem
    modes : int
        Number of time constants.

    Raises
    ------
    FitError
        Two modes fall together: the data carry fewer.
    """
    stride = max(1, problem.data.rows // MAX_START_ROWS)
    thin = replace(problem, stride=problem.stride * stride)
    tries = [refine(thin, start) for start in starts(thin, modes)]
    best = min(tries, key=lambda found: found.criterion)
    found = refine(problem, best.time_constants) if stride > 1 else best
    ratio = found.time_constants[:-1] / found.time_constants[1:]
    if np.any(ratio < MIN_RATIO):
        twice = float(found.time_constants[1:][int(np.argmin(ratio))])
        raise FitError(
            f"two of {modes} modes fall together at a time constant of {twice:.4g} s: the data "
            "carry fewer"
        )
    return found


def box(problem: NetworkProblem) -> tuple[float, float]:
    """Shortest and longest time constant of the search [s]."""
    return FASTEST_PERIODS * problem.data.period, LONGEST_IN_RECORDS * problem.data.duration


def refine(problem: NetworkProblem, taus: Array) -> NetworkSearchResult:
    """Damped Gauss-Newton over the logarithms of the time constants from one start.

    Outputs are weighted by the inverse of their error variance, which the likelihood gives anew at
    every step.

    Parameters
    ----------
    problem : NetworkProblem
    taus : ndarray, shape (N,) [s]
    """
    low, high = np.log(box(problem))

    def at(theta: Array) -> NetworkSearchResult:
        bounded = np.exp(np.clip(theta, low, high))
        return NetworkSearchResult(bounded, problem.project(bounded), False)

    def normal_equations(here: NetworkSearchResult) -> tuple[Array, Array]:
        matrix, score = np.zeros((len(taus), len(taus))), np.zeros(len(taus))
        for f in here.projected:
            matrix += f.rows / f.loss * f.reduced
            score += f.rows / f.loss * f.pull
        return matrix, score

    def moved(here: NetworkSearchResult, step: Array) -> NetworkSearchResult:
        return at(np.log(here.time_constants) + np.clip(step, -MAX_STEP, MAX_STEP))

    def merged(here: NetworkSearchResult) -> bool:
        ordered = np.sort(here.time_constants)
        return bool(np.any(ordered[1:] < MERGED_RATIO * ordered[:-1]))

    end = minimize(
        at(np.log(np.sort(taus)[::-1])),
        lambda here: 2 * here.criterion,
        normal_equations,
        moved,
        lambda here: 2 * LIKELIHOOD_TOLERANCE,
        MAX_ITERATIONS,
        merged,
    )
    order = np.argsort(-end.point.time_constants)
    if np.all(np.diff(order) == 1):
        return replace(end.point, converged=end.converged)
    ordered = end.point.time_constants[order]
    return NetworkSearchResult(ordered, problem.project(ordered), end.converged)


def starts(problem: NetworkProblem, modes: int) -> list[Array]:
    """Time constants to start from: chosen from a grid for all outputs together, and spread ones.

    Parameters
    ----------
    problem : NetworkProblem
    modes : int

    Returns
    -------
    list of ndarray, shape (N,) [s]
    """
    low, high = box(problem)
    low, high = 3 * low, high / 5
    count = max(modes + 2, round(STARTS_PER_DECADE * np.log10(high / low)))
    grid = np.geomspace(high, low, count)
    few = replace(problem, data=problem.data.longest_records(MAX_START_RECORDS))
    chosen = _chosen(_StartLosses(few, grid), modes)
    spread = np.geomspace(high / 10, max(low * 5, high / 1000), modes)
    return [grid[list(chosen)], spread]


class _StartLosses:
    """Losses of any choice from a grid of time constants, from one pass over the rows."""

    def __init__(self, problem: NetworkProblem, grid: Array) -> None:
        self.count, self.inputs = len(grid), len(problem.data.inputs)
        # Feedthrough and offsets, which every choice has.
        self.always = problem.direct_count + problem.data.experiments
        self.sums: list[Sums] = problem.sums(grid, slopes=False)
        self.shared: dict[int, list[int]] = {}
        for k, s in enumerate(self.sums):
            self.shared.setdefault(id(s.gram), []).append(k)

    def __call__(self, chosen: Sequence[int]) -> float:
        own, count, edge = np.array(chosen), self.count, self.count * self.inputs
        decays = (len(self.sums[0].cross) - edge - self.always) // count
        place = np.concatenate([
            *(own + count * i for i in range(self.inputs)),
            edge + np.arange(self.always),
            *(own + edge + self.always + count * i for i in range(decays)),
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


def _chosen(bank: _StartLosses, modes: int) -> tuple[int, ...]:
    """The best pair, then one by one, then exchanges of one while they help."""
    each = range(bank.count)
    if modes == 1:
        return (min(each, key=lambda j: bank((j,))),)
    best: tuple[int, ...] = min(itertools.combinations(each, 2), key=bank)
    for _ in range(modes - 2):
        best = min((tuple(sorted({*best, j})) for j in each if j not in best), key=bank)
    for _ in range(MAX_EXCHANGES):
        known = bank(best)
        others = [tuple(sorted({*best, j} - {out})) for out in best for j in each if j not in best]
        other = min(others, key=bank)
        if not bank(other) < known:
            break
        best = other
    return best
