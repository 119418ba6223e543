"""Which fitted kinds of response may be an answer, and what each is worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from thermaltool.fitting.possible import CANCELLING_LOSS, MAX_SLOWEST
from thermaltool.fitting.projection import MAX_CANCELLATION
from thermaltool.fitting.response_search import FittedKinds

# Fall of the criterion that counts: odds of 150 to 1.
DECISIVE = 10.0
# Without a lag that is a trend the error may be so many times larger.
SLOW_LOSS = 1.25


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


def without_delays(found: Sequence[FittedKinds]) -> list[FittedKinds]:
    """Those in which no drive is delayed.

    Parameters
    ----------
    found : sequence of FittedKinds
    """
    return [each for each in found if not any(each.delays)]


def sound_ones(found: Sequence[FittedKinds]) -> list[FittedKinds]:
    """Those that may be an answer: possible ones, of lags that show, whose terms do not cancel.

    Parameters
    ----------
    found : sequence of FittedKinds
    """
    steady = _unless_far(
        found, lambda each: each.soundness.cancellation <= MAX_CANCELLATION, CANCELLING_LOSS
    )
    seen = _unless_far(steady, lambda each: each.soundness.slowest <= MAX_SLOWEST, SLOW_LOSS)
    return _unless_far(seen, lambda each: not each.soundness.impossible, CANCELLING_LOSS)


def _unless_far(
    found: Sequence[FittedKinds], allowed: Callable[[FittedKinds], bool], loss: float
) -> list[FittedKinds]:
    """Those that are allowed; all, where none of them comes near the least error."""
    kept = [each for each in found if allowed(each)]
    least = min(each.size for each in found)
    near = kept and min(each.size for each in kept) <= loss**2 * least
    return kept if near else list(found)
