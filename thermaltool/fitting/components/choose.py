"""Through which lags, with how strong a ridge: an average over what may be.

Weights of choices that do about as well differ much, and their mean predicts rows behind a record
better than any of them (Hoeting, Madigan, Raftery, Volinsky 1999). Half of it is weighed by blocks
held out, in white errors, and half by the evidence, in errors whose colour is weighed with them:
the one sees what a slow response does, the other is not taken in by slow errors, and on simulated
machines, with slow errors and without, the mean of both predicts better than the blocks alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.fitting.components.problem import Choice, ComponentProblem, Weights
from thermaltool.fitting.data import Array
from thermaltool.fitting.error_model import ar_error_model
from thermaltool.fitting.selection import BLOCKS

# Difference of scores, logarithms of error variances held out, at which a choice counts 1/e of
# another.
SCORE_SCALE = 0.1
# The same between the inputs themselves and their lags: where the square of the difference counts,
# neither is left out by less than blocks can tell.
FORM_SCALE = 2.0
# What counts less is left out.
MIN_WEIGHT = 1e-3
# Variance of an average's error over that of the weights of what varies by 1, in all that is tried.
WEIGHT_RIDGES = (1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)


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


def choices_of(problem: ComponentProblem) -> tuple[list[Choice], list[Choice]]:
    """The inputs themselves, and them through lags: with all ridges.

    All time constants of the grid or every second one, with the inputs themselves or without. The
    errors are white: what is taken for a slow error is no longer there to tell a slow response.

    Parameters
    ----------
    problem : ComponentProblem
    """
    grid = tuple(range(len(problem.times)))
    direct: list[tuple[tuple[int, ...], bool]] = [((), True)]
    lagged = [(lags, beside) for lags in (grid, grid[::2], grid[1::2]) for beside in (True, False)]
    rows, count = len(problem.output), problem.reduction.kept(len(problem.data.inputs))
    static, dynamic = (
        [
            Choice(count, lags, beside, 0.0, rows * ridge)
            for lags, beside in forms
            for ridge in WEIGHT_RIDGES
        ]
        for forms in (direct, lagged)
    )
    return static, dynamic


def likely_choices(problem: ComponentProblem) -> list[Choice]:
    """Those of which the evidence decides, in errors that are white and of all correlation times.

    The inputs themselves, alone or with one lag of the grid, all or every second one.

    Parameters
    ----------
    problem : ComponentProblem
    """
    grid = tuple(range(len(problem.times)))
    forms: list[tuple[int, ...]] = [(), grid, grid[::2], grid[1::2], *((lag,) for lag in grid)]
    count = problem.reduction.kept(len(problem.data.inputs))
    times = [0.0, *problem.error_times.tolist()]
    return [Choice(count, lags, True, time) for time in times for lags in forms]


def evidence_choices(problem: ComponentProblem) -> Iterator[Choice]:
    """All inputs with one lag of the grid or with all, in errors of all correlation times.

    Parameters
    ----------
    problem : ComponentProblem
    """
    grid = range(len(problem.times))
    for time in problem.error_times.tolist():
        for lags in (*((lag,) for lag in grid), tuple(grid)):
            yield Choice(len(problem.data.inputs), lags, True, time)


def averaged(problem: ComponentProblem) -> tuple[Weights, tuple[Weighed, ...]]:
    """Weights of every input as the mean over all choices, and what each counts, the most first.

    Of the first half each of five blocks of every log but the first is held out in turn. The score
    of a choice is the mean over the blocks of the logarithm of the mean square error. The inputs
    themselves and their lags are weighed less sharply: blocks say how well a choice goes on at
    levels that there are, not at others, and the errors of the two differ there. Of the other half
    a choice counts by its evidence.

    Parameters
    ----------
    problem : ComponentProblem
    """
    forms = choices_of(problem)
    every = np.ones(len(problem.output), bool)
    scored = [choice for form in forms for choice in form]
    likely = problem.fit(every, likely_choices(problem))
    evidence = np.array([len(every) * each.level / 2 for each in likely])
    likelihood = _shares(np.exp(evidence.min() - evidence))
    likely = [each for each, share in zip(likely, likelihood, strict=True) if share]
    choices = scored + [replace(each.choice, ridge=0.0) for each in likely]
    whole = problem.fit(every, scored) + likely
    squares = []
    for split in problem.data.folds(BLOCKS):
        held = problem.held(split)
        if held.any() and not held.all():
            found = problem.fit(~held, choices, False)
            squares.append([np.mean(problem.errors(each)[held] ** 2) for each in found])
    each: Array = np.maximum(np.array(squares), 1e-300)
    scores = np.log(each).mean(axis=0)[: len(scored)]
    parts = np.split(scores, [len(forms[0])])
    apart = np.array([own.min() for own in parts]) - scores.min()
    weights = np.exp(-((apart / FORM_SCALE) ** 2))
    weights /= weights.sum()
    by_blocks = [_counts(own) * weight for own, weight in zip(parts, weights, strict=True)]
    counts = np.concatenate([*by_blocks, likelihood[likelihood > 0]]) / 2
    order = [k for k in np.argsort(-counts, kind="stable").tolist() if counts[k]]
    errors = np.sqrt(each.mean(axis=0))
    mean = _mean(problem, [whole[k] for k in order], counts[order])
    weighed = [Weighed(whole[k].choice, float(errors[k]), float(counts[k])) for k in order]
    return mean, tuple(weighed)


def _counts(scores: Array) -> Array:
    """What choices count by their scores, in all 1."""
    return _shares(np.exp(-(scores - scores.min()) / SCORE_SCALE))


def _shares(counts: Array) -> Array:
    """In all 1, without what counts hardly."""
    counts = np.where(counts < MIN_WEIGHT * counts.sum(), 0.0, counts)
    return np.asarray(counts / counts.sum())


def _mean(problem: ComponentProblem, found: Sequence[Weights], counts: Array) -> Weights:
    """The mean of weights over all lags that some of them have; how they differ widens it."""
    m, pieces = len(problem.data.inputs), problem.decays.shape[1]
    lags = sorted({lag for each in found for lag in each.choice.lags})
    slots = {lag: 1 + k for k, lag in enumerate(lags)}
    size = (1 + len(lags)) * m
    values = np.zeros((len(found), size))
    # In errors that were taken for white, and in those whose colour counts already.
    white, coloured = np.zeros((size, size)), np.zeros((size, size))
    decays, offsets = np.zeros(len(lags) * pieces), np.zeros(problem.data.experiments)
    for k, (each, count) in enumerate(zip(found, counts.tolist(), strict=True)):
        own = [0, *(slots[lag] for lag in each.choice.lags)]
        place = np.concatenate([m * slot + np.arange(m) for slot in own])
        values[k, place] = each.values.ravel()
        covariance = coloured if each.choice.error_time else white
        covariance[np.ix_(place, place)] += count * each.covariance
        for at, slot in enumerate(own[1:]):
            part = slice((slot - 1) * pieces, slot * pieces)
            decays[part] += count * each.decays[at * pieces : (at + 1) * pieces]
        offsets += count * each.offsets
    mean = counts @ values
    apart = (values - mean) * np.sqrt(counts)[:, None]
    whole = Weights(
        replace(found[0].choice, lags=tuple(lags)),
        float(counts @ [each.level for each in found]),
        mean.reshape(1 + len(lags), m),
        decays,
        offsets,
        white,
        float(counts @ [each.freedom for each in found]),
    )
    slow = _slowness(problem, problem.errors(whole))
    return replace(whole, covariance=slow * white + coloured + apart.T @ apart)


def _slowness(problem: ComponentProblem, errors: Array) -> float:
    """Spectral density of errors at frequency zero over that of white ones; one at least.

    By so much the variance of a slope over a slow course is larger than in white errors.
    """
    ends = np.flatnonzero(np.diff(problem.record)) + 1
    model = ar_error_model(np.split(errors, ends))
    if model is None:
        return 1.0
    coefficients, variance = model
    power = max(float(np.mean(errors**2)), 1e-300)
    return max(1.0, variance / float(np.sum(coefficients)) ** 2 / power)
