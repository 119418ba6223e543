"""Sums of lags whose weights undo one another: more of them than the data carry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermaltool.fitting.data import Array
from thermaltool.responses import Response

# The data carry fewer real poles where a lag's weight is so many times the largest step.
MAX_LAG_WEIGHT = 100.0


def are_cancelling(responses: Sequence[Response], moves: Sequence[float] = (1.0,)) -> bool:
    """Whether a weight of sums of lags is far above all that their step responses reach.

    Parameters
    ----------
    responses : sequence of Response
        Of one output, of real poles.
    moves : sequence of float
        How far the input of each moves.
    """
    largest = steps = 0.0
    for response, move in zip(responses, moves, strict=True):
        rates = response.modes(1.0).poles
        ends = np.log([0.1 / np.max(abs(rates)), 10.0 / np.min(abs(rates))])
        time: Array = np.exp(np.linspace(ends[0], ends[1], 200))
        steps = max(steps, move * float(np.max(np.abs(response.step(time)))))
        weights = (abs(float(getattr(response, name))) for name in response.gains)
        largest = max(largest, move * max(weights))
    return largest > MAX_LAG_WEIGHT * steps
