"""Sensors that were chosen, a set for each number of them, and what is said beside."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.placement.collinearity import Collinearity


@dataclass(frozen=True)
class SensorSet:
    """Sensors that were chosen, one set for each number.

    Attributes
    ----------
    sensors : tuple of str
    errors : tuple of float, one for each output [unit of the output]
        Root mean square of what is missed.
    time_constants : tuple of float [s]
        Of low-pass states beside each sensor.
    efficiency : float or None
        Least ratio of the smallest error that any such set may have to this one; None: not known.
    """

    sensors: tuple[str, ...]
    errors: tuple[float, ...]
    time_constants: tuple[float, ...] = ()
    efficiency: float | None = None

    @property
    def mean_error(self) -> float:
        """Geometric mean over the outputs."""
        return float(np.exp(np.mean(np.log(self.errors))))


@dataclass(frozen=True)
class PlacedSensors:
    """Sets of sensors, and of what they were chosen.

    Attributes
    ----------
    outputs, candidates : tuple of str
    criterion : {"held-out", "I", "A", "D"}
    sets : tuple of SensorSet
        For 1, 2, 3 … sensors.
    collinearity : Collinearity
        Of the candidates.
    """

    outputs: tuple[str, ...]
    candidates: tuple[str, ...]
    criterion: str
    sets: tuple[SensorSet, ...]
    collinearity: Collinearity


def gains_of_the_next(sets: Sequence[SensorSet]) -> list[float | None]:
    """Part by which the error falls from each set to the next; None for the last.

    Parameters
    ----------
    sets : sequence of SensorSet
    """
    found: list[float | None] = [
        1 - after.mean_error / before.mean_error for before, after in itertools.pairwise(sets)
    ]
    return [*found, None]
