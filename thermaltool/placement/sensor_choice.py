"""Sensors by what a regression on them predicts of rows that it was not fitted to.

Measured logs tell moments of the temperatures badly where these say much the same, and a design
that trusts them takes sensors whose weights cancel. So every set is judged by blocks of each log,
and by whole logs where there are several, that are held out in turn; a ridge holds the weights of
one set, whatever their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError, counted
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.selection import BLOCKS
from thermaltool.placement.estimators import blocks_of
from thermaltool.placement.regression import Basis, RegressionProblem, Rows

# Variance of the errors of all rows over that of the weights, by the mean square of the columns.
RIDGES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# Low-pass states beside a sensor: none, or time constants of these parts of the longest log.
LAG_PARTS: tuple[tuple[float, ...], ...] = ((), (16.0,), (50.0, 6.0))
# Rows of each block that is held out, at least.
MIN_BLOCK_ROWS = 2
# A score, a logarithm of an RMS, is better by this at least.
MIN_GAIN = 1e-9


@dataclass(frozen=True)
class JudgedSet:
    """Chosen sensors.

    Attributes
    ----------
    sensors : tuple of str
        In the order of the log.
    time_constants : tuple of float [s]
    errors : tuple of float, one for each output [unit of the output]
        Root mean square of what is missed of held-out rows, geometric mean over the blocks.
    ridge : float
        Variance of the errors over that of the weights, scaled.
    """

    sensors: tuple[str, ...]
    time_constants: tuple[float, ...]
    errors: tuple[float, ...]
    ridge: float

    @property
    def score(self) -> float:
        """Mean of the logarithms of the errors."""
        return float(np.mean(np.log(self.errors)))


def lag_forms(data: TrainingData) -> tuple[tuple[float, ...], ...]:
    """Time constants that are tried: none, one, two, parts of the longest log with its pauses [s].

    None is faster than two sample periods.

    Parameters
    ----------
    data : TrainingData
    """
    begins = {e: data.records[k].time[0] for e, k in data.begins.items()}
    duration = float(max(record.time[-1] - begins[record.origin] for record in data.records))
    least = 2 * max(record.period for record in data.records if len(record) > 1)
    forms = (tuple(duration / part for part in parts) for parts in LAG_PARTS)
    return tuple(taus for taus in forms if min(taus, default=least) >= least)


def best_time_constants(data: TrainingData, sensors: Sequence[str]) -> tuple[float, ...]:
    """Time constants with which all sensors together predict held-out rows best [s].

    None where the rows are too few to hold some out.

    Parameters
    ----------
    data : TrainingData
        With one output.
    sensors : sequence of str
    """
    found = []
    if len(RegressionProblem(data, Basis(tuple(sensors))).measured) < MIN_BLOCK_ROWS * BLOCKS:
        return ()
    for taus in lag_forms(data):
        scores = HeldOutScores([RegressionProblem(data, Basis(tuple(sensors), taus))])
        found.append(scores.choice(range(len(sensors))))
    return min(found, key=lambda each: each.score).time_constants


def held_out_rows(problem: RegressionProblem) -> list[Rows]:
    """Rows that are held out in turn: blocks of every log, and whole logs where there are several.

    Parameters
    ----------
    problem : RegressionProblem
    """
    size, origins = len(problem.measured), np.unique(problem.origin)
    logs = [list(blocks_of(np.flatnonzero(problem.origin == e), BLOCKS, size)) for e in origins]
    # Block k of every log at once: what is left of each keeps its zero.
    found = [np.any(parts, axis=0) for parts in zip(*logs, strict=False)]
    if len(origins) > 1:
        found += [problem.origin == e for e in origins]
    return found


class HeldOutScores:
    """Errors of any set of sensors over rows that are held out, by sums over the rows.

    Parameters
    ----------
    problems : sequence of RegressionProblem
        One for each output, with the same basis.

    Raises
    ------
    FitError
        Too few rows for blocks that are held out.
    """

    def __init__(self, problems: Sequence[RegressionProblem]) -> None:
        rows = min(len(problem.measured) for problem in problems)
        if rows < MIN_BLOCK_ROWS * BLOCKS:
            raise FitError(
                f"{counted(rows, 'row')}: too few to hold out each of {BLOCKS} blocks in turn, "
                f"which takes {MIN_BLOCK_ROWS * BLOCKS}"
            )
        self.basis = problems[0].basis
        self._slots = 1 + len(self.basis.time_constants)
        self._sums = [[_sums(problem, held) for held in held_out_rows(problem)]
                      for problem in problems]  # fmt: skip
        self._known: dict[tuple[int, ...], JudgedSet] = {}

    def choice(self, sensors: Sequence[int]) -> JudgedSet:
        """A set with the ridge that suits it best.

        Parameters
        ----------
        sensors : sequence of int
            Of the basis.
        """
        key = tuple(sorted(sensors))
        if key not in self._known:
            place = (np.array(key)[:, None] * self._slots + np.arange(self._slots)).ravel()
            named = tuple(self.basis.sensors[k] for k in key)
            found = [
                JudgedSet(named, self.basis.time_constants, self._errors(place, ridge), ridge)
                for ridge in RIDGES
            ]
            self._known[key] = min(found, key=lambda each: each.score)
        return self._known[key]

    def _errors(self, place: NDArray[np.intp], ridge: float) -> tuple[float, ...]:
        found = []
        within = np.ix_(place, place)
        for blocks in self._sums:
            logs = []
            for gram, cross, held_gram, held_cross, power in blocks:
                w = np.linalg.solve(gram[within] + ridge * np.eye(len(place)), cross[place])
                left = power - 2 * w @ held_cross[place] + w @ held_gram[within] @ w
                logs.append(0.5 * np.log(max(float(left), 1e-12 * power, 1e-300)))
            found.append(float(np.exp(np.mean(logs))))
        return tuple(found)


_Sums = tuple[Array, Array, Array, Array, float]


def _sums(problem: RegressionProblem, held: Rows) -> _Sums:
    """Mean products of columns and output, about the means of the rows that are fitted."""
    fitted = ~held
    x = problem.values / problem.scale()[:, None]
    y = problem.measured.copy()
    for e in np.unique(problem.origin):
        own = problem.origin == e
        # Of a log that is held out whole the first rows are its zero.
        known = own & fitted if np.any(own & fitted) else own & _first(own)
        x[:, own] -= x[:, known].mean(axis=1, keepdims=True)
        y[own] -= y[known].mean()
    a, b, c, d = x[:, fitted], y[fitted], x[:, held], y[held]
    return a @ a.T / len(b), a @ b / len(b), c @ c.T / len(d), c @ d / len(d), float(d @ d) / len(d)


def _first(own: Rows) -> Rows:
    rows = np.flatnonzero(own)
    first = np.zeros(len(own), bool)
    first[rows[: max(3, min(30, len(rows) // 20))]] = True
    return first


def choose_sensors(
    scores: HeldOutScores, most: int, allowed: Sequence[int] | None = None
) -> tuple[JudgedSet, ...]:
    """The best set that is found for each number of sensors, by forward selection and exchange.

    Parameters
    ----------
    scores : HeldOutScores
    most : int
        The largest number.
    allowed : sequence of int, optional
        Candidates. Default: all.

    Raises
    ------
    FitError
        More sensors than candidates.
    """
    places = list(range(len(scores.basis.sensors))) if allowed is None else list(allowed)
    if most > len(places):
        raise FitError(
            f"{counted(most, 'sensor')} of {counted(len(places), 'candidate')}: ask for fewer"
        )
    chosen: list[int] = []
    found = []
    for _ in range(most):
        free = [k for k in places if k not in chosen]
        chosen.append(min(free, key=lambda k: scores.choice([*chosen, k]).score))
        while (better := _exchange(scores, chosen, places)) is not None:
            chosen = better
        found.append(scores.choice(chosen))
    return tuple(found)


def _exchange(
    scores: HeldOutScores, chosen: Sequence[int], places: Sequence[int]
) -> list[int] | None:
    """The best set that differs by one sensor; None where it is no better."""
    tried = [
        [*(c for c in chosen if c != gone), new]
        for gone in chosen
        for new in places
        if new not in chosen
    ]
    if not tried:
        return None
    best = min(tried, key=lambda each: scores.choice(each).score)
    return best if scores.choice(best).score < scores.choice(chosen).score - MIN_GAIN else None
