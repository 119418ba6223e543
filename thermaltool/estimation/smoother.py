"""Fixed-interval smoother: estimates of a whole record that look at later readings, too.

The Kalman filter runs over the record and an adjoint recursion back over its innovations (de Jong
1989; Durbin and Koopman 2012, sec. 4.4): the estimates of Rauch, Tung and Striebel, without the
inverse of a covariance, which is singular where a machine begins at rest. Work and memory are
linear in the rows. Where the clock is even the covariance soon stands still; from there both ways
are recursions with constant matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from thermaltool.errors import FitError
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.start import Initial
from thermaltool.estimation.state_space import StateSpace, propagated
from thermaltool.estimation.stretches import Sensors, Stretch, even_rows
from thermaltool.responses.modes import Float

# A gain is held for as many rows as it, and the variances, change by no more than this share. What
# that costs the estimates is of the order of its square; the standard errors, which grow within a
# stretch, are true to 2 % in the first minutes after a start.
HELD_CHANGE = 1e-5
# A stretch is no more times as long as the one before: what a step of the heat changes in the gain
# shows late, when the modes have followed.
MAX_GROWTH = 1.3
# What is left of a sum of later readings counts as nothing below this share.
REMAINDER = 1e-12
# Lengths of sample whose matrices are kept.
MAX_LENGTHS = 512
# Below it a variance is none.
TINY = 1e-300


@dataclass(frozen=True)
class Smoothed:
    """Estimates of a whole record with their covariance, and what the filter saw on its way.

    Attributes
    ----------
    estimates, sigma : ndarray, shape (n, n_estimates)
        With their standard errors.
    filtered, filtered_sigma : ndarray, shape (n, n_estimates)
        From the readings up to each row.
    innovations : ndarray, shape (n, n_sensors)
        Whitened: of unit covariance where the model holds; NaN where there was no reading.
    log_likelihood : float
        Of the readings [nats].
    """

    estimates: Float
    sigma: Float
    filtered: Float
    filtered_sigma: Float
    innovations: Float
    log_likelihood: float


class _Filter:
    """The way forward: predictions and innovations of every row, and the stretches behind them."""

    def __init__(self, estimates: int, readings: Float, a: Float, P: Float) -> None:
        n, sensors = readings.shape
        self.readings, self.a, self.P = readings, a, P
        self.predicted = np.empty((n, estimates))
        self.variance = np.empty((n, estimates))
        self.filtered = np.empty((n, estimates))
        self.filtered_variance = np.empty((n, estimates))
        self.v = np.zeros((n, sensors))
        self.white = np.full((n, sensors), np.nan)
        self.stretches: list[Stretch] = []
        self.log_likelihood = 0.0

    def run(self, rows: slice, space: StateSpace, some: Sensors) -> None:
        """Rows of one length of sample, with readings of `some` sensors (their indices)."""
        F, C = space.F, space.C
        H, R = space.H[some], space.R[np.ix_(some, some)]
        k, length, before = rows.start, 1, np.zeros(0)
        while k < rows.stop:
            PH, PC = self.P @ H.T, self.P @ C.T
            S = H @ PH + R
            G = np.linalg.solve(S, PH.T).T
            K = F @ G
            L = F - K @ H
            now = np.concatenate([K.ravel() / max(np.max(np.abs(K), initial=0.0), TINY),
                                  np.log(np.einsum("ij,ji->i", C, PC) + TINY)])  # fmt: skip
            if not np.isfinite(now).all():
                raise FitError("the covariance of the estimate is not finite")
            # By how much they change in a sample, as the stretch before tells.
            rate = np.max(np.abs(now - before)) / length if len(before) else np.inf
            grown = 1 + int(MAX_GROWTH * length)
            held = int(min(HELD_CHANGE / max(rate, TINY), grown, rows.stop - k))
            before, length = now, max(held, 1)
            self._take(Stretch(slice(k, k + length), some, C, H, S, K, L, PC), C @ G)
            # Of the filter as it is, whether its gain is held or not.
            self.P = propagated(L, K @ R @ K.T + space.Q, self.P, length)
            k += length

    def _take(self, part: Stretch, CG: Float) -> None:
        rows, some, C, K = part.rows, part.some, part.C, part.K
        y = self.readings[rows][:, some]
        if part.short:
            v = np.empty(y.shape)
            for i, reading in enumerate(y):
                self.predicted[rows.start + i], v[i] = C @ self.a, reading - part.H @ self.a
                self.a = part.L @ self.a + K @ reading
        else:
            out, a = part.ahead().run(y, self.a)
            self.a = part.L @ a + K @ y[-1]
            v, self.predicted[rows] = y - out[:, : len(some)], out[:, len(some) :]
        variance = np.einsum("ij,ji->i", C, part.PC)
        self.variance[rows] = variance
        self.filtered[rows] = self.predicted[rows] + v @ CG.T
        self.filtered_variance[rows] = variance - np.einsum("ij,jk,ik->i", CG, part.S, CG)
        self.v[rows, some] = v
        if len(some):
            root = np.linalg.cholesky(part.S)
            white = np.linalg.solve(root, v.T).T
            self.white[rows, some] = white
            constant = len(some) * np.log(2 * np.pi) + 2 * np.sum(np.log(np.diag(root)))
            self.log_likelihood -= 0.5 * (constant * len(v) + float(np.sum(white**2)))
        self.stretches.append(part)

    def back(self) -> Smoothed:
        """The way back: what later readings add to each prediction."""
        n = len(self.a)
        estimates, variance = self.predicted, self.variance
        r, N = np.zeros(n), np.zeros((n, n))
        for part in reversed(self.stretches):
            rows, some = part.rows, part.some
            weighed = part.weighed
            v = self.v[rows][:, some]
            if part.short:
                for i in range(len(v) - 1, -1, -1):
                    r = v[i] @ weighed + r @ part.L
                    estimates[rows.start + i] += r @ part.PC
            else:
                added, r = part.back().run(np.vstack([np.zeros((1, len(some))), v[::-1]]), r)
                estimates[rows] += added[:0:-1]
            W = part.H.T @ weighed
            variance[rows] -= _told_later(part, W, N, len(v))
            N = propagated(part.L.T, W, N, len(v))
        return Smoothed(
            estimates,
            np.sqrt(np.maximum(variance, 0.0)),
            self.filtered,
            np.sqrt(np.maximum(self.filtered_variance, 0.0)),
            self.white,
            self.log_likelihood,
        )

    def estimates_of(self, readings: Float) -> Float:
        """Estimates of other readings by the same matrices, shape (k, n, n_estimates).

        Parameters
        ----------
        readings : ndarray, shape (k, n, n_sensors)
            Missing where those of the filter are.
        """
        y = np.ascontiguousarray(np.moveaxis(readings, 0, -1))
        v, estimates = np.zeros(y.shape), np.empty((*self.predicted.shape, len(readings)))
        a = np.zeros((len(self.a), len(readings)))
        for part in self.stretches:
            rows, some = part.rows, part.some
            if part.short:
                for row in range(rows.start, rows.stop):
                    estimates[row], reading = part.C @ a, y[row, some]
                    v[row, some] = reading - part.H @ a
                    a = part.L @ a + part.K @ reading
                continue
            ahead, own = part.ahead(), y[rows][:, some]
            for k, behind in enumerate(a.T.copy()):
                out, behind = ahead.run(own[..., k], behind)
                a[:, k] = part.L @ behind + part.K @ own[-1, :, k]
                v[rows, some, k] = own[..., k] - out[:, : len(some)]
                estimates[rows, :, k] = out[:, len(some) :]
        r = np.zeros(a.shape)
        for part in reversed(self.stretches):
            rows, some = part.rows, part.some
            if part.short:
                weighed = part.weighed.T
                for row in range(rows.stop - 1, rows.start - 1, -1):
                    r = weighed @ v[row, some] + part.L.T @ r
                    estimates[row] += part.PC.T @ r
                continue
            back, own = part.back(), v[rows][::-1, some]
            for k, later in enumerate(r.T.copy()):
                start = np.zeros((1, len(some)))
                added, r[:, k] = back.run(np.vstack([start, own[..., k]]), later)
                estimates[rows, :, k] += added[:0:-1]
        return np.moveaxis(estimates, -1, 0)


def _told_later(part: Stretch, W: Float, N: Float, count: int) -> Float:
    """By how much readings from each row on lower the variance of its prediction.

    The diagonal of C P N P Cᵀ with N ← W + Lᵀ N L, from `N` behind the last row.
    """
    told = np.empty((count, part.PC.shape[1]))
    M, within = part.PC, np.zeros(part.PC.shape[1])
    for k in range(count - 1, -1, -1):
        added = np.einsum("ij,ij->j", M, W @ M)
        M = part.L @ M
        behind = np.einsum("ij,ij->j", M, N @ M)
        within = within + added
        told[k] = within + behind
        if np.all(np.maximum(added, behind) <= REMAINDER * within):
            told[:k] = within
            break
    return told


def smooth(
    estimator: KalmanEstimator,
    time: Float,
    readings: Float,
    level: Sequence[float],
    initial: Initial = "rest",
    steps: Float | None = None,
    start: Float | None = None,
) -> Smoothed:
    """Fixed-interval smoothing of a whole record.

    Parameters
    ----------
    estimator : KalmanEstimator
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
        Relative to rest; NaN where a sensor has none.
    level : sequence of float, one for each drive
        How large a heat may be at the first row (a standard deviation) [unit of the drive].
    initial : {"rest", "settled", "free"}
        The machine is at rest, whatever heat acts from the first row on, has stood at that heat
        for long, or is in any state that such heat has left.
    steps : ndarray, shape (n, n_drives), optional
        Variance of a step of each heat that acts from a row on, beside its walk [unit of the
        drive, squared].
    start : ndarray, shape (m, m), optional
        Covariance of the state at the first reading; without it that of `initial` and the walk.

    Raises
    ------
    FitError
        The covariance of the estimate is not finite.
    """
    if not len(time):
        empty = np.empty((0, len(estimator.estimates)))
        return Smoothed(empty, empty, empty, empty, np.empty(readings.shape), 0.0)
    dt = float(time[1] - time[0]) if len(time) > 1 else 1.0
    P = estimator.start_covariance(dt, level, initial) if start is None else start
    return _filtered(estimator, time, readings, np.zeros(len(P)), P, steps).back()


def smoothed_estimates(
    estimator: KalmanEstimator,
    time: Float,
    readings: Float,
    level: Sequence[float],
    initial: Initial = "rest",
    steps: Float | None = None,
) -> Float:
    """Estimates of several records on one clock, shape (k, n, n_estimates); see `smooth`.

    The covariances are found once.

    Parameters
    ----------
    estimator, time, level, initial, steps
        As for `smooth`.
    readings : ndarray, shape (k, n, n_sensors)
        Missing in the same places.
    """
    dt = float(time[1] - time[0])
    P = estimator.start_covariance(dt, level, initial)
    forward = _filtered(estimator, time, readings[0], np.zeros(len(P)), P, steps)
    return forward.estimates_of(readings)


def predicted(
    estimator: KalmanEstimator,
    time: Float,
    readings: Float,
    state: Float,
    covariance: Float,
    steps: Float,
) -> tuple[Float, Float]:
    """The state at the last row and its covariance, from the readings of all rows before it.

    Parameters
    ----------
    estimator, time, readings, steps
        As for `smooth`; a step of the last row is in the covariance.
    state : ndarray, shape (n,)
        At the first row, before its reading,
    covariance : ndarray, shape (n, n)
        steps of that row not yet counted.

    Raises
    ------
    FitError
        The covariance of the estimate is not finite.
    """
    found = _filtered(estimator, time, readings, state, covariance, steps, len(time) - 1)
    heats = np.arange(estimator.modal, estimator.modal + len(estimator.drives))
    found.P[heats, heats] += steps[-1]
    return found.a, found.P


def _filtered(
    estimator: KalmanEstimator,
    time: Float,
    readings: Float,
    state: Float,
    covariance: Float,
    steps: Float | None,
    stop: int | None = None,
) -> _Filter:
    """The way forward, before row `stop` where that is given."""
    cuts = [] if stop is None else [stop]
    if steps is not None:
        cuts += np.flatnonzero(steps.any(axis=1)).tolist()
    forward = _Filter(len(estimator.estimates), readings, state, covariance.copy())
    heats = np.arange(estimator.modal, estimator.modal + len(estimator.drives))
    space_of = lru_cache(MAX_LENGTHS)(estimator.state_space)
    with np.errstate(over="ignore", invalid="ignore"):
        for rows, dt, some in even_rows(time, readings, cuts):
            if rows.start == stop:
                break
            if steps is not None:
                forward.P[heats, heats] += steps[rows.start]
            forward.run(rows, space_of(dt), some)
    return forward
