"""A Kalman filter along a stream: steady, but for the first rows of a machine that begins warm.

It needs numpy alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from thermaltool.errors import FitError
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.free_start import FreeStart
from thermaltool.estimation.gain_test import WhitenedSample
from thermaltool.responses.modes import Float
from thermaltool.responses.sample_clock import CLOCK_STEP

# Sample lengths whose matrices are kept.
MAX_CACHED_LENGTHS = 64


@dataclass(frozen=True)
class TrackedRow:
    """What a filter says of one row.

    Attributes
    ----------
    sample : WhitenedSample
        The filter over the sample that ends here.
    foretold : ndarray, shape (n_states,)
        The state before the readings.
    z : ndarray, shape (n_sensors,)
        The whitened innovation.
    counts : bool
        Whether it rests on the rows before it more than on the start.
    """

    sample: WhitenedSample
    foretold: Float
    z: Float
    counts: bool

    @property
    def log_density(self) -> float:
        """Of the readings, given those before, but for a constant [nats]."""
        return self.sample.log_scale - 0.5 * float(self.z @ self.z)


class FilterTrack:
    """The filter of one stream or record, row by row.

    Parameters
    ----------
    estimator : KalmanEstimator
    period : int
        The expected sample length in clock steps.
    level : sequence of float, one for each drive
        Standard deviation of the heat that a warm machine has had [unit of the drive]; where it is
        empty no machine begins warm.

    Attributes
    ----------
    x : ndarray, shape (n_states,)
        The state after the last reading.
    """

    def __init__(self, estimator: KalmanEstimator, period: int, level: Sequence[float]) -> None:
        self._filter, self._period, self._level = estimator, period, tuple(level)
        self._sample = lru_cache(MAX_CACHED_LENGTHS)(self._of_ticks)
        self.x = np.zeros(len(self._sample(period).F))
        self._unknown: FreeStart | None = None

    def _of_ticks(self, ticks: int) -> WhitenedSample:
        dt = ticks * CLOCK_STEP
        space = self._filter.state_space(dt)
        P, G = self._filter.steady(dt)
        return WhitenedSample.of(space.F, space.H, G, space.H @ P @ space.H.T + space.R)

    def start(self, readings: Float, settled: bool) -> None:
        """Begin at the first readings, at rest or settled at them."""
        self.x = self._filter.start(self._period * CLOCK_STEP, readings, settled)
        self._unknown = None

    def free(self, readings: Float) -> bool:
        """Go on from a reading of a machine that is warm, if any; False where that cannot be."""
        if not self._level:
            return False
        dt = self._period * CLOCK_STEP
        with suppress(FitError):
            unknown = FreeStart(self._filter, dt, self._level)
            self.x, self._unknown = unknown.first(dt, readings), unknown
            return True
        return False

    def step(self, ticks: int, readings: Float) -> TrackedRow:
        """Take the readings after a sample of `ticks` clock steps."""
        sample, counts = self._sample(ticks), True
        if self._unknown is not None:
            sample = self._unknown.sample(ticks, sample)
            counts = self._unknown.counts
            self._unknown = None if self._unknown.over else self._unknown
        foretold = sample.F @ self.x
        v = readings - sample.H @ foretold
        self.x = foretold + sample.G @ v
        return TrackedRow(sample, foretold, sample.root @ v, counts)

    def state(self) -> tuple[list[float], list[Any] | None]:
        """Of the filter, and of a start that is not known well: as JSON."""
        return self.x.tolist(), None if self._unknown is None else self._unknown.state()

    def resume(self, x: Any, unknown: Any) -> None:
        """Go on from a state.

        Raises
        ------
        ValueError
            Not a state of this filter.
        """
        state = np.array(x, float)
        if state.shape != self.x.shape or not np.isfinite(state).all():
            raise ValueError("not a state of this filter")
        self._unknown = None
        if unknown is not None:
            dt = self._period * CLOCK_STEP
            self._unknown = FreeStart(self._filter, dt, self._level, unknown)
        self.x = state
