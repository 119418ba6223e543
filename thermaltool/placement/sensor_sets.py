"""Sensors that were chosen, a set for each number of them, and what is said beside."""

from __future__ import annotations

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

    def gain(self, k: int) -> float | None:
        """Part by which the error falls from the k-th set to the next; None for the last.

        Parameters
        ----------
        k : int
            From 1 on.
        """
        if not 0 < k < len(self.sets):
            return None
        return 1 - self.sets[k].mean_error / self.sets[k - 1].mean_error
