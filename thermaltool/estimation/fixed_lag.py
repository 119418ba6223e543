"""Fixed-lag smoother: estimates of a moment that has readings of some seconds after it.

What the innovations since then add to the prediction of a past row is a weighted sum of them: on
an even clock with constant weights, on any other by the adjoint recursion over the rows in
between. Batch and stream run the same code row by row. It needs numpy alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import GAIN_GRID, KalmanEstimator
from thermaltool.estimation.start import FORGOTTEN
from thermaltool.estimation.state_space import propagated
from thermaltool.responses.modes import Float
from thermaltool.responses.sample_clock import CLOCK_STEP

# Rows that a lag may span: each one costs memory, and on an uneven clock time.
MAX_LAG_ROWS = 20_000
# Sample lengths whose matrices are kept.
MAX_CACHED_LENGTHS = 64
# A sensor that is left out has so many times its noise: its reading says nothing.
LOST_NOISE = 1e4


@dataclass(frozen=True)
class _SteadySample:
    """The steady filter over one length of sample: a ← F x, v = y − H a, x ← a + G v.

    ``told`` is Hᵀ S⁻¹ and ``PC`` what an adjoint state adds to the estimates of its row.
    """

    F: Float
    H: Float
    C: Float
    G: Float
    told: Float
    PC: Float


@dataclass(frozen=True)
class _Row:
    """A row that waits: since when [clock steps], its sample's length, prediction, innovation.

    ``lost`` are sensors that were left out of it.
    """

    at: int
    ticks: int
    predicted: Float
    innovation: Float
    lost: tuple[int, ...] = ()

    @property
    def kind(self) -> tuple[int, tuple[int, ...]]:
        """What its matrices go by."""
        return self.ticks, self.lost


class FixedLag:
    """Estimates `lag` seconds late, row by row.

    Parameters
    ----------
    estimator : KalmanEstimator
    lag : float [s]
        A sample or more.
    period : float [s]
        The expected sample length.

    Raises
    ------
    ModelError
        A lag of less than a row, or of more than `MAX_LAG_ROWS`.
    """

    def __init__(self, estimator: KalmanEstimator, lag: float, period: float) -> None:
        if not 1 <= round(lag / period, 6) <= MAX_LAG_ROWS:
            raise ModelError(
                f"a lag of {lag:g} s is {lag / period:.3g} samples of {period:g} s: give 1 to "
                f"{MAX_LAG_ROWS}"
            )
        self._estimator, self._lag = estimator, round(lag / CLOCK_STEP)
        self._period = max(round(period / CLOCK_STEP), 1)
        self._sample = lru_cache(MAX_CACHED_LENGTHS)(self._of_ticks)
        self._taps = lru_cache(MAX_CACHED_LENGTHS)(self._of_even_rows)
        self._rows: deque[_Row] = deque()
        # The newest rows of one sample length: where they are all, the clock is even.
        self._now, self._even = 0, 0
        self._x = np.zeros(len(self._sample(self._period).F))

    def _of_ticks(self, ticks: int, lost: tuple[int, ...] = ()) -> _SteadySample:
        dt = ticks * CLOCK_STEP
        # As `KalmanEstimator` has it: solved for on a grid, but for the expected length.
        near = (
            dt
            if ticks == self._period
            else float(np.exp(round(np.log(dt) / GAIN_GRID) * GAIN_GRID))
        )
        estimator = without_readings(self._estimator, lost)
        space, (P, G) = estimator.state_space(dt), estimator.steady(near)
        S = space.H @ P @ space.H.T + space.R
        told = np.asarray(np.linalg.solve(S, space.H).T)
        return _SteadySample(space.F, space.H, space.C, G, told, P @ space.C.T)

    def _of_even_rows(self, ticks: int, lost: tuple[int, ...], rows: int) -> Float:
        """Weights of `rows` innovations of one sample length, shape (n_estimates, rows·p)."""
        sample = self._sample(ticks, lost)
        L = sample.F - sample.F @ sample.G @ sample.H
        weights, M = [], sample.PC.T
        for _ in range(rows):
            weights.append(M @ sample.told)
            M = M @ L.T
        return np.concatenate(weights, axis=1)

    def start(self, readings: Float, settled: bool = False) -> None:
        """Begin at the first readings: at rest, or settled at them.

        Parameters
        ----------
        readings : ndarray, shape (n_sensors,)
        settled : bool
        """
        first = self._sample(self._period)
        self._x = self._estimator.start(self._period * CLOCK_STEP, readings, settled)
        self._now, self._even = 0, 1
        self._rows = deque([_Row(0, self._period, first.C @ self._x, np.zeros(len(readings)))])

    def step(self, ticks: int, readings: Float, lost: Collection[int] = ()) -> None:
        """Take the readings after a sample of `ticks` clock steps.

        Parameters
        ----------
        ticks : int
        readings : ndarray, shape (n_sensors,)
        lost : collection of int
            Sensors whose readings do not count.
        """
        own = tuple(sorted(lost))
        sample = self._sample(ticks, own)
        a = sample.F @ self._x
        v = readings - sample.H @ a
        v[list(own)] = 0.0
        self._x = a + sample.G @ v
        self._now += ticks
        row = _Row(self._now, ticks, sample.C @ a, v, own)
        same = self._rows and row.kind == self._rows[-1].kind
        self._even = self._even + 1 if same else 1
        self._rows.append(row)

    @property
    def due(self) -> bool:
        """Whether the oldest row that waits has all the readings that it waits for."""
        return bool(self._rows) and self._now - self._rows[0].at >= self._lag

    def take(self) -> Float:
        """The estimates of the oldest row that waits, shape (n_estimates,)."""
        rows, first = self._rows, self._rows[0]
        if self._even >= len(rows):
            late = self._taps(*first.kind, len(rows)) @ np.concatenate(
                [row.innovation for row in rows]
            )
        else:
            late = self._adjoint() @ self._sample(*first.kind).PC
        rows.popleft()
        return np.asarray(first.predicted + late)

    def latest_due(self) -> Float | None:
        """The estimates of the newest row that is due, and none before it; None where none is."""
        due = None
        while self.due:
            if len(self._rows) > 1 and self._now - self._rows[1].at >= self._lag:
                self._rows.popleft()
            else:
                due = self.take()
        return due

    def _adjoint(self) -> Float:
        """r ← Hᵀ S⁻¹ v + Lᵀ r over the rows that wait, the newest first."""
        r, carried = np.zeros(len(self._x)), None
        for row in reversed(self._rows):
            sample = self._sample(*row.kind)
            if carried is not None:
                kept = carried.T @ r
                r = kept - sample.H.T @ (sample.G.T @ kept)
            r = r + sample.told @ row.innovation
            carried = sample.F
        return r

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        rows = [
            [
                row.at - self._now,
                row.ticks,
                row.predicted.tolist(),
                row.innovation.tolist(),
                list(row.lost),
            ]
            for row in self._rows
        ]
        return [self._x.tolist(), rows]

    def resume(self, values: list[Any]) -> None:
        """Go on from a state.

        Raises
        ------
        ValueError
            Not a state of this smoother.
        """
        x, rows = values
        state = np.array(x, float)
        if state.shape != self._x.shape or not np.isfinite(state).all():
            raise ValueError("not a state of this smoother")
        sample = self._sample(self._period)
        kept = [
            _Row(int(at), int(ticks), np.array(p, float), np.array(v, float),
                 tuple(int(k) for k in chain.from_iterable(lost)))
            for at, ticks, p, v, *lost in rows
        ]  # fmt: skip
        for row in kept:
            sizes = row.predicted.shape + row.innovation.shape
            strange = any(not 0 <= k < len(sample.H) for k in row.lost)
            if sizes != (len(sample.C), len(sample.H)) or row.at > 0 or row.ticks <= 0 or strange:
                raise ValueError("not a state of this smoother")
        self._x, self._now, self._rows = state, 0, deque(kept)
        same = [row.kind == kept[-1].kind for row in reversed(kept)]
        self._even = same.index(False) if False in same else len(kept)


def without_readings(estimator: KalmanEstimator, lost: Collection[int]) -> KalmanEstimator:
    """The estimator of the same states that takes nothing from some sensors.

    The same one where they are all: no reading is left to be weighed otherwise.

    Parameters
    ----------
    estimator : KalmanEstimator
    lost : collection of int
        Sensors.
    """
    if not 0 < len(lost) < len(estimator.noise):
        return estimator
    noise = tuple(
        replace(each, white=LOST_NOISE * each.white) if k in lost else each
        for k, each in enumerate(estimator.noise)
    )
    return replace(estimator, noise=noise)


def fixed_lag(
    estimator: KalmanEstimator, time: Float, readings: Float, lag: float, settled: bool = False
) -> Float:
    """Fixed-lag smoothing of a whole record, equal to the stream's row by row.

    Each row has the readings up to the first one that is `lag` later, the last ones what there is.

    Parameters
    ----------
    estimator : KalmanEstimator
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
    lag : float [s]
    settled : bool

    Returns
    -------
    ndarray, shape (n, n_estimates)
    """
    n = len(time)
    out = np.empty((n, len(estimator.estimates)))
    if not n:
        return out
    ticks = np.round(np.diff(time) / CLOCK_STEP).astype(np.int64).tolist()
    period = float(np.median(np.diff(time))) if n > 1 else lag
    smoother = FixedLag(estimator, lag, period)
    smoother.start(readings[0], settled)
    k = 0
    for length, row in zip(ticks, readings[1:], strict=True):
        smoother.step(length, row)
        while smoother.due:
            out[k] = smoother.take()
            k += 1
    for late in range(k, n):
        out[late] = smoother.take()
    return out


def error_variance(
    estimator: KalmanEstimator, true: KalmanEstimator, period: float, rows: int
) -> Float:
    """Variance of the errors of the steady estimates with readings of 0, 1, ... `rows` later rows.

    The gains are the estimator's, whatever is true: the error and that of the prediction of the
    newest row, ã ← L ã − K e + w with L = F − K H, are carried along from lag to lag.

    Parameters
    ----------
    estimator : KalmanEstimator
    true : KalmanEstimator
        With the sizes of walk and noise that hold.
    period : float [s]
    rows : int

    Returns
    -------
    ndarray, shape (rows + 1, n_estimates)
    """
    space, (P, G) = estimator.state_space(period), estimator.steady(period)
    holds = true.state_space(period)
    F, H, C, K = space.F, space.H, space.C, space.F @ G
    L, m = F - K @ H, len(space.C)
    told = np.linalg.solve(H @ P @ H.T + space.R, H).T
    added = K @ holds.R @ K.T + holds.Q
    both = np.vstack([C, np.eye(len(F))])
    Z = both @ propagated(L, added, np.zeros_like(P), FORGOTTEN) @ both.T
    A, B = np.eye(m + len(F)), np.vstack([np.zeros((m, len(H))), -K])
    A[m:, m:] = L
    variance, M = np.empty((rows + 1, m)), C @ P.T
    for k in range(rows + 1):
        B[:m] = -M @ told
        A[:m, m:] = B[:m] @ H
        Z = A @ Z @ A.T + B @ holds.R @ B.T
        Z[m:, m:] += holds.Q
        variance[k], M = np.diag(Z)[:m], M @ L.T
    return np.asarray(np.maximum(variance, 0.0))
