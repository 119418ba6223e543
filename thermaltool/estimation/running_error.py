"""Covariance of the errors of a steady filter along its way: wide at the start, steady later.

A filter of constant gain G begins at a state that it does not know as well as it will. Its error
e ← (I − G H)(F e + w) − G v is carried along row by row; batch and stream run the same code. It
needs numpy alone.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from thermaltool.errors import FitError
from thermaltool.estimation.estimator import GAIN_GRID, KalmanEstimator
from thermaltool.estimation.fixed_lag import without_readings
from thermaltool.estimation.start import FORGOTTEN, Initial
from thermaltool.estimation.state_space import propagated
from thermaltool.responses.modes import Float
from thermaltool.responses.sample_clock import CLOCK_STEP

# Nearer than this to the steady covariance, of its standard deviations, it is the steady one.
SETTLED_SHARE = 1e-6
# Sample lengths, and choices of lost sensors, whose matrices are kept.
MAX_CACHED = 64


@dataclass(frozen=True)
class _ErrorSample:
    """P ← A P Aᵀ + added over one sample, and what P becomes when all samples are like it."""

    A: Float
    added: Float
    steady: Float
    scale: Float


class RunningError:
    """Standard errors of the estimates of one stream or record, row by row.

    Parameters
    ----------
    estimator : KalmanEstimator
        Whose gains they are.
    period : float [s]
        The expected sample length.
    level : sequence of float, one for each drive
        How large a heat may be at the first row (a standard deviation) [unit of the drive].
    true : KalmanEstimator, optional
        With the sizes of walk and noise that hold. Default: those of the estimator.

    Attributes
    ----------
    sigma : ndarray, shape (n_estimates,)
        Standard errors at the last row, for a model that is right.
    """

    def __init__(
        self,
        estimator: KalmanEstimator,
        period: float,
        level: Sequence[float],
        true: KalmanEstimator | None = None,
    ) -> None:
        # Sizes alone: an error that drifts at another pace than the filter thinks has other states.
        noise = tuple(
            replace(own, drift_time=design.drift_time)
            for own, design in zip((true or estimator).noise, estimator.noise, strict=True)
        )
        self._estimator, self._true = estimator, replace(true or estimator, noise=noise)
        self._period, self._level = period, level
        self._near = round(np.log(period) / GAIN_GRID)
        self._sample = lru_cache(MAX_CACHED)(self._of_length)
        self._C = estimator.state_space(period).C
        self._kind: tuple[int, tuple[int, ...]] = (self._near, ())
        # The covariance; None where it is the steady one of the last sample's kind.
        self._P: Float | None = None
        self._tell()

    def _of_length(self, near: int, lost: tuple[int, ...]) -> _ErrorSample:
        """Over a sample of a length on the grid of the gains, without some sensors."""
        dt = self._period if near == self._near else float(np.exp(near * GAIN_GRID))
        estimator = without_readings(self._estimator, lost)
        holds = without_readings(self._true, lost).state_space(dt)
        space, G = estimator.state_space(dt), estimator.recursion(dt).G1
        kept = np.eye(len(space.F)) - G @ space.H
        A = kept @ space.F
        added = kept @ holds.Q @ kept.T + G @ holds.R @ G.T
        steady = propagated(A, added, np.zeros_like(A), FORGOTTEN)
        scale = np.sqrt(np.maximum(np.diag(steady), 1e-300))
        return _ErrorSample(A, added, steady, np.outer(scale, scale))

    def start(self, initial: Initial) -> None:
        """Begin at the first readings.

        Parameters
        ----------
        initial : {"rest", "settled", "free"}
            The filter begins at rest or settled at the readings; or it begins at rest, and the
            machine does not.
        """
        estimator, dt = self._true, self._period
        if initial == "free":
            # A response that does not decay may have kept anything: what is known is the heat.
            with contextlib.suppress(FitError):
                self._begin(estimator.start_covariance(dt, self._level, "free"))
                return
        P = estimator.start_covariance(dt, self._level, "rest" if initial == "free" else initial)
        if initial == "settled":
            space = estimator.state_space(dt)
            # The first state is S times the readings, which are of the state and noise.
            units = np.eye(len(space.H))
            S = np.stack([self._estimator.start(dt, unit, True) for unit in units], axis=1)
            left = np.eye(len(P)) - S @ space.H
            P = left @ P @ left.T + S @ space.R @ S.T
        self._begin(P)

    def _begin(self, P: Float) -> None:
        self._kind, self._P = (self._near, ()), P
        self._tell()

    def step(self, ticks: int, lost: Collection[int] = ()) -> None:
        """Go on by a sample of `ticks` clock steps, without the readings of `lost` sensors.

        Parameters
        ----------
        ticks : int
        lost : collection of int
        """
        kind = round(np.log(ticks * CLOCK_STEP) / GAIN_GRID), tuple(sorted(lost))
        if self._P is None and kind == self._kind:
            return
        sample = self._sample(*kind)
        P = sample.A @ self._now @ sample.A.T + sample.added
        self._kind, self._P = kind, P
        if np.all(np.abs(P - sample.steady) <= SETTLED_SHARE * sample.scale):
            self._P = None
        self._tell()

    @property
    def _now(self) -> Float:
        return self._sample(*self._kind).steady if self._P is None else self._P

    def _tell(self) -> None:
        variance = np.sum((self._C @ self._now) * self._C, axis=1)
        self.sigma = np.sqrt(np.maximum(variance, 0.0))

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        near, lost = self._kind
        return [near, list(lost), None if self._P is None else self._P.tolist()]

    def resume(self, values: list[Any]) -> None:
        """Go on from a state.

        Raises
        ------
        ValueError
            Not a state of this filter.
        """
        near, lost, kept = values
        P = None if kept is None else np.array(kept, float)
        strange = any(not 0 <= k < len(self._estimator.sensors) for k in lost)
        if strange or (P is not None and (P.shape != (len(self._C.T),) * 2
                                          or not np.isfinite(P).all())):  # fmt: skip
            raise ValueError("not a state of this filter")
        self._kind, self._P = (int(near), tuple(int(k) for k in lost)), P
        self._tell()


def running_errors(error: RunningError, time: Float, initial: Initial = "rest") -> Float:
    """Standard errors of the estimates of a whole record, equal to the stream's row by row.

    Parameters
    ----------
    error : RunningError
    time : ndarray, shape (n,) [s], increasing
    initial : {"rest", "settled", "free"}
        As for `RunningError.start`.

    Returns
    -------
    ndarray, shape (n, n_estimates)
    """
    found = np.empty((len(time), len(error.sigma)))
    if len(time):
        error.start(initial)
        found[0] = error.sigma
    ticks = np.round(np.diff(time) / CLOCK_STEP).astype(np.int64).tolist()
    for k, length in enumerate(ticks, 1):
        error.step(length)
        found[k] = error.sigma
    return found
