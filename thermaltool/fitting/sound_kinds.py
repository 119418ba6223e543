"""Which fitted kinds of response may be an answer, and what each is worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from thermaltool.fitting.projection import MAX_CANCELLATION
from thermaltool.fitting.response_search import FittedKinds

# A kind whose terms cancel is no answer, unless nothing else comes within so many times its error.
CANCELLING_LOSS = 2.0
# A time constant of so many of the longest record is a trend, and its gain a guess; without it the
# error may be so many times larger.
MAX_SLOWEST, SLOW_LOSS = 2.0, 1.25


def criterion(found: FittedKinds, rows: float) -> float:
    """The Bayesian information criterion of so many independent rows, to a constant.

    Parameters
    ----------
    found : FittedKinds
    rows : float
    """
    floor = np.finfo(float).eps
    return rows * float(np.log(max(found.size, floor))) + found.parameters * float(np.log(rows))


def best_of(found: Sequence[FittedKinds], rows: float) -> FittedKinds:
    """The one of most evidence among the sound ones.

    Parameters
    ----------
    found : sequence of FittedKinds
    rows : float
    """
    return min(sound_ones(found), key=lambda each: criterion(each, rows))


def sound_ones(found: Sequence[FittedKinds]) -> list[FittedKinds]:
    """Those that may be an answer: possible ones, of lags that show, whose terms do not cancel.

    Parameters
    ----------
    found : sequence of FittedKinds
    """
    steady = _unless_far(found, lambda each: each.cancellation <= MAX_CANCELLATION, CANCELLING_LOSS)
    seen = _unless_far(steady, lambda each: each.slowest <= MAX_SLOWEST, SLOW_LOSS)
    return _unless_far(seen, lambda each: not each.impossible, CANCELLING_LOSS)


def _unless_far(
    found: Sequence[FittedKinds], allowed: Callable[[FittedKinds], bool], loss: float
) -> list[FittedKinds]:
    """Those that are allowed; all, where none of them comes near the least error."""
    kept = [each for each in found if allowed(each)]
    least = min(each.size for each in found)
    near = kept and min(each.size for each in kept) <= loss**2 * least
    return kept if near else list(found)


def unsound(each: FittedKinds) -> str:
    """Why a candidate is no answer, however close it comes; empty where it is one.

    Parameters
    ----------
    each : FittedKinds
    """
    if each.impossible:
        return each.impossible
    if each.cancellation > MAX_CANCELLATION:
        return f"terms of {each.cancellation:.3g} times the output cancel"
    if each.slowest > MAX_SLOWEST:
        return f"a time constant of {each.slowest:.3g} times the record"
    return ""
