"""What a stream reads of its design on what is uncertain of its model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from thermaltool.documents import Part, finite, items


def stream_bands(
    design: Mapping[str, Any], estimates: int
) -> tuple[list[float], list[float], list[float]]:
    """Standard errors that the parameters make, as shares of an estimate; what the model leaves.

    The last is over the sensors' signals; empty in a design without them.

    Parameters
    ----------
    design : mapping
    estimates : int
        How many there are.

    Raises
    ------
    ModelError
        Not what `design_bands` gives.
    """
    kept = Part(design["bands"], "design.bands")
    relative, error = (
        [finite(value) for value in kept.read(name, items)] for name in ("relative", "model_error")
    )
    gains = [finite(value) for value in kept.read("gain_error", items, [])]
    kept.as_whole(lambda whole: _same_length(estimates, relative))
    return relative, error, gains


def _same_length(count: int, relative: list[float]) -> None:
    if len(relative) != count:
        raise ValueError("standard errors and estimates do not go together")
