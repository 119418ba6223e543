"""What a stream reads of its design on the standard errors of its estimates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from thermaltool.documents import Part, finite, items


def stream_bands(
    design: Mapping[str, Any], estimates: int
) -> tuple[list[float], list[float], list[float], list[float]]:
    """Steady standard errors, those of the parameters as shares, and what the model leaves.

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
    sigma, relative, error = (
        [finite(value) for value in kept.read(name, items)]
        for name in ("sigma", "relative", "model_error")
    )
    gains = [finite(value) for value in kept.read("gain_error", items, [])]
    kept.as_whole(lambda whole: _same_length(estimates, sigma, relative))
    return sigma, relative, error, gains


def _same_length(count: int, *lists: list[float]) -> None:
    if any(len(each) != count for each in lists):
        raise ValueError("standard errors and estimates do not go together")
