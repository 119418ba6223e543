"""How many poles, with direct feedthrough or without, and whether a record begins at rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, Split, TrainingData
from thermaltool.fitting.search_budget import SearchBudget
from thermaltool.fitting.selection import FITTED_SHARE, Candidate, held_out_level, rank
from thermaltool.fitting.start_state import StartErrors
from thermaltool.fitting.subspace.identify import identify_subspace, problem_of
from thermaltool.fitting.subspace.modal import fitted_as, grown
from thermaltool.fitting.subspace.model import Subspace
from thermaltool.fitting.subspace.problem import SubspacePoint, SubspaceProblem
from thermaltool.fitting.subspace.realization import realizations
from thermaltool.fitting.subspace.search import ROUGH_TOLERANCE, search
from thermaltool.fitting.subspace.sections import PoleSection
from thermaltool.responses.rational import MAX_POLES

# The choice ends where so many orders in a row have not lowered the error of the rows held out by
# what their parameters cost in white errors.
PATIENCE = 3
# Feedthrough beside poles of one combination lowers ln of the error variance by so much against so
# many poles more: where it is there the gain is 0.3 to 0.5, elsewhere 0.02 at most.
MIN_DIRECT_GAIN, MORE_POLES = 0.1, 2
# Weights free for every input and output are told from one combination for each pole by the rows
# held out once where the logarithm of the error variance differs by more.
CLOSE = 0.5
# Autocorrelation of errors at a row, at most.
MAX_COLOUR = 0.99
# Poles beside which the start is judged, at most.
MAX_START_ORDER = 6


def choose_order(
    data: TrainingData,
    orders: Sequence[int] = range(1, MAX_POLES + 1),
    budget: SearchBudget | None = None,
    real: bool = False,
    combinations: bool = True,
) -> tuple[Candidate[Subspace], ...]:
    """Numbers of poles, with feedthrough and without, by what they predict of rows held out.

    Parameters
    ----------
    data : TrainingData
    orders : sequence of int
        That are tried, rising.
    budget : SearchBudget, optional
    real : bool
        Real poles alone.
    combinations : bool
        Whether poles that each take one combination of the inputs, always real, are tried.

    Raises
    ------
    FitError
        No candidate fits.
    """
    data.check()
    split = data.split(FITTED_SHARE)
    found = realizations(split.fitted, max(orders))
    taken = combinations and takes_combinations(data)

    def candidates() -> Iterator[Subspace]:
        problem: FitError | None = None
        any_fits = False
        for direct in (False, True) if data.may_act_at_once else (False,):
            best, since = np.inf, 0
            beside: list[tuple[PoleSection, ...]] = []
            for order in orders:
                try:
                    model = identify_subspace(
                        split.fitted, order, direct, beside, found, judged=False, real=real
                    )
                except FitError as error:
                    problem = problem or error
                    since += 1
                else:
                    any_fits = True
                    beside, level = [model.sections], held_out_level(model, split)
                    best, since = (level, 0) if level < best else (best, since + 1)
                    yield model
                if since >= PATIENCE:
                    break
        for model in _of_combinations(split, orders) if taken else ():
            any_fits = True
            yield model
        if not any_fits and problem is not None:
            raise problem

    ranked = _ranked(candidates(), split, budget, real)
    return ranked if budget is not None and budget.is_over else _settled(ranked, data, real)


def _settled(
    ranked: tuple[Candidate[Subspace], ...], data: TrainingData, real: bool
) -> tuple[Candidate[Subspace], ...]:
    """The same, with poles that take one combination each first where all rows say so.

    A minimal realization has such poles, and rows held out once say little of whether there are
    enough of them. Where both kinds are close, each is fitted to all rows, and BIC decides by so
    many independent ones as the colour of the errors leaves.
    """
    best = ranked[0]
    others = [c for c in ranked if c.model.participations is not None]
    if best.model.participations is not None or not others or others[0].score - best.score > CLOSE:
        return ranked
    try:
        own, other = (fitted_as(data, c.model, False, real) for c in (best, others[0]))
    except FitError:
        return ranked
    over = min(_colour(own, data), _colour(other, data))
    fall = data.rows / over * (_level(own) - _level(other))
    more = other.criteria.parameters - own.criteria.parameters
    if fall < more * float(np.log(data.rows / over)):
        return ranked
    return (others[0], *(c for c in ranked if c is not others[0]))


def _level(model: Subspace) -> float:
    """Sum over the outputs of the logarithm of the error variance."""
    return float(sum(np.log(max(o.loss / o.rows, 1e-300)) for o in model.outputs))


def _colour(model: Subspace, data: TrainingData) -> float:
    """Rows for each independent one, of errors of the first order, in the mean of the outputs."""
    found = []
    for k, output in enumerate(model.outputs):
        runs = [error for error, _ in output.residuals(data.only(k)) if len(error) > 1]
        late = sum(float(error[1:] @ error[:-1]) for error in runs)
        power = sum(float(error[:-1] @ error[:-1]) for error in runs)
        share = float(np.clip(late / max(power, 1e-300), 0.0, MAX_COLOUR))
        found.append((1 + share) / (1 - share))
    return float(np.mean(found))


def _of_combinations(split: Split, orders: Sequence[int]) -> Iterator[Subspace]:
    """Models whose poles take one combination each; with feedthrough where poles do not explain it.

    Two fast poles more look like a feedthrough of what is in truth a row late, and the other way
    round: which of both predicts better is chance.
    """
    data, deviances = split.fitted, list[float]()
    least = MIN_DIRECT_GAIN * data.rows * len(data.outputs)
    for direct in (False, True) if data.may_act_at_once else (False,):
        best, since = np.inf, 0
        for model in grown(data, max(orders), direct):
            level, wanted = held_out_level(model, split), model.order in orders
            best, since = (level, 0) if level < best else (best, since + 1)
            if direct:
                instead = deviances[min(model.order + MORE_POLES, len(deviances)) - 1]
                wanted &= model.criteria.deviance < instead - least
            else:
                deviances.append(model.criteria.deviance)
            if wanted:
                yield model
            if since >= PATIENCE and model.order >= min(orders):
                break


def again(
    data: TrainingData, models: Sequence[Subspace], budget: SearchBudget | None, real: bool
) -> tuple[Candidate[Subspace], ...]:
    """Models of some structures, refitted to other data and ranked by them.

    Parameters
    ----------
    data : TrainingData
    models : sequence of Subspace
    budget, real
        As for `choose_order`.

    Raises
    ------
    FitError
        None fits.
    """
    split = data.split(FITTED_SHARE)

    def candidates() -> Iterator[Subspace]:
        problem: FitError | None = None
        any_fits = False
        for model in models:
            # One that these data do not carry says nothing of the others.
            try:
                fitted = fitted_as(split.fitted, model, judged=False, real=real)
            except FitError as error:
                problem = problem or error
            else:
                any_fits = True
                yield fitted
        if not any_fits and problem is not None:
            raise problem

    return _ranked(candidates(), split, budget, real)


def _ranked(
    candidates: Iterator[Subspace], split: Split, budget: SearchBudget | None, real: bool
) -> tuple[Candidate[Subspace], ...]:
    def fit(each: Subspace, part: TrainingData) -> _ByPoles:
        own = each if part is split.fitted else fitted_as(part, each, judged=False, real=real)
        return _ByPoles(own)

    ranked = rank(candidates, fit, split, "no number of modes fits", budget)
    return tuple(Candidate(c.model.model, c.fit_percent, c.score) for c in ranked)


def takes_combinations(data: TrainingData) -> bool:
    """Whether there are several inputs and outputs: of one, any pole takes one combination.

    Parameters
    ----------
    data : TrainingData
    """
    return min(len(data.inputs), len(data.outputs)) > 1


@dataclass(frozen=True)
class _ByPoles:
    """A model whose poles count, for each output, and feedthrough as another one.

    Not its weights, of which sixteen inputs have sixteen for each pole: slow errors are worth so
    few rows that no second pole would be taken. What weights too many do, rows held out show. A
    pole that takes one combination of the inputs counts by its share of the parameters of one with
    weights free for every input and output.
    """

    model: Subspace

    @property
    def parameters(self) -> float:
        p, m = len(self.model.outputs), len(self.model.outputs[0].names)
        poles: float = self.model.order
        if self.model.participations is not None:
            poles *= (m + p) / (1 + m * p)
        return p * (poles + self.model.has_direct)

    def carried_on(self, split: Split) -> Array:
        """As that of the model."""
        return self.model.carried_on(split)


def start_errors(data: TrainingData) -> StartErrors | None:
    """Errors of so many poles as lower BIC; None where there are too few rows."""
    best: tuple[float, SubspacePoint, SubspaceProblem] | None = None
    known = realizations(data, MAX_START_ORDER)
    for order in range(1, MAX_START_ORDER + 1):
        try:
            problem = problem_of(data, order, False)
            point = search(problem, known, order, tolerance=ROUGH_TOLERANCE).point
        except FitError:
            break
        size = (problem.linear_count(order) + order) * len(data.outputs)
        bic = 2 * point.criterion + size * float(np.log(data.rows))
        if best is not None and not bic < best[0]:
            break
        best = bic, point, problem
    if best is None:
        return None
    _, point, problem = best
    return StartErrors(
        (point.losses / point.rows).tolist(), partial(problem.errors_on_clock, point)
    )
