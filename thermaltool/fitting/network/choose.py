"""How many modes, which delays, and whether a record begins at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.network.identify import MAX_MODES, identify_network
from thermaltool.fitting.network.model import Network
from thermaltool.fitting.network.problem import Delays, NetworkProblem
from thermaltool.fitting.network.search import MAX_START_ROWS, NetworkSearchResult, search
from thermaltool.fitting.search_budget import SearchBudget
from thermaltool.fitting.selection import (
    FITTED_SHARE,
    MAX_DELAY,
    MIN_DIRECT_EVIDENCE,
    Candidate,
    rank,
)
from thermaltool.fitting.start_state import StartErrors

# Delays and time constants are found in turn at most so often.
MAX_DELAY_ROUNDS = 5
# Modes beside which delays and the start are chosen, at most.
MAX_TRIED_MODES = 3


def choose_modes(
    data: TrainingData, delays: Delays, budget: SearchBudget | None = None
) -> tuple[Candidate[Network], ...]:
    """Numbers of modes by what they predict of rows that were not fitted, the best first.

    With direct feedthrough, too, where the inputs of the same row say something beside the modes
    of the largest network.

    Parameters
    ----------
    data : TrainingData
    delays : tuple of tuple of float, for each output one for each input [s]

    Raises
    ------
    FitError
        No candidate fits.
    """
    data.check()
    split, modes = data.split(FITTED_SHARE), range(1, MAX_MODES + 1)
    fitted: list[Network] = []

    def candidates() -> Iterator[tuple[int, bool]]:
        yield from ((n, False) for n in modes)
        if fitted and _acts_at_once(split.fitted, fitted[-1], delays):
            yield from ((n, True) for n in modes)

    def fit(tried: tuple[int, bool], part: TrainingData) -> Network:
        found = identify_network(part, tried[0], delays, tried[1])
        if part is split.fitted:
            fitted.append(found)
        return found

    return rank(candidates(), fit, split, "no number of modes fits these data", budget)


def _acts_at_once(data: TrainingData, network: Network, delays: Delays) -> bool:
    """Whether feedthrough lowers the error of an output by more than its inputs do by chance."""
    if np.any(delays) or not data.may_act_at_once:
        return False
    stride = max(1, data.rows // MAX_START_ROWS)
    plain = NetworkProblem(data, delays, stride)
    before, after = (
        problem.mean_square(network.time_constants)
        for problem in (plain, replace(plain, direct=True))
    )
    for k, (own, other) in enumerate(zip(before, after, strict=True)):
        rows = plain.rows(k)
        gained = rows * np.log(max(own, 1e-300) / max(other, 1e-300))
        if gained > MIN_DIRECT_EVIDENCE * len(data.inputs) * np.log(rows):
            return True
    return False


def choose_delays(data: TrainingData) -> Delays:
    """Dead time of every output behind every input, in whole sample periods.

    By the loss of modes whose time constants stand, the other delays held, until none changes;
    then all together by a period, with the time constants searched again.

    Parameters
    ----------
    data : TrainingData

    Returns
    -------
    tuple of tuple of float, for each output one for each input [s]

    Raises
    ------
    FitError
        No mode fits.
    """
    data.check()
    stride = max(1, data.rows // MAX_START_ROWS)
    tried = (data.period * np.arange(1 + min(MAX_DELAY, max(4, data.longest // 8)))).tolist()
    delays: Delays = tuple((0.0,) * len(data.inputs) for _ in data.outputs)
    score, best = _least_bic(NetworkProblem(data, delays, stride))
    for _ in range(MAX_DELAY_ROUNDS):
        before = delays
        delays = tuple(
            _own_delays(NetworkProblem(data.only(k), (own,), stride), best.time_constants, tried)
            for k, own in enumerate(delays)
        )
        if delays != before:
            score, best = _least_bic(NetworkProblem(data, delays, stride))
        moved = [_shifted(delays, step) for step in (-data.period, data.period)]
        for other in moved:
            other_score, found = _least_bic(NetworkProblem(data, other, stride))
            if other_score < score:
                delays, score, best = other, other_score, found
        if delays == before:
            break
    return delays


def _own_delays(problem: NetworkProblem, taus: Array, tried: list[float]) -> tuple[float, ...]:
    """Of one output, input by input."""
    own = list(problem.delays[0])
    for i in range(len(own)):
        losses = []
        for delay in tried:
            own[i] = delay
            losses.append(replace(problem, delays=(tuple(own),)).mean_square(taus)[0])
        own[i] = tried[int(np.argmin(losses))]
    return tuple(own)


def _shifted(delays: Delays, step: float) -> Delays:
    return tuple(tuple(max(delay + step, 0.0) for delay in own) for own in delays)


def _least_bic(problem: NetworkProblem) -> tuple[float, NetworkSearchResult]:
    """Of one to three modes those of least BIC: a delay stands for modes that are missing."""
    found = []
    outputs, inputs = len(problem.delays), len(problem.data.inputs)
    rows = sum(problem.rows(k) for k in range(outputs))
    for modes in range(1, MAX_TRIED_MODES + 1):
        try:
            each = search(problem, modes)
        except FitError:
            break
        found.append((2 * each.criterion + modes * (1 + outputs * inputs) * np.log(rows), each))
    if not found:
        raise FitError("no mode fits these data")
    return min(found, key=lambda pair: pair[0])


def undelayed_errors(data: TrainingData) -> StartErrors | None:
    """Errors of one to three modes without dead time; None where there are too few rows."""
    none: Delays = tuple((0.0,) * len(data.inputs) for _ in data.outputs)
    problem, outputs = NetworkProblem(data, none), range(len(data.outputs))
    if min(map(problem.rows, outputs)) <= problem.linear_count(MAX_TRIED_MODES) + MAX_TRIED_MODES:
        return None
    found = _least_bic(problem)[1]

    def records() -> list[list[Array]]:
        errors = list(problem.errors(found.time_constants, found.projected))
        return [[e for o, _, e in errors if o == k] for k in outputs]

    return StartErrors([f.loss / f.rows for f in found.projected], records)
