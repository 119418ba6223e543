"""Orders and delays by what the model predicts of data that it has not seen.

Delays first: for each, the loss of a second-order model whose denominator stands; then every order
around them, and around other delays that are nearly as good. Each candidate is fitted on the first
part of the record and judged by its free run over the rest; of nearly equal ones the criterion
takes that with fewer parameters. Errors that drift say less than as many that are white: they
count for fewer rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.transfer.colour import effective_share
from thermaltool.fitting.transfer.identify import Structure, identify, orders_of
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.output_error import Orders, Problem
from thermaltool.fitting.transfer.search import search
from thermaltool.signals.agreement import agreement
from thermaltool.signals.detrend import difference_sigma

# Share of each stretch on which candidates are fitted; the rest judges them.
FITTED = 0.6
# Candidates are compared on so many samples at most.
COMPARED = 20000
# A free state at the start has to lower the squared error by this factor, or twice the logarithm
# of the likelihood, of rows that count, by that much.
RESTING, CLEARLY = 1.25, 25.0
# A signal stands still while it moves by less than this share of its range, or than its noise in
# so many standard deviations; the output is compared over so many parts of at least so many rows.
STILL, NOISE, IDLE, LEAST = 0.01, 4.0, 5, 3
LARGEST_ORDER, LARGEST_DELAY = 4, 60

C = TypeVar("C")
M = TypeVar("M")


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
        return orders_of(structure, (self.nb,) * len(self.nk), self.nf, self.nk)


@dataclass(frozen=True)
class Choice:
    """The best candidate first."""

    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate:
        return self.candidates[0]


def choose(
    data: TrainingData,
    structure: Structure,
    nc: int = 1,
    nd: int = 1,
    real: bool = False,
) -> Choice:
    """Orders nb, nf and delays nk of one structure.

    Parameters
    ----------
    data : TrainingData
    structure : Structure
    nc, nd : int
        Orders of the noise.
    real : bool
        Only models whose poles are all real and positive.

    Raises
    ------
    FitError
        No candidate fits.
    """
    data.check()
    short = data if data.rows <= COMPARED else data.excerpt(COMPARED)
    fitted, held = short.split(FITTED)
    found: dict[tuple[int, int, tuple[int, ...]], TransferModel] = {}
    problem: FitError | None = None
    for nb, nf, delays in _grid(_delays(fitted), data.least_delays):
        try:
            orders = orders_of(structure, (nb,) * len(delays), nf, delays)
            model = identify(fitted, structure, orders, nc, nd, real)
        except FitError as error:
            problem = problem or error
            continue
        if real and structure != "oe" and not real_poles(model):
            continue
        found[nb, nf, delays] = model
    candidates = _ranked(found, fitted, held)
    if not candidates:
        raise problem or FitError(
            "no order up to 4 has real poles on these data: give --orders, or more data"
        )
    return Choice(candidates)


def first_that_fits(candidates: Iterable[C], fit: Callable[[C], M]) -> M:
    """The model of the first of `candidates`, the best first, that fits the whole training data.

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


def started(data: TrainingData) -> TrainingData:
    """The data from rest, unless a free state at the start describes them clearly better.

    Free responses can stand for slow modes: with one step in the record gain, offset, modes and
    state are confounded, and a free state is preferred for the smallest error of the model. A
    record that begins within a transient gains far more by it, or its errors become white. Records
    whose signals all stand
    still at first are at rest whatever the losses say: a delay alone can make a free state better.
    """
    data.check()
    if brief(data):
        return data
    if standing(data):
        return data.from_rest()
    least = data.least_delays
    orders = orders_of("oe", (2,) * len(least), 2, least)
    losses = []
    for each in (data.from_rest(), data):
        problem = Problem(each.about_levels(orders.first), orders)
        if problem.rows <= problem.linear_count + sum(orders.nf):
            return data
        found = search(problem)
        losses.append(found.loss / problem.rows)
    errors = [error for error, _ in problem.errors(problem.project(found.F))]
    return data if in_transient(losses[0], losses[1], errors) else data.from_rest()


