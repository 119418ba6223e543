"""What a regression misses in conditions that it was not fitted to: one protocol for all methods.

Zhu, Ni, Shih (2008, 3.2 and 4) ask for linear extrapolation and for sensitivity to frequency. Here
a trial holds out blocks in turn, the second half of every log (time), rows at which the machine is
warmer than most (level), one operating condition after the other, or one log after the other (other
periods, other duty).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, training_data
from thermaltool.fitting.selection import BLOCKS
from thermaltool.model import relative
from thermaltool.placement.estimators import Method, blocks_of
from thermaltool.placement.regression import RegressionProblem, Rows, ThermalRegression
from thermaltool.record import Record
from thermaltool.units import drive_reference, hold_of

# Rows whose mean rise is above this part of the largest are held out as another level.
LEVEL_PART = 0.6
# Conditions that are left out one after the other: more values are no conditions.
MAX_CONDITIONS = 12


@dataclass(frozen=True)
class Trial:
    """What is fitted and what is held out.

    Attributes
    ----------
    name : str
    splits : tuple of (ndarray of bool, ndarray of bool)
        Rows that are fitted and rows that judge, each in turn.
    """

    name: str
    splits: tuple[tuple[Rows, Rows], ...]


@dataclass(frozen=True)
class OutputRegression:
    """One output: its regression, and what every method misses.

    Attributes
    ----------
    problem : RegressionProblem
    regression : ThermalRegression
        By the method that was asked for, on all rows.
    errors : mapping of (method, form) to mapping of trial to float [unit of the output]
        Root mean square over rows that the weights were not fitted to (time constants and terms
        are chosen on all); form is "static" or "lagged".
    """

    problem: RegressionProblem
    regression: ThermalRegression
    errors: Mapping[tuple[str, str], Mapping[str, float]]


def trials(
    problem: RegressionProblem, conditions: Array | None = None, names: Sequence[str] = ()
) -> tuple[Trial, ...]:
    """All trials that the data admit.

    Parameters
    ----------
    problem : RegressionProblem
    conditions : ndarray, shape (rows,), optional
        The operating condition of each row (a speed).
    names : sequence of str
        Of the logs.

    Raises
    ------
    FitError
        One condition, or too many values to be conditions.
    """
    size, origins = len(problem.measured), np.unique(problem.origin)
    logs = [np.flatnonzero(problem.origin == e) for e in origins]
    blocks = zip(*(list(blocks_of(rows, BLOCKS, size)) for rows in logs), strict=False)
    found = [Trial("blocks", tuple((~held, held) for held in map(_any, blocks)))]
    later = _any([list(blocks_of(rows, 2, size))[-1] for rows in logs])
    found.append(Trial("time", ((~later, later),)))
    high = _warm(problem)
    if 0 < int(high.sum()) < size:
        found.append(Trial("level", ((~high, high),)))
    if conditions is not None:
        values = np.unique(conditions[np.isfinite(conditions)])
        if not 1 < len(values) <= MAX_CONDITIONS:
            raise FitError(
                f"{len(values)} values are no operating conditions: 2 to {MAX_CONDITIONS} can be "
                "left out one after the other"
            )
        held = [conditions == value for value in values]
        found.append(Trial("condition", tuple((~rows, rows) for rows in held)))
    if len(origins) > 1:
        own_names = distinct(names)
        own = [problem.origin == e for e in origins]
        found.append(Trial("other log", tuple((~rows, rows) for rows in own)))
        for e, rows in zip(origins.tolist(), own, strict=True):
            # A log without a piece is no experiment.
            log = problem.data.logs[e] if problem.data.logs else e
            name = own_names[log] if log < len(own_names) else str(1 + log)
            found.append(Trial(f"{name} alone", ((rows, ~rows),)))
    return tuple(found)


def _any(parts: Sequence[Rows]) -> Rows:
    return np.asarray(np.any(list(parts), axis=0))


def distinct(names: Sequence[str]) -> list[str]:
    """Names of logs, numbered where several are the same.

    Parameters
    ----------
    names : sequence of str
    """
    several = {name for name in names if names.count(name) > 1}
    return [f"{name} ({1 + k})" if name in several else name for k, name in enumerate(names)]


def _warm(problem: RegressionProblem) -> Rows:
    """Rows whose mean size of rises, each sensor by its own largest, is high."""
    rises = np.abs([_rises(problem, name) for name in problem.basis.sensors])
    mean = np.mean(rises / np.maximum(rises.max(axis=1, keepdims=True), 1e-300), axis=0)
    return np.asarray(mean > LEVEL_PART * mean.max())


def _rises(problem: RegressionProblem, sensor: str) -> Array:
    values = problem.joined(sensor)
    hold = hold_of(sensor)
    for e in np.unique(problem.origin):
        own = problem.origin == e
        values[own] = relative(values[own], drive_reference(sensor), hold)
    return values


def judged(
    problem: RegressionProblem, methods: Sequence[Method], trials: Sequence[Trial]
) -> Mapping[Method, Mapping[str, float]]:
    """Root mean square of what every method misses in every trial; NaN where it has no fit.

    Parameters
    ----------
    problem : RegressionProblem
    methods : sequence of str
    trials : sequence of Trial

    Returns
    -------
    mapping of method to mapping of trial to float [unit of the output]
    """
    return {
        method: {trial.name: _error(problem, method, trial) for trial in trials}
        for method in methods
    }


def _error(problem: RegressionProblem, method: Method, trial: Trial) -> float:
    squares, rows = 0.0, 0
    for fitted, held in trial.splits:
        try:
            error = problem.error(fitted, held, method)
        except FitError:
            return float("nan")
        squares += error**2 * int(held.sum())
        rows += int(held.sum())
    return float(np.sqrt(squares / max(rows, 1)))


def missed(
    problem: RegressionProblem, log: Record, channels: Sequence[str], method: Method
) -> float:
    """Root mean square of what a fit to all rows misses of another log [unit of the output].

    Parameters
    ----------
    problem : RegressionProblem
    log : Record
    channels : sequence of str
        Sensors, and the position.
    method : str
    """
    found = problem.fit(problem.every, method)
    data = training_data([log], channels, [problem.output])
    other = RegressionProblem(data, problem.basis, dead=True)
    computed = other.computed(replace(found, offsets={}), other.every)
    return float(np.sqrt(np.mean((other.measured - computed) ** 2)))
