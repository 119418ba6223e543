"""An estimator one sample at a time: a single matrix-vector product per sample."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from thermaltool.estimation.estimator import Estimator
from thermaltool.estimation.settling_time import settling_time
from thermaltool.estimation.variable_cooling import VariableLossEstimator, other_clock
from thermaltool.responses.modes import Float
from thermaltool.responses.sample_clock import CLOCK_STEP

# Sample lengths whose matrix is kept ready: an even clock has one, a printed jittering one a few.
MAX_CACHED_MATRICES = 32


class Steps(ABC):
    """What answers each sample with estimates: a `Stepper`, or something of its kind.

    Attributes
    ----------
    settling_time : float [s]
        Until a wrong start is forgotten.
    out : set of int
        Sensors whose readings do not count.
    left_out : int or None
        The sensor that the estimates do not use.
    residuals : list of float
        What each sensor reads, less what the others predict; empty where nothing predicts them.
    """

    settling_time = 0.0
    left_out: int | None = None

    def __init__(self) -> None:
        self.out: set[int] = set()
        self.residuals: list[float] = []

    def can_do_without(self, lost: Collection[int]) -> bool:
        """Whether there are estimates that use none of these sensors."""
        return not lost

    def cost(self, lost: Collection[int]) -> str:
        """What estimates without these sensors are worth less, as a sentence; or nothing."""
        return ""

    def can_start(self, readings: list[float]) -> bool:
        """Whether the first readings suffice."""
        return all(map(math.isfinite, readings))

    @abstractmethod
    def rest(self) -> list[float]:
        """Estimates before anything is known."""

    @abstractmethod
    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        """Estimates at the first readings."""

    def at_rest(self, readings: list[float]) -> list[float]:
        """What the sensors of a machine at rest read, beside these first readings.

        Of readings from which nothing is estimated there is none.
        """
        return [0.0] * len(readings)

    @abstractmethod
    def step(self, ticks: int, readings: list[float]) -> list[float]:
        """Estimates after a sample of `ticks` clock steps."""

    @abstractmethod
    def state(self) -> list[Any]:
        """For `resume`, as JSON."""

    @abstractmethod
    def resume(self, values: list[Any]) -> None:
        """Go on from a state."""


class Stepper(Steps):
    """The state of an estimator, advanced sample by sample.

    x ← F x + G0 u_before + G1 u_now and y = C x are one product of a stacked matrix with
    z = (x, u_before, u_now), so the work per sample depends on the number of states alone.

    Parameters
    ----------
    estimator : Estimator
    sample_period : float [s]
        The expected sample length: its gain is solved for at once, before the first line.
    """

    def __init__(self, estimator: Estimator, sample_period: float) -> None:
        super().__init__()
        self._estimator = estimator
        self._period = sample_period
        self._sensors = len(estimator.sensors)
        recursion = estimator.recursion(sample_period)
        self._states = len(recursion.F)
        deflections = slice(len(estimator.estimates) - len(estimator.outputs), None)
        self.settling_time = settling_time(recursion, sample_period, deflections)
        self._z = np.zeros(self._states + 2 * self._sensors)
        self._next = np.empty(self._states + len(estimator.estimates))
        self._matrices: dict[int, Float] = {}

    def rest(self) -> list[float]:
        """Estimates before anything is known."""
        return [0.0] * len(self._estimator.estimates)

    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        """Estimates at the first readings: the machine is at rest, or has settled at them.

        Parameters
        ----------
        readings : list of float
        settled : bool
        """
        self._z[:] = 0.0
        self._z[self._states : self._states + self._sensors] = readings
        first = np.array(readings)
        self._z[: self._states] = self._estimator.start(self._period, first, settled)
        C = self._estimator.recursion(self._period).C
        estimates: list[float] = (C @ self._z[: self._states]).tolist()
        return estimates

    def at_rest(self, readings: list[float]) -> list[float]:
        expected: list[float] = self._estimator.at_rest(self._period, np.array(readings)).tolist()
        return expected

    def step(self, ticks: int, readings: list[float]) -> list[float]:
        """Estimates after a sample of `ticks` clock steps (1 ns), which ends with `readings`.

        Parameters
        ----------
        ticks : int
        readings : list of float

        Raises
        ------
        FitError
            Where the estimator has no gain for this sample length.
        """
        states, before = self._states, self._states + self._sensors
        matrix = self._matrices.get(ticks)
        if matrix is None:
            matrix = self._matrix(ticks)
        z = self._z
        z[before:] = readings
        matrix.dot(z, out=self._next)
        z[:states] = self._next[:states]
        z[states:before] = z[before:]
        estimates: list[float] = self._next[states:].tolist()
        return estimates

    @property
    def now(self) -> Float:
        """State of the estimator at the last sample, shape (n,)."""
        return self._z[: self._states].copy()

    @property
    def before(self) -> Float:
        """Readings at the last sample, shape (n_sensors,)."""
        return self._z[self._states : self._states + self._sensors].copy()

    def amend(self, readings: Mapping[int, float]) -> None:
        """What inputs were in truth since the sample before, by their places.

        Parameters
        ----------
        readings : mapping of int to float
        """
        for place, value in readings.items():
            self._z[self._states + place] = value

    def _matrix(self, ticks: int) -> Float:
        if len(self._matrices) >= MAX_CACHED_MATRICES:
            del self._matrices[next(iter(self._matrices))]
        r = self._estimator.recursion(ticks * CLOCK_STEP)
        if len(r.F) != self._states:
            raise other_clock(ticks)
        sample = np.hstack([r.F, r.G0, r.G1])
        matrix = self._matrices[ticks] = np.vstack([sample, r.C @ sample])
        return matrix

    def state(self) -> list[float]:
        """State and last readings, for `resume`."""
        values: list[float] = self._z[: self._states + self._sensors].tolist()
        return values

    def resume(self, values: list[Any]) -> None:
        """Raises ValueError where `values` are no state of this estimator.

        Of several filters that watched each other it is the first.
        """
        if values and isinstance(values[0], list):
            values = values[0]
        state = np.array(values, float)
        if state.shape != (self._states + self._sensors,) or not np.all(np.isfinite(state)):
            raise ValueError("not a state of this estimator")
        self._z[: len(state)] = state


class VariableCoolingStepper(Stepper):
    """The same for a machine whose loss of heat changes: the state passes the estimator itself.

    Parameters
    ----------
    estimator : VariableLossEstimator
    sample_period : float [s]
    """

    def __init__(self, estimator: VariableLossEstimator, sample_period: float) -> None:
        super().__init__(estimator, sample_period)
        self._lossy, self._C = estimator, estimator.recursion(sample_period).C
        self._first = np.zeros(self._sensors)

    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        self._first[:] = readings
        return super().start(readings, settled)

    def step(self, ticks: int, readings: list[float]) -> list[float]:
        states, before = self._states, self._z[self._states : self._states + self._sensors]
        now = np.array(readings)
        x = self._lossy.advance(ticks, self._z[:states], self._first, before, now)
        self._z[:states], before[:] = x, now
        estimates: list[float] = (self._C @ x).tolist()
        return estimates

    def state(self) -> list[float]:
        return [*super().state(), *self._first.tolist()]

    def resume(self, values: list[Any]) -> None:
        kept = len(values) - self._sensors
        super().resume(values[:kept])
        first = np.array(values[kept:], float)
        if not np.all(np.isfinite(first)):
            raise ValueError("not a state of this estimator")
        self._first[:] = first


def stepper_of(estimator: Estimator, sample_period: float) -> Stepper:
    """The stepper that an estimator takes; see `Stepper`."""
    if isinstance(estimator, VariableLossEstimator):
        return VariableCoolingStepper(estimator, sample_period)
    return Stepper(estimator, sample_period)
