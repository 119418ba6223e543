"""Candidates for sensors: what each reads over duty cycles, its noise, its cost.

The states of a duty cycle have unit variance and no correlation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array


@dataclass(frozen=True)
class DutyCycle:
    """What candidates read and how the machine bends over one duty cycle.

    Attributes
    ----------
    readings : ndarray, shape (N, r) [unit of each candidate]
        Of every candidate, for each state at its standard deviation.
    deflections : ndarray, shape (p, r) [unit of each deflection]
    """

    readings: Array
    deflections: Array


@dataclass(frozen=True)
class Candidates:
    """Places among which sensors are chosen.

    Attributes
    ----------
    cycles : tuple of DutyCycle
        The criterion is its mean over them.
    noise : ndarray, shape (N,) [unit of each candidate]
        Standard deviation of a reading.
    costs : ndarray, shape (N,)
        Of a sensor there; 1 by default.
    allowed : ndarray of bool, shape (N,)
    """

    cycles: tuple[DutyCycle, ...]
    noise: Array
    costs: Array
    allowed: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        cycles: Sequence[DutyCycle],
        noise: float | Array,
        costs: float | Array = 1.0,
        forbidden: Sequence[int] = (),
    ) -> Candidates:
        """Candidates whose noise and costs are numbers or one for each.

        Raises
        ------
        FitError
            No candidate, noise or costs that are not above zero.
        """
        n = len(cycles[0].readings)
        known, price = (np.broadcast_to(np.asarray(v, float), (n,)) for v in (noise, costs))
        if not np.all(known > 0) or not np.all(price > 0):
            raise FitError("noise and costs of sensors are above zero")
        allowed = np.ones(n, bool)
        allowed[list(forbidden)] = False
        if not allowed.any():
            raise FitError("no candidate is left: all are forbidden")
        return cls(tuple(cycles), known, price, allowed)

    def scaled(self, cycle: DutyCycle) -> Array:
        """Readings over their noise, shape (N, r)."""
        return np.asarray(cycle.readings / self.noise[:, None])


def deflection_errors(candidates: Candidates, sensors: Sequence[int]) -> Array:
    """Root mean square of what sensors leave unknown of all deflections, in each duty cycle.

    Parameters
    ----------
    candidates : Candidates
    sensors : sequence of int

    Returns
    -------
    ndarray, shape (cycles,) [unit of the deflections]
    """
    return np.sqrt(np.mean(_unknown(candidates, sensors), axis=1))


def output_errors(candidates: Candidates, sensors: Sequence[int]) -> Array:
    """The same of each deflection, over all duty cycles.

    Parameters
    ----------
    candidates : Candidates
    sensors : sequence of int

    Returns
    -------
    ndarray, shape (p,) [unit of each deflection]
    """
    return np.asarray(np.sqrt(np.mean(_unknown(candidates, sensors), axis=0)))


def _unknown(candidates: Candidates, sensors: Sequence[int]) -> Array:
    """Variances of the deflections that sensors leave, shape (cycles, p)."""
    squares = []
    for cycle in candidates.cycles:
        own = candidates.scaled(cycle)[list(sensors)]
        covariance = np.linalg.inv(np.eye(cycle.readings.shape[1]) + own.T @ own)
        squares.append(np.sum((cycle.deflections @ covariance) * cycle.deflections, axis=1))
    return np.array(squares)