def in_transient(rest: float, free: float, errors: Sequence[Array]) -> bool:
    """Whether a free state describes the start clearly better.

    Parameters
    ----------
    rest, free : float [unit²]
        Mean square of the errors from rest and from a free state.
    errors : sequence of ndarray
        Those of the free state, run by run.
    """
    ratio = rest / max(free, 1e-300)
    rows = effective_share(errors) * sum(map(len, errors))
    return ratio > RESTING or rows * float(np.log(max(ratio, 1.0))) > CLEARLY


def brief(data: TrainingData) -> bool:
    """Whether some experiment begins with a record too short to tell rest from a transient."""
    return any(len(data.records[k]) < IDLE * LEAST for k in data.begins.values())


def standing(data: TrainingData) -> bool:
    """Whether every experiment begins idle: inputs and output stand still, within their noise."""
    return all(_stands(data.u[k], data.y[k][0]) for k in data.begins.values())


def _stands(inputs: Array, output: Array) -> bool:
    moved = np.abs(inputs - inputs[:, :1]) > [[_blur(u)] for u in inputs]
    rows = int(np.argmax(moved.any(axis=0))) if moved.any() else inputs.shape[1]
    if rows < IDLE * LEAST:
        return False
    parts = [float(part.mean()) for part in np.array_split(output[:rows], IDLE)]
    return float(np.ptp(parts)) <= _blur(output, rows // IDLE)


def _blur(signal: Array, averaged: int = 1) -> float:
    """What two means of so many readings may differ where the signal stands still."""
    chance = NOISE * np.sqrt(2.0 / averaged) * difference_sigma(signal)
    return max(STILL * float(np.ptp(signal)), float(chance))


def real_poles(model: TransferModel) -> bool:
    """Whether every pole is real and positive: an overdamped system."""
    poles = [np.roots(f) for f in model.F if len(f) > 1]
    return all(bool(np.all((p.imag == 0) & (p.real > 0))) for p in poles)


def _ranked(
    found: Mapping[tuple[int, int, tuple[int, ...]], TransferModel],
    fitted: TrainingData,
    held: TrainingData,
) -> tuple[Candidate, ...]:
    """By their free run over what was not fitted, the best first."""
    y = held.output()
    computed = {key: model.run(held) for key, model in found.items()}
    squares = {key: float(np.nanmean((y - run) ** 2)) for key, run in computed.items()}
    squares = {key: square for key, square in squares.items() if np.isfinite(square)}
    if not squares:
        return ()
    best = y - computed[min(squares, key=lambda key: squares[key])]
    ends = np.cumsum([len(record) for record in held.records])[:-1]
    runs = [e[np.isfinite(e)] for e in np.split(best, ends)]
    rows = max(effective_share(runs) * held.rows, 2.0)
    variance = float(np.var(fitted.output()))
    ranked = []
    for (nb, nf, nk), square in squares.items():
        model = found[nb, nf, nk]
        score = np.log(max(square, 1e-300)) + model.parameters * np.log(rows) / rows
        ranked.append(Candidate(
            nb, nf, nk, agreement(y, computed[nb, nf, nk]).fit_percent,
            model.criteria.aic, model.criteria.bic, model.yic(variance), float(score),
        ))  # fmt: skip
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
        for nf in range(1, LARGEST_ORDER + 1):
            for nb in range(1, nf + 1):
                yield nb, nf, nk


def _delays(data: TrainingData) -> list[tuple[int, ...]]:
    """Delay of each input, the others held, until none changes.

    Then what else may be: the least delays, and for each input the best other minimum of the loss,
    for a delay can stand for poles that a second order has not.
    """
    most, least = min(LARGEST_DELAY, max(4, data.longest // 8)), data.least_delays
    nk, others = least, list(least)
    for _ in range(3):
        before = nk
        for k, low in enumerate(least):
            losses = []
            orders = orders_of("oe", (3,) * len(nk), 2, nk)
            problem = Problem(data.about_levels(orders.first), orders)
            F = search(problem).F
            for delay in range(low, most + 1):
                tried = (*nk[:k], delay, *nk[k + 1 :])
                orders = orders_of("oe", (2,) * len(nk), 2, tried)
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
