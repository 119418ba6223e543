"""Which share of a drive a term takes: transfer functions by level, switched without a bump.

Every level of a schedule has its own response. A response takes the drive times the share of its
level, 1 there and falling straight to 0 at its neighbours, so that the shares add up to one. The
shares act in front of the responses: what a response has stored goes on decaying in its own way
when the level changes, and no output jumps. (Mareš et al., section 3.2, switch six inverse transfer
functions by bounds on the angle.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.documents import finite, is_place
from thermaltool.effects.effect import Float
from thermaltool.errors import ModelError


@dataclass(frozen=True)
class ScheduleBand:
    """The place of a term in its schedule.

    Attributes
    ----------
    channel : str
        What chooses: a drive of the model (relative to its reference), or another channel.
    levels : tuple of float [unit of the channel]
        All levels of the schedule, rising; sizes, without sign, unless one is below zero.
    index : int
        The level of this term.
    """

    channel: str
    levels: tuple[float, ...]
    index: int

    def __post_init__(self) -> None:
        levels = np.array(self.levels, float)
        if not np.all(np.isfinite(levels)) or np.any(np.diff(levels) <= 0):
            raise ModelError("the levels of a schedule rise")
        if not is_place(self.index, len(levels)):
            raise ModelError(f"a schedule of {len(levels)} levels has no number {self.index}")

    def share(self, values: Float) -> Float:
        """Share of the drive at each value of the channel; beyond the ends that of the end."""
        own = np.zeros(len(self.levels))
        own[self.index] = 1.0
        at = np.asarray(values) if self.levels[0] < 0 else np.abs(values)
        return np.asarray(np.interp(at, self.levels, own))

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {"channel": self.channel, "levels": list(self.levels), "index": self.index}


def load_band(document: Mapping[str, Any] | None) -> ScheduleBand | None:
    """A band from a model file; None where the term has none.

    Parameters
    ----------
    document : mapping

    Raises
    ------
    ModelError
        Levels that do not rise, or a number that is none of them.
    """
    if document is None:
        return None
    levels = tuple(finite(level) for level in document["levels"])
    return ScheduleBand(str(document["channel"]), levels, int(finite(document["index"])))
