"""Selection among candidates by what they predict of rows that were not fitted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, Split, TrainingData
from thermaltool.fitting.error_model import effective_share
from thermaltool.fitting.search_budget import SearchBudget
from thermaltool.signals.agreement import Agreement, agreement

# Share of each experiment on which all candidates are fitted; the rest judges them.
FITTED_SHARE = 0.6
# Blocks of each experiment, of which all but the first are held out in turn, and the candidates
# for which that is done: it takes four fits for each.
BLOCKS, FINALISTS = 5, 8
# Longest dead time that is tried, in sample periods.
MAX_DELAY = 60
# Direct feedthrough is tried where the input of the same row lowers the squared error by more than
# this many times ln N error variances.
MIN_DIRECT_EVIDENCE = 2.0


class Ranked(Protocol):
    """What is asked of a model to rank it: its number of parameters and its free runs."""

    @property
    def parameters(self) -> float: ...
    def carried_on(self, split: Split) -> Array: ...


C = TypeVar("C")
M = TypeVar("M")
R = TypeVar("R", bound=Ranked)


@dataclass(frozen=True)
class Candidate(Generic[R]):
    """One choice of orders.

    Attributes
    ----------
    model : TransferModel or Network
        Fitted to a part of the data.
    fit_percent : tuple of float, one for each output
        Free run over the part that was not fitted.
    score : float
        As `held_out_scores`.
    """

    model: R
    fit_percent: tuple[float, ...]
    score: float


def rank(
    candidates: Iterable[C],
    fit: Callable[[C, TrainingData], R | None],
    split: Split,
    none: str,
    budget: SearchBudget | None = None,
) -> tuple[Candidate[R], ...]:
    """Candidates by what they predict of data that they were not fitted to, the best first.

    What is held out is run into with the state that the rows before it leave. All candidates are
    fitted to the first part of the data and judged by the rest; the best of them then with blocks
    of the data held out in turn (`TrainingData.folds`), where the inputs excite without them.

    Parameters
    ----------
    candidates : iterable
    fit : callable
        Model of a candidate for given data; FitError where they do not carry it, None where it is
        not wanted.
    split : Split
        The data, and what is fitted and held out at first.
    none : str
        What is wrong where no candidate has a model, and none says why.
    budget : SearchBudget, optional
        Where it ends the search, those that were judged by the first split are ranked by it.

    Raises
    ------
    FitError
        There is none; the message is that of the first that failed.
    """
    budget = budget or SearchBudget()
    first, problem = _judged(candidates, fit, [split], budget)
    if not first:
        part = f"fitted to {split.fitted.rows} of {split.data.rows} rows, to choose by the others"
        kind, channel = type(problem or FitError("")), problem.channel if problem else ""
        raise kind(f"{problem or none} ({part})", channel)
    folds = [fold for fold in split.data.folds(BLOCKS) if excites(fold.fitted)]
    finalists = [each for each, _ in first[:FINALISTS]] if folds and not budget.is_over else []
    last = _judged(finalists, fit, folds, budget)[0] if finalists else []
    if budget.is_over:
        last = []
    done = {id(each) for each, _ in last}
    return tuple(found for _, found in (*last, *(p for p in first if id(p[0]) not in done)))


def _judged(
    candidates: Iterable[C],
    fit: Callable[[C, TrainingData], R | None],
    splits: Sequence[Split],
    budget: SearchBudget,
) -> tuple[list[tuple[C, Candidate[R]]], FitError | None]:
    """Candidates that all splits carry, the best first; and why the first did not fit."""
    data = splits[0].data
    held = replace(data, records=tuple(r for split in splits for r in split.held.records))
    tried: list[C] = []
    found: list[tuple[R, Array, list[Agreement]]] = []
    problem: FitError | None = None
    pending = iter(candidates)
    while not (found and budget.is_over):
        runs, model = [], None
        try:
            if (each := next(pending, None)) is None:
                break
            for split in splits:
                model = fit(each, split.fitted)
                if model is None:
                    break
                runs.append(np.atleast_2d(model.carried_on(split)))
        except FitError as error:
            problem = problem or error
            continue
        except KeyboardInterrupt:
            if not found:
                raise
            budget.interrupt()
            break
        if model is None:
            continue
        budget.count()
        run = np.hstack(runs)
        fits = [agreement(held.output(k), own) for k, own in enumerate(run)]
        if all(np.isfinite(own.rmse) for own in fits):
            tried.append(each)
            found.append((model, run, fits))
    if not found:
        return [], problem
    counts = [model.parameters / len(held.outputs) for model, _, _ in found]
    scores = held_out_scores(held, [run for _, run, _ in found], counts)
    ranked = [
        (each, Candidate(model, tuple(own.fit_percent for own in fits), score))
        for each, (model, _, fits), score in zip(tried, found, scores, strict=True)
    ]
    return sorted(ranked, key=lambda pair: pair[1].score), problem


def excites(data: TrainingData) -> bool:
    """Whether the inputs excite and the outputs move (`TrainingData.check`).

    Parameters
    ----------
    data : TrainingData
    """
    try:
        data.check()
    except FitError:
        return False
    return True


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


def held_out_level(model: Ranked, split: Split) -> float:
    """Score of rows held out as if their errors were white (`held_out_scores`).

    Parameters
    ----------
    model : Ranked
    split : Split
    """
    held, runs = split.held, np.atleast_2d(model.carried_on(split))
    errors = [agreement(held.output(k), run).rmse for k, run in enumerate(runs)]
    cost = model.parameters / len(errors) * np.log(held.rows) / held.rows
    return float(2 * np.mean(np.log(np.maximum(errors, 1e-300))) + cost)


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
    shares = [effective_share(np.split(error, ends)) for error in errors[int(np.argmin(levels))]]
    rows = max(float(np.mean(shares)) * held.rows, 2.0)
    penalty = float(np.log(rows)) / rows
    return [level + count * penalty for level, count in zip(levels, parameters, strict=True)]
