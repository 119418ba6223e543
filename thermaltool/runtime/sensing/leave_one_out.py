"""Several sensors that watch each other: what each should read by the others, and without it.

Beside the filter of all sensors runs one without each. It predicts the sensor that it lacks; where
a sensor is lost, or the others agree against it, the filter without it goes on alone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from thermaltool.errors import FitError
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.stepper import Stepper, Steps

# Sample lengths of the filters beside the full one are multiples of this part of the period.
GRID_STEPS = 64


def without(estimator: KalmanEstimator, k: int) -> KalmanEstimator:
    """The estimator that lacks sensor `k` and estimates it, behind the deflections.

    Parameters
    ----------
    estimator : KalmanEstimator
    k : int
    """
    place = [j - (j > k) for j in range(len(estimator.sensors))]
    last = len(estimator.outputs)
    sensed = tuple((place[to], drive, m) for to, drive, m in estimator.sensed if to != k)
    predicted = tuple((last, drive, m) for to, drive, m in estimator.sensed if to == k)
    return replace(
        estimator,
        sensors=(*estimator.sensors[:k], *estimator.sensors[k + 1 :]),
        outputs=(*estimator.outputs, estimator.sensors[k]),
        sensed=sensed,
        followed=(*estimator.followed, *predicted),
        noise=(*estimator.noise[:k], *estimator.noise[k + 1 :]),
    )


class LeaveOneOut(Steps):
    """The filter of all sensors, and one without each.

    Parameters
    ----------
    estimator : KalmanEstimator
    sample_period : float [s]
    tolerance : sequence of float, one for each deflection [unit of the deflection]
        Filters whose deflections differ by less agree.

    Attributes
    ----------
    residuals : list of float
        NaN where nothing predicts a sensor.
    """

    def __init__(
        self, estimator: KalmanEstimator, sample_period: float, tolerance: Sequence[float]
    ) -> None:
        super().__init__()
        self._full = Stepper(estimator, sample_period)
        self.settling_time = self._full.settling_time
        self._others: list[Stepper | None] = []
        for k in range(len(estimator.sensors)):
            try:
                self._others.append(Stepper(without(estimator, k), sample_period))
            except (FitError, np.linalg.LinAlgError):
                # This sensor alone sees a drive.
                self._others.append(None)
        self._drives, self._tolerance = len(estimator.drives), tolerance
        # Filters that have agreed with the full one since a reading was last held.
        self._agreed = [False] * len(self._others)
        self.residuals = [math.nan] * len(self._others)
        self.left_out: int | None = None
        # Until so long after a start of their own the others agree in passing alone [s].
        self._starting = 0.0
        self._grid, self._carried = max(round(sample_period / CLOCK_STEP / GRID_STEPS), 1), 0

    def can_do_without(self, lost: Collection[int]) -> bool:
        """Whether there are estimates that use none of these sensors."""
        if len(lost) != 1:
            return not lost
        (k,) = lost
        return self._others[k] is not None and (self._agreed[k] or self.left_out == k)

    def rest(self) -> list[float]:
        """Estimates before anything is known."""
        return self._full.rest()

    def can_start(self, readings: list[float]) -> bool:
        """Whether the first readings suffice: one may be missing (NaN) that others make up for."""
        missing = [k for k, reading in enumerate(readings) if not math.isfinite(reading)]
        return not missing or (len(missing) == 1 and self._others[missing[0]] is not None)

    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        """Estimates at the first readings, one of which may be NaN; see `Stepper.start`."""
        missing = next((k for k, reading in enumerate(readings) if reading != reading), None)
        readings = _numbers(readings)
        estimates = self._full.start(readings, settled)
        for k, other in enumerate(self._others):
            if other is not None:
                first = other.start(_but(readings, k), settled)
                estimates = first[:-1] if k == missing else estimates
                self._agreed[k] = missing in (None, k)
        self.left_out = missing
        return estimates

    def step(self, ticks: int, readings: list[float]) -> list[float]:
        """Estimates after a sample; see `Stepper.step`."""
        readings = _numbers(readings)
        self._starting = max(self._starting - ticks * CLOCK_STEP, 0.0)
        full = self._full.step(ticks, readings)
        chosen = full
        ticks = self._coarse(ticks)
        out = next(iter(self.out)) if len(self.out) == 1 else None
        if out is not None and self.can_do_without([out]):
            self.left_out = out
        for k, other in enumerate(self._others):
            if other is None:
                continue
            *estimates, predicted = other.step(ticks, _but(readings, k))
            self.residuals[k] = readings[k] - predicted
            agrees = self._agree(full, estimates)
            if self.left_out == k:
                if out is None and agrees:
                    # The full filter has forgotten what the sensor was held at while it was out.
                    self.left_out = None
                else:
                    chosen = estimates
            elif self.out:
                # It takes what the sensor that is out was held at.
                self._agreed[k] = k in self.out and self._agreed[k]
            elif self.left_out is None:
                self._agreed[k] = self._agreed[k] or (agrees and not self._starting)
            if not self._agreed[k] and self.left_out != k:
                self.residuals[k] = math.nan
        return chosen

    def _coarse(self, ticks: int) -> int:
        """A sample length on a grid, so that a clock that jitters takes few matrices a filter.

        What is rounded off counts with the next sample.
        """
        exact = ticks + self._carried
        coarse = max(round(exact / self._grid), 1) * self._grid
        self._carried = exact - coarse
        return coarse

    def _agree(self, one: Sequence[float], other: Sequence[float]) -> bool:
        first = self._drives
        pairs = zip(one[first:], other[first:], self._tolerance, strict=True)
        return all(abs(a - b) <= tolerance for a, b, tolerance in pairs)

    def state(self) -> list[Any]:
        """For `resume`: each filter, which agree with the full one, and what is left out."""
        filters = [self._full.state(), *(each.state() if each else [] for each in self._others)]
        return [*filters, [self._agreed, self.left_out, self._starting]]

    def resume(self, values: list[Any]) -> None:
        """Raises ValueError where `values` are no state of these filters.

        One of a stream that trusted its sensors holds the full filter alone: the others start at
        rest, and agree with it in time.
        """
        if values and not isinstance(values[0], list):
            self._full.resume(values)
            self._starting = self.settling_time
            return
        full, *others, (agreed, left_out, *starting) = values
        self._full.resume(full)
        for each, kept in zip(self._others, others, strict=True):
            if each is not None:
                each.resume(kept)
        if len(agreed) != len(self._others) or left_out not in (None, *range(len(agreed))):
            raise ValueError("not a state of these filters")
        self._agreed, self.left_out = [bool(each) for each in agreed], left_out
        self._starting = float(starting[0]) if starting else 0.0


def _numbers(readings: list[float]) -> list[float]:
    """Rest for what has never been read: no filter that counts looks there."""
    return [reading if reading == reading else 0.0 for reading in readings]


def _but(readings: list[float], k: int) -> list[float]:
    return readings[:k] + readings[k + 1 :]
