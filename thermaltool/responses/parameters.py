"""What holds for the parameters of every rational kind of response."""

from __future__ import annotations

from math import inf, isfinite
from typing import Any

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
