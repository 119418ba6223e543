"""Orders and delays by what the model predicts of data that it has not seen.

Delays first: for each, the loss of a second-order model whose denominator stands; then every order
around them, and around other delays that are nearly as good. Each candidate is fitted on the first
part of the record and judged by its free run over the rest; of nearly equal ones the criterion
takes that with fewer parameters. Errors that drift say less than as many that are white: they
count for fewer rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.selection import FITTED_SHARE, MAX_DELAY, held_out_scores
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.oe import OeStructure
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.search import search
from thermaltool.fitting.transfer.structure import Structure
from thermaltool.signals.agreement import agreement

# Candidates are compared on so many samples at most.
MAX_COMPARED_ROWS = 20000
# Orders of the denominator that are tried.
MAX_ORDER = 4
# Times that the delay of every input is found anew, the others held.
DELAY_ROUNDS = 3


@dataclass(frozen=True)
class Candidate:
    """One choice of orders.

    Attributes
    ----------
    nb, nf : int
    nk : tuple of int
    fit_percent : float
        Free run over the part that was not fitted.
    aic, bic, yic : float
        On the part that was fitted.
    score : float
        ln of the held-out error variance, with ln(N)/N for each parameter; N are the rows that
        count, fewer where errors are coloured.
    """

    nb: int
    nf: int
    nk: tuple[int, ...]
    fit_percent: float
    aic: float
    bic: float
    yic: float
    score: float

    def orders(self, structure: Structure) -> Orders:
        return structure.orders((self.nb,) * len(self.nk), self.nf, self.nk)


@dataclass(frozen=True)
class Choice:
    """The best candidate first."""

    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate:
        return self.candidates[0]


def choose(data: TrainingData, structure: Structure) -> Choice:
    """Orders nb, nf and delays nk of one structure.

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
    fitted, held = short.split(FITTED_SHARE)
    found: dict[tuple[int, int, tuple[int, ...]], TransferModel] = {}
    problem: FitError | None = None
    for nb, nf, delays in _grid(_delays(fitted), data.least_delays):
        try:
            orders = structure.orders((nb,) * len(delays), nf, delays)
            # A structure that has fewer orders to give is not listed with those it was asked for.
            if {*orders.nb} != {nb} or {*orders.nf} != {nf} or orders.nk != delays:
                continue
            model = structure.fit(fitted, orders)
        except FitError as error:
            problem = problem or error
            continue
        if structure.admits(model):
            found[nb, nf, delays] = model
    candidates = _ranked(found, fitted, held)
    if not candidates:
        raise problem or FitError(
            f"no order up to {MAX_ORDER} has real poles on these data: give --orders, or more data"
        )
    return Choice(candidates)


def _ranked(
    found: Mapping[tuple[int, int, tuple[int, ...]], TransferModel],
    fitted: TrainingData,
    held: TrainingData,
) -> tuple[Candidate, ...]:
    """By their free run over what was not fitted, the best first."""
    y, runs = held.output(), {key: model.run(held) for key, model in found.items()}
    runs = {key: run for key, run in runs.items() if np.isfinite(np.nanmean((y - run) ** 2))}
    if not runs:
        return ()
    models = [found[key] for key in runs]
    scores = held_out_scores(held, [run[None] for run in runs.values()],
                             [model.parameters for model in models])  # fmt: skip
    variance = float(np.var(fitted.output()))
    ranked = [
        Candidate(
            *key, agreement(y, run).fit_percent,
            model.criteria.aic, model.criteria.bic, model.yic(variance), score,
        )
        for (key, run), model, score in zip(runs.items(), models, scores, strict=True)
    ]  # fmt: skip
    return tuple(sorted(ranked, key=lambda c: c.score))


def _grid(
    found: list[tuple[int, ...]], least: tuple[int, ...]
) -> Iterator[tuple[int, int, tuple[int, ...]]]:
    """Orders, at the delays found and one sample beside the best of them."""
    delays = [*found]
    for shift in (-1, 1):
        moved = tuple(max(k + shift, low) for k, low in zip(found[0], least, strict=True))
        if moved not in delays:
            delays.append(moved)
    for nk in delays:
        for nf in range(1, MAX_ORDER + 1):
            for nb in range(1, nf + 1):
                yield nb, nf, nk


def _delays(data: TrainingData) -> list[tuple[int, ...]]:
    """Delay of each input, the others held, until none changes.

    Then what else may be: the least delays, and for each input the best other minimum of the loss,
    for a delay can stand for poles that a second order has not.
    """
    most, least = min(MAX_DELAY, max(4, data.longest // 8)), data.least_delays
    nk, others = least, list(least)
    for _ in range(DELAY_ROUNDS):
        before = nk
        for k, low in enumerate(least):
            losses = []
            orders = OeStructure().orders((3,) * len(nk), 2, nk)
            problem = Problem(data.about_levels(orders.first), orders)
            F = search(problem).F
            for delay in range(low, most + 1):
                tried = (*nk[:k], delay, *nk[k + 1 :])
                orders = OeStructure().orders((2,) * len(nk), 2, tried)
                candidate = Problem(data.about_levels(orders.first), orders)
                losses.append(candidate.project(F, keep=False).loss / max(candidate.rows, 1))
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
