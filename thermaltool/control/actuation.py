"""What heaters deliver of what is set: the integral of the error; heaters that do not follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thermaltool.responses.modes import Float

# A heater does not follow where what it delivers is off by this part of full power for so many
# samples: a supply that overshoots is back within one.
DEVIATION, PATIENCE = 0.1, 3
# The integral of the error is taken back over so many sample periods.
INTEGRAL_PERIODS = 5.0
# Whether a meter answers late is told from about so many samples.
MISSES = 10
# It never moves a setpoint by more than this part of full power.
LARGEST_TRIM = 0.2
# A heater that delivers less than is set is tried with this part of full power until it follows:
# enough to see it, and little where it returns.
TRIAL_POWER = 0.25


@dataclass
class Actuation:
    """The heaters of a controller, as their measured power shows them.

    Attributes
    ----------
    maxima : ndarray, shape (n,) [unit of the drives]
    period : float [s]
    stuck : ndarray of bool, shape (n,)
        Those that do not follow.
    trim : ndarray, shape (n,)
        What is added to the wanted powers, so that the mean of what is delivered becomes theirs.
    """

    maxima: Float
    period: float
    _off: Float = field(init=False)
    _before: Float = field(init=False)
    # Mean square error of the power beside the setpoint of its sample, and of the one before.
    _misses: Float = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.maxima)
        self.stuck, self.trim = np.zeros(n, bool), np.zeros(n)
        self._off, self._before, self._misses = np.zeros(n, int), np.zeros(n), np.zeros((n, 2))

    def take(self, dt: float, given: Float, measured: Sequence[float | None]) -> list[int]:
        """A sample of `dt` [s]; heaters that have begun to follow, or ceased to.

        Parameters
        ----------
        dt : float [s]
        given : ndarray, shape (n,)
            Setpoints during the sample, trim included.
        measured : sequence of float or None
            Mean power during it; None where it is not known.
        """
        changed, before = [], self._before
        self._before = np.array(given, float)
        for k, power in enumerate(measured):
            if power is None:
                self.trim[k] = 0.0
                continue
            # A meter may answer a sample late: then it shows the setpoint before.
            errors = np.array([given[k], before[k]]) - power
            self._misses[k] += (errors**2 - self._misses[k]) / MISSES
            error = errors[np.argmin(self._misses[k])]
            between = errors[0] * errors[1] < 0
            differs = not between and np.abs(errors).min() > DEVIATION * self.maxima[k]
            self._off[k] = self._off[k] + 1 if differs != self.stuck[k] else 0
            if self._off[k] >= PATIENCE:
                self.stuck[k], self._off[k] = differs, 0
                changed.append(k)
            if differs or self.stuck[k]:
                self.trim[k] = 0.0
                continue
            largest = LARGEST_TRIM * self.maxima[k]
            share = min(dt / (INTEGRAL_PERIODS * self.period), 1.0)
            # The error of what was wanted: the trim itself is none.
            trim = self.trim[k] + share * (error - self.trim[k])
            self.trim[k] = min(max(trim, -largest), largest)
        return changed

    def setpoint(self, k: int, wanted: float, given: float, measured: float | None) -> float:
        """What to set a heater to, so that `wanted` is delivered.

        Parameters
        ----------
        k : int
        wanted : float
        given, measured : float, float or None
            Its setpoint as it stands, and what it delivers.
        """
        if not self.stuck[k]:
            return float(min(max(wanted + self.trim[k], 0.0), self.maxima[k]))
        if measured is not None and measured > given:
            return 0.0
        return TRIAL_POWER * float(self.maxima[k])

    def state(self) -> list[list[Any]]:
        """For `resume`, as JSON."""
        return [self.trim.tolist(), self.stuck.tolist()]

    def resume(self, values: Sequence[Sequence[Any]]) -> None:
        """Go on from `values`; ValueError where they are none of these heaters."""
        trim, stuck = np.array(values[0], float), np.array(values[1], bool)
        if (
            trim.shape != self.trim.shape
            or stuck.shape != trim.shape
            or not np.isfinite(trim).all()
        ):
            raise ValueError("not a state of these heaters")
        self.trim, self.stuck = trim, stuck
