"""Dead times of the drives, behind sums of lags."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from thermaltool.fitting.response_search import FEW_STARTS, FittedKinds, KindSearch
from thermaltool.fitting.sound_kinds import DECISIVE, best_of, criterion

# Delays that are tried: these many samples, up to this share of the longest record; then so many
# more between the neighbours of the best.
DELAY_SAMPLES, MAX_DELAY_SHARE, DELAY_STEPS = (0.5, 1, 2, 4, 8, 16, 32, 64), 0.05, 8
# Longer delays are not tried behind one that leaves so many times the squared error of the best.
GIVE_UP = 2.0
# A lag faster than so many sample periods may stand in for a delay.
STAND_IN = 4.0


def delayed_kinds(task: KindSearch, plain: Sequence[FittedKinds], rows: float) -> list[FittedKinds]:
    """Kinds, each with its own delay of the drives for which there is evidence.

    The delay of most evidence is taken first: others may only have stood in for it. Of kinds whose
    fastest lag may itself stand in for a delay simpler ones are tried, too.

    Parameters
    ----------
    task : KindSearch
    plain : sequence of FittedKinds
        Sums of lags without delays.
    rows : float
        Independent ones.
    """
    longest = MAX_DELAY_SHARE * task.duration
    tried = [k * task.period for k in DELAY_SAMPLES if k * task.period <= longest]
    if not plain or not tried:
        return []
    best = best_of(plain, rows)
    fits = _behind(task, best, plain, tried, rows)
    if not fits and float(np.exp(best.theta.min())) < STAND_IN * task.period:
        fewer = [each for each in plain if len(each.theta) < len(best.theta)]
        # Sound or not: what is wrong with them may be the delay that they lack.
        near = min(fewer, key=lambda each: criterion(each, rows), default=None)
        fits = [] if near is None else _behind(task, near, fewer, tried, rows)
    return fits


def _behind(
    task: KindSearch,
    best: FittedKinds,
    plain: Sequence[FittedKinds],
    tried: Sequence[float],
    rows: float,
) -> list[FittedKinds]:
    """All kinds with delays of those drives for which the best of them has evidence."""
    brackets: dict[int, tuple[float, float]] = {}
    while len(brackets) < len(best.kinds):
        left = [d for d in range(len(best.kinds)) if d not in brackets]
        found = [(_bracket(task, best, d, tried, rows), d) for d in left]
        evidence, *bracket, d = max((*each, d) for each, d in found)
        if evidence < DECISIVE + np.log(rows):
            break
        brackets[d] = (bracket[0], bracket[1])
        best = _placed(task, best, d, brackets[d])
    fits = []
    for each in plain if brackets else []:
        for d, own in brackets.items():
            each = _placed(task, each, d, own)
        fits.append(each)
    return [each for each in fits if any(each.delays)]


def _placed(
    task: KindSearch, each: FittedKinds, d: int, bracket: tuple[float, float]
) -> FittedKinds:
    """Kinds with the best delay of one drive in a bracket; as they are where there is none."""
    delay = _golden(partial(_size_of, task, each, d), *bracket, DELAY_STEPS)
    return task.fit(each.kinds, _with_delay(each, d, delay), common=each.common) or each


def _with_delay(each: FittedKinds, d: int, delay: float) -> tuple[float, ...]:
    return (*each.delays[:d], delay, *each.delays[d + 1 :])


def _size_of(task: KindSearch, base: FittedKinds, d: int, delay: float) -> float:
    """Sum of squares with another delay of one drive: each delay has rates of its own."""
    found = task.fit(
        base.kinds, _with_delay(base, d, delay), refined=FEW_STARTS, common=base.common
    )
    return base.size if found is None else found.size


def _bracket(
    task: KindSearch, base: FittedKinds, d: int, tried: Sequence[float], rows: float
) -> tuple[float, float, float]:
    """Evidence for a delay of a drive, and between which two it lies."""
    sizes: list[float] = []
    for delay in tried:
        sizes.append(task.size(base.kinds, _with_delay(base, d, delay), base.theta, base.common))
        if sizes[-1] > GIVE_UP * min(*sizes, base.size):
            break
    fall = float(np.log(base.size / max(min(sizes), np.finfo(float).tiny)))
    k = int(np.argmin(sizes))
    return rows * fall, tried[k - 1] if k else 0.0, tried[min(k + 1, len(tried) - 1)]


def _golden(size: Callable[[float], float], low: float, high: float, steps: int) -> float:
    """Place of a minimum between two places, by golden section."""
    ratio = (np.sqrt(5.0) - 1) / 2
    a, b = high - ratio * (high - low), low + ratio * (high - low)
    at_a, at_b = size(a), size(b)
    for _ in range(steps):
        if at_a <= at_b:
            high, b, at_b = b, a, at_a
            a = high - ratio * (high - low)
            at_a = size(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + ratio * (high - low)
            at_b = size(b)
    return float(a if at_a <= at_b else b)
