"""How many components, and through which lags: an average over what may be.

Weights of choices that do about as well differ much, and their mean predicts rows behind a record
better than any of them (Hoeting, Madigan, Raftery, Volinsky 1999).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.fitting.components.problem import Choice, ComponentProblem, Weights
from thermaltool.fitting.data import Array
from thermaltool.fitting.selection import BLOCKS

# Difference of scores, logarithms of error variances, at which a choice counts 1/e of another:
# blocks tell choices apart less surely than they differ. On 21 stretches of one measured log the
# mean leaves 3.4 um in the rows behind with 0.5, 3.2 um with 2.
SCORE_SCALE = 2.0
# What counts less is left out.
MIN_WEIGHT = 1e-3


@dataclass(frozen=True)
class Weighed:
    """One choice, and what it counts.

    Attributes
    ----------
    choice : Choice
    error : float [unit of the output]
        Root mean square over the blocks held out.
    weight : float
        In the average.
    """

    choice: Choice
    error: float
    weight: float


def choices_of(problem: ComponentProblem) -> Iterator[Choice]:
    """All numbers of components with one lag of the grid or with all, and all error times.

    Parameters
    ----------
    problem : ComponentProblem
    """
    grid = range(len(problem.times))
    counts = problem.reduction.tried(len(problem.data.inputs))
    for time in problem.error_times.tolist():
        for lags in (*((lag,) for lag in grid), tuple(grid)):
            for count in counts:
                yield Choice(count, lags, time, 0.0)


def averaged(problem: ComponentProblem) -> tuple[Weights, tuple[Weighed, ...]]:
    """Weights of every input as the mean over all choices, and what each counts, the most first.

    Each of five blocks of every log but the first is held out in turn. The score of a choice is the
    mean over the blocks of the logarithm of the mean square error, plus the evidence as that of an
    error variance: blocks show what goes wrong at other temperatures, the evidence what the rows
    between say.

    Parameters
    ----------
    problem : ComponentProblem
    """
    choices = list(choices_of(problem))
    whole = problem.fit(np.ones(len(problem.output), bool), choices)
    squares = []
    for split in problem.data.folds(BLOCKS):
        held = problem.held(split)
        if held.any() and not held.all():
            found = problem.fit(~held, choices)
            squares.append([np.mean(problem.errors(each)[held] ** 2) for each in found])
    each: Array = np.maximum(np.array(squares), 1e-300)
    scores = np.log(each).mean(axis=0) + np.array([found.level for found in whole])
    counts = np.exp(-(scores - scores.min()) / SCORE_SCALE)
    counts[counts < MIN_WEIGHT * counts.sum()] = 0.0
    counts /= counts.sum()
    order = [k for k in np.argsort(scores, kind="stable").tolist() if counts[k]]
    errors = np.sqrt(each.mean(axis=0))
    weighed = [Weighed(whole[k].choice, float(errors[k]), float(counts[k])) for k in order]
    return _mean(problem, [whole[k] for k in order], counts[order]), tuple(weighed)


def _mean(problem: ComponentProblem, found: Sequence[Weights], counts: Array) -> Weights:
    """The mean of weights over all lags that some of them have; how they differ widens it."""
    m, pieces = len(problem.data.inputs), problem.decays.shape[1]
    lags = sorted({lag for each in found for lag in each.choice.lags})
    slots = {lag: 1 + k for k, lag in enumerate(lags)}
    size = (1 + len(lags)) * m
    values, covariance = np.zeros((len(found), size)), np.zeros((size, size))
    decays, offsets = np.zeros(len(lags) * pieces), np.zeros(problem.data.experiments)
    for k, (each, count) in enumerate(zip(found, counts.tolist(), strict=True)):
        own = [0, *(slots[lag] for lag in each.choice.lags)]
        place = np.concatenate([m * slot + np.arange(m) for slot in own])
        values[k, place] = each.values.ravel()
        covariance[np.ix_(place, place)] += count * each.covariance
        for at, slot in enumerate(own[1:]):
            part = slice((slot - 1) * pieces, slot * pieces)
            decays[part] += count * each.decays[at * pieces : (at + 1) * pieces]
        offsets += count * each.offsets
    mean = counts @ values
    apart = (values - mean) * np.sqrt(counts)[:, None]
    best = found[0].choice
    return Weights(
        Choice(best.components, tuple(lags), best.error_time, best.ridge),
        float(counts @ [each.level for each in found]),
        mean.reshape(1 + len(lags), m),
        decays,
        offsets,
        covariance + apart.T @ apart,
        float(counts @ [each.freedom for each in found]),
    )
