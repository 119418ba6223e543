"""Orders and delays by what the model predicts of data that it has not seen.

Delays first: for each, the loss of a second-order model whose denominator stands; then every order
around them, around other delays that are nearly as good, and with direct feedthrough where the
input of the same row says something. Each candidate is fitted on the first
part of the record and judged by its free run over the rest; of nearly equal ones the criterion
takes that with fewer parameters. Errors that drift say less than as many that are white: they
count for fewer rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.search_budget import SearchBudget
from thermaltool.fitting.selection import (
    FITTED_SHARE,
    MAX_DELAY,
    MIN_DIRECT_EVIDENCE,
    Candidate,
    rank,
)
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.oe import OeStructure
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.search import MAX_COMPARED_ROWS, search
from thermaltool.fitting.transfer.structure import Structure

# Orders of the denominator that are tried.
MAX_ORDER = 4
# Times that the delay of every input is found anew, the others held.
DELAY_ROUNDS = 3

# Numerator coefficients of each input, order of the denominators, delays.
Tried = tuple[tuple[int, ...], int, tuple[int, ...]]


def choose(
    data: TrainingData, structure: Structure, budget: SearchBudget | None = None
) -> tuple[Candidate[TransferModel], ...]:
    """Orders nb, nf and delays nk of one structure, the best first.

    Parameters
    ----------
    data : TrainingData
    structure : Structure

    Raises
    ------
    FitError
        No candidate fits.
    """
    data.check()
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
    delays = _delays(short)
    direct = _direct_grid(_direct_delays(short, delays[0]))
    tried = dict.fromkeys([*_grid(delays, data.least_delays), *direct])
    return rank(tried, fit, short.split(FITTED_SHARE), none, budget)


def _grid(found: list[tuple[int, ...]], least: tuple[int, ...]) -> Iterator[Tried]:
    """Orders, at the delays found and one sample beside the best of them."""
    delays = [*found]
    for shift in (-1, 1):
        moved = tuple(max(k + shift, low) for k, low in zip(found[0], least, strict=True))
        if moved not in delays:
            delays.append(moved)
    for nk in delays:
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
