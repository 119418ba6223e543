"""Sums of lags whose weights undo one another: more of them than the data carry."""

from __future__ import annotations

import numpy as np

from thermaltool.fitting.data import Array
from thermaltool.responses import Response

# The data carry fewer real poles where a lag's weight is so many times the largest step.
MAX_LAG_WEIGHT = 100.0


def are_cancelling(response: Response) -> bool:
    """Whether a weight of a sum of lags is far above all that its step response reaches.

    Parameters
    ----------
    response : Response
        Of real poles.
    """
    rates = response.modes(1.0).poles
    ends = np.log([0.1 / np.max(abs(rates)), 10.0 / np.min(abs(rates))])
    time: Array = np.exp(np.linspace(ends[0], ends[1], 200))
    size = float(np.max(np.abs(response.step(time))))
    largest = max(abs(float(getattr(response, name))) for name in response.gains)
    return largest > MAX_LAG_WEIGHT * size
