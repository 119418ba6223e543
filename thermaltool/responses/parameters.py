"""What holds for the parameters of every rational kind of response."""

from __future__ import annotations

from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import ModelError


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


def step_of(response: Any, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit-step response as the sum of what each gain adds, no delay; shape as `t`.

    Parameters
    ----------
    response : Response
        Of a kind with `unit_steps`.
    t : ndarray, any shape [s]
        Zero or later.
    """
    steps, _ = response.unit_steps(
        t.ravel(), **{n: getattr(response, n) for n in response.searched}
    )
    gains = np.array([getattr(response, name) for name in response.gains])
    return np.asarray((steps @ gains).reshape(t.shape))
