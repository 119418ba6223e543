"""Orders and delays by what the model predicts of data that it has not seen.

Delays first: for each, the loss of a second-order model whose denominator stands; then every order
around them, around other delays that are nearly as good, and with direct feedthrough where the
input of the same row says something. Each candidate is fitted on the first
part of the record and judged by its free run over the rest; of nearly equal ones the criterion
takes that with fewer parameters. Errors that drift say less than as many that are white: they
count for fewer rows.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.search_budget import SearchBudget
from thermaltool.fitting.selection import (
    FITTED_SHARE,
    MAX_DELAY,
    MIN_DIRECT_EVIDENCE,
    Candidate,
    held_out_level,
    rank,
)
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.oe import OeStructure
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.search import MAX_COMPARED_ROWS, search
from thermaltool.fitting.transfer.structure import Structure

# Orders of the denominator that are tried.
MAX_ORDER = 4
# So many inputs are searched with less effort: each candidate takes seconds. The effort counts: of
# an evaporator with three inputs one output fell by 13 points without it.
MANY_INPUTS = 4
# Orders of many inputs that are tried with other delays.
BEST_ORDERS = 2
# Times that the delay of every input is found anew, the others held.
DELAY_ROUNDS = 3

# Numerator coefficients of each input, order of the denominators, delays.
Tried = tuple[tuple[int, ...], int, tuple[int, ...]]


def choose(
    data: TrainingData,
    structure: Structure,
    budget: SearchBudget | None = None,
    rough: bool = False,
) -> tuple[Candidate[TransferModel], ...]:
    """Orders nb, nf and delays nk of one structure, the best first.

    Parameters
    ----------
    data : TrainingData
    structure : Structure
    budget : SearchBudget, optional
    rough : bool
        With less effort, as for `MANY_INPUTS` and more.

    Raises
    ------
    FitError
        No candidate fits.
    """
    data.check()
    structure = replace(structure, rough=rough or len(data.inputs) >= MANY_INPUTS)
    short = data if data.rows <= MAX_COMPARED_ROWS else data.excerpt(MAX_COMPARED_ROWS)

    def fit(tried: Tried, part: TrainingData) -> TransferModel | None:
        nb, nf, delays = tried
        orders = structure.orders(nb, nf, delays)
        # A structure that has fewer orders to give is not listed with those it was asked for.
        if orders.nb != nb or {*orders.nf} != {nf} or orders.nk != delays:
            return None
        model = structure.fit(part, orders)
        return model if structure.admits(model) else None

    none = f"no order up to {MAX_ORDER} has real poles on these data: give --orders, or more data"
    split, delays = short.split(FITTED_SHARE), _delays(short)
    direct = list(_direct_grid(_direct_delays(short, delays[0])))
    delays = _with_neighbours(delays, data.least_delays)
    if not structure.rough:
        tried = dict.fromkeys([*(each for nk in delays for each in _grid(nk)), *direct])
        return rank(tried, fit, split, none, budget)
    known: dict[Tried, TransferModel | None] = {}

    def fit_once(tried: Tried, part: TrainingData) -> TransferModel | None:
        if part is not split.fitted:
            return fit(tried, part)
        if tried not in known:
            known[tried] = fit(tried, part)
        return known[tried]

    def level(tried: Tried) -> float:
        with contextlib.suppress(FitError):
            model = fit_once(tried, split.fitted)
            return np.inf if model is None else held_out_level(model, split)
        return np.inf

    return rank(_rising(delays, direct, level), fit_once, split, none, budget)


def _rising(
    delays: Sequence[tuple[int, ...]], direct: Sequence[Tried], level: Callable[[Tried], float]
) -> Iterator[Tried]:
    """Orders of many inputs, which take long: rising until they pay no more.

    Other delays than the first stand beside the best of these orders alone.

    Parameters
    ----------
    delays : sequence of tuple of int
    direct : sequence
        Orders with direct feedthrough.
    level : callable
        Of a candidate, by what is held out; the least is the best.
    """
    levels: dict[Tried, float] = {}
    for grid in (_grid(delays[0]), direct):
        best = np.inf
        for _, orders in itertools.groupby(grid, key=lambda tried: tried[1]):
            own = list(orders)
            yield from own
            levels |= {each: level(each) for each in own}
            least = min(levels[each] for each in own)
            if np.isfinite(best) and least >= best:
                break
            best = least
    plain = [each for each in levels if each[2] == delays[0]]
    best_orders = sorted(plain, key=lambda each: levels[each])[:BEST_ORDERS]
    yield from ((nb, nf, nk) for nk in delays[1:] for nb, nf, _ in best_orders)


def _with_neighbours(
    found: Sequence[tuple[int, ...]], least: tuple[int, ...]
) -> list[tuple[int, ...]]:
    """Delays, and one sample beside the best of them."""
    delays = [*found]
    for shift in (-1, 1):
        moved = tuple(max(k + shift, low) for k, low in zip(found[0], least, strict=True))
        if moved not in delays:
            delays.append(moved)
    return delays


def _grid(nk: tuple[int, ...]) -> Iterator[Tried]:
    """Orders at some delays."""
    for nf in range(1, MAX_ORDER + 1):
        for nb in range(1, nf + 1):
            yield (nb,) * len(nk), nf, nk


def _direct_grid(nk: tuple[int, ...]) -> Iterator[Tried]:
    """Orders with direct feedthrough of the inputs whose delay is 0: of those it takes one more."""
    for nf in range(1, MAX_ORDER + 1) if 0 in nk else ():
        for nb in range(1, nf + 2):
            yield tuple(min(nb, nf + (not delay)) for delay in nk), nf, nk


def _direct_delays(data: TrainingData, nk: tuple[int, ...]) -> tuple[int, ...]:
    """Delays with 0 for the inputs that act on the output of the same row, as far as it shows.

    The loss of a second-order model that has the same row of all inputs, without it for each.
    """
    orders = OeStructure().orders((4,) * len(nk), 2, (0,) * len(nk))
    problem = Problem(data.about_levels(orders.first), orders)
    if not problem.used:
        return nk
    found = search(problem)
    least = MIN_DIRECT_EVIDENCE * np.log(problem.rows) * found.loss / problem.rows
    delays = []
    for k, delay in enumerate(nk):
        nb, without = ([value] * len(nk) for value in (4, 0))
        nb[k], without[k] = 3, 1
        other = Problem(problem.data, OeStructure().orders(tuple(nb), 2, tuple(without)))
        seen = other.project(found.F, keep=False).loss - found.loss > least
        delays.append(0 if seen else delay)
    return tuple(delays)


def _delays(data: TrainingData) -> list[tuple[int, ...]]:
    """Delay of each input, the others held, until none changes.

    Then what else may be: the least delays, and for each input the best other minimum of the loss,
    for a delay can stand for poles that a second order has not.
    """
    longest, least = min(MAX_DELAY, max(4, data.longest // 8)), data.least_delays
    nk, others = least, list(least)
    for _ in range(DELAY_ROUNDS):
        before = nk
        for k, low in enumerate(least):
            losses = []
            orders = OeStructure().orders((3,) * len(nk), 2, nk)
            problem = Problem(data.about_levels(orders.first), orders)
            if not problem.used:
                raise FitError(
                    f"no run of inputs with more than {orders.shortest - orders.first} readings "
                    "behind the delays, which the choice of orders needs: give --orders"
                )
            F = search(problem).F
            for delay in range(low, longest + 1):
                tried = (*nk[:k], delay, *nk[k + 1 :])
                orders = OeStructure().orders((2,) * len(nk), 2, tried)
                candidate = Problem(data.about_levels(orders.first), orders)
                loss = candidate.project(F, keep=False).loss
                losses.append(loss / candidate.rows if candidate.rows else np.inf)
            minima = _minima(losses)
            others[k] = low + minima[min(1, len(minima) - 1)]
            nk = (*nk[:k], low + minima[0], *nk[k + 1 :])
        if nk == before:
            break
    beside = ((*nk[:k], other, *nk[k + 1 :]) for k, other in enumerate(others))
    return list(dict.fromkeys([nk, least, *beside]))


def _minima(losses: Sequence[float]) -> list[int]:
    """Places that neither neighbour undercuts, the least first."""
    values = np.concatenate([[np.inf], losses, [np.inf]])
    places = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:]))
    return sorted(places.tolist(), key=lambda k: losses[k])
