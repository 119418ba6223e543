"""Selection among candidates by what they predict of rows that were not fitted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import effective_share, runs_of
from thermaltool.signals.agreement import Agreement, agreement

# Share of each experiment on which candidates are fitted; the rest validates them.
FITTED_SHARE = 0.6
# Longest dead time that is tried, in sample periods.
MAX_DELAY = 60


class Ranked(Protocol):
    """What is asked of a model to rank it: its number of parameters and its free runs."""

    @property
    def parameters(self) -> int: ...
    def run(self, data: TrainingData) -> Array: ...


C = TypeVar("C")
M = TypeVar("M")
R = TypeVar("R", bound=Ranked)


@dataclass(frozen=True)
class Candidate(Generic[R]):
    """One choice of orders.

    Attributes
    ----------
    model : TransferModel or Network
        Fitted to the first part of the data.
    fit_percent : tuple of float, one for each output
        Free run over the part that was not fitted.
    score : float
        As `held_out_scores`.
    """

    model: R
    fit_percent: tuple[float, ...]
    score: float


def rank(
    candidates: Iterable[C], fit: Callable[[C], R | None], held: TrainingData, none: str
) -> tuple[Candidate[R], ...]:
    """Candidates by what they predict of data that they were not fitted to, the best first.

    Parameters
    ----------
    candidates : iterable
    fit : callable
        Model of a candidate; FitError where the data do not carry it, None where it is not wanted.
    held : TrainingData
        That the models were not fitted to.
    none : str
        What is wrong where no candidate has a model, and none says why.

    Raises
    ------
    FitError
        There is none; the message is that of the first that failed.
    """
    found: list[tuple[R, Array, list[Agreement]]] = []
    problem: FitError | None = None
    for each in candidates:
        try:
            model = fit(each)
        except FitError as error:
            problem = problem or error
            continue
        if model is None:
            continue
        run = np.atleast_2d(model.run(held))
        fits = [agreement(held.output(k), own) for k, own in enumerate(run)]
        if all(np.isfinite(each.rmse) for each in fits):
            found.append((model, run, fits))
    if not found:
        raise problem or FitError(none)
    counts = [model.parameters / len(held.outputs) for model, _, _ in found]
    scores = held_out_scores(held, [run for _, run, _ in found], counts)
    ranked = [
        Candidate(model, tuple(each.fit_percent for each in fits), score)
        for (model, _, fits), score in zip(found, scores, strict=True)
    ]
    return tuple(sorted(ranked, key=lambda candidate: candidate.score))


def first_that_fits(candidates: Iterable[C], fit: Callable[[C], M]) -> M:
    """The model of the first of `candidates`, the best first, that fits the whole training data.

    Parameters
    ----------
    candidates : iterable
    fit : callable
        Model of a candidate; FitError where the data do not carry it.

    Raises
    ------
    FitError
        None does; the message is that of the best.
    """
    problem: FitError | None = None
    for each in candidates:
        try:
            return fit(each)
        except FitError as error:
            problem = problem or error
    raise problem or FitError("there is no candidate")


def held_out_scores(
    held: TrainingData, computed: Sequence[Array], parameters: Sequence[float]
) -> list[float]:
    """Score of every candidate on data that it was not fitted to; the least is the best.

    Mean over the outputs of ln of the error variance, with ln(N)/N for each parameter. N are the
    rows that count: errors that drift say less than as many that are white.

    Parameters
    ----------
    held : TrainingData
    computed : sequence of ndarray, shape (p, n)
        Free run of each candidate over all records in a row, NaN where it has none; some of its
        errors are finite.
    parameters : sequence of float
        For each output in the mean.
    """
    measured = np.array([held.output(k) for k in range(len(held.outputs))])
    errors = [measured - run for run in computed]
    variances = [np.maximum(np.nanmean(e**2, axis=1), 1e-300) for e in errors]
    levels = [float(np.mean(np.log(each))) for each in variances]
    ends = np.cumsum([len(record) for record in held.records])[:-1]
    shares = [
        effective_share([run for part in np.split(error, ends) for run in runs_of(part)])
        for error in errors[int(np.argmin(levels))]
    ]
    rows = max(float(np.mean(shares)) * held.rows, 2.0)
    penalty = float(np.log(rows)) / rows
    return [level + count * penalty for level, count in zip(levels, parameters, strict=True)]
