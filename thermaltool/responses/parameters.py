"""What holds for the parameters of every rational kind of response."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite
from typing import Any

import numpy as np

from thermaltool.errors import ModelError

# Rates of a fit stay so far apart, unless records are worse followed by this part: a chain of equal
# lags is met as well by unequal ones, to 3e-5 of its step, and their gains cancel less.
MIN_RATIO = 1.05


def check_parameters(response: Any, wanted: str) -> None:
    """Refuse searched parameters that are not above zero, a damping of 1 or more, infinite gains.

    Parameters
    ----------
    response : Response
    wanted : str
        What the searched ones have to be, for the message.

    Raises
    ------
    ModelError
    """
    searched = {name: getattr(response, name) for name in response.searched}
    positive = all(0 < value < inf for value in searched.values())
    if not positive or not searched.get("zeta", 0.5) < 1:
        raise ModelError(f"{response.kind} needs {wanted} ({searched})")
    gains = {name: getattr(response, name) for name in response.gains}
    if not all(map(isfinite, gains.values())):
        raise ModelError(f"{response.kind} needs finite gains ({gains})")


def nearness(rates: Sequence[float]) -> float:
    """How much nearer to each other rates are than `MIN_RATIO`, as a logarithm; 0 for apart.

    Parameters
    ----------
    rates : sequence of float
        Rates, or time constants.
    """
    apart = np.diff(np.sort(np.log(rates)))
    return float(np.sum(np.maximum(np.log(MIN_RATIO) - apart, 0.0)))
