"""Size of the heat's random walk, and of the sensors' noise, by maximum likelihood from a record.

The readings themselves say how fast their heat changes: innovations of the steady Kalman filter
are white with the variance that it predicts where walk, drift and white noise are right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from thermaltool.errors import FitError, LogError, counted
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.estimation.start import Initial
from thermaltool.estimation.state_space import StateSpace
from thermaltool.record import Rows
from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import CLOCK_STEP, uniform_spans

# The search is a simplex of these first steps [factors on a logarithmic scale] ...
FIRST_STEP, SIZE_TOLERANCE, VALUE_TOLERANCE, MAX_EVALUATIONS = 1.0, 0.03, 0.02, 300
# Drift and its time stay near what `noise` has measured unless the record says otherwise: the
# standard deviation of their logarithm [1].
DRIFT_PRIOR, DRIFT_TIME_PRIOR = 2.0, 1.0
# A clock of more stretches than these has its steps rounded to whole periods: sizes do not depend
# on what is lost, and every length costs a steady covariance at every trial.
MAX_STRETCHES = 32
# Spans of fewer rows are walked through.
SHORT_SPAN = 32
# A longer sample, over the usual one [1], is a gap over which nothing is known of the heat.
# Where there are more of them than these they are samples as others: each costs a start.
MAX_GAP, MAX_GAPS = 10.0, 8
# Fewer readings tell no sizes.
MIN_READINGS = 20


@dataclass(frozen=True)
class FittedSizes:
    """A Kalman form with the sizes that a record tells.

    Attributes
    ----------
    estimator : KalmanEstimator
    log_likelihood : float
        Of the readings in the steady filter [nats].
    """

    estimator: KalmanEstimator
    log_likelihood: float


def fit_sizes(
    estimator: KalmanEstimator,
    time: Float,
    readings: Float,
    pinned: bool = False,
    initial: Initial = "rest",
    level: Sequence[float] = (),
) -> FittedSizes:
    """Walk, white noise and drift at the maximum of the likelihood.

    The walk of every drive is searched, and one factor each for the drifts, their time constants
    and the white noise of all sensors: the ratios between sensors are those that were measured.

    Parameters
    ----------
    estimator : KalmanEstimator
        Where the search begins.
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
        Relative to rest; rows with NaN do not count.
    pinned : bool
        The walk is given; noise alone is searched, and stays as it is where rows are too few.
    initial : {"rest", "settled", "free"}
        The machine at the first row: what a warm one does there is no noise.
    level : sequence of float, one for each drive
        Where it is not at rest: how large a heat may be there [unit of the drive].

    Raises
    ------
    LogError
        Where the walk is not given: fewer than `MIN_READINGS` rows with a reading of every sensor,
        a sensor that stands still.
    FitError
        No sizes with a finite likelihood.
    """
    # Slow to import, and the stream needs none of it.
    from scipy.optimize import minimize

    known = np.asarray(np.isfinite(readings).all(axis=1))
    if np.sum(known) < MIN_READINGS and pinned:
        return FittedSizes(estimator, 0.0)
    if np.sum(known) < MIN_READINGS:
        raise LogError(
            f"{counted(int(np.sum(known)), 'row')} with a reading of every sensor: too few to tell "
            "how fast the heat changes; pin it with --walk"
        )
    initial = _first(estimator, known, initial, level)
    time, readings = _counted(time[known]), readings[known]
    for name, still in zip(estimator.sensors, np.ptp(readings, axis=0) == 0, strict=True):
        if still and not pinned:
            raise LogError(f"{name} reads the same in every row: a sensor that is stuck tells no "
                           "heat; design for the others alone (regularize --sensor)")  # fmt: skip
    # What follows the heat has no reading, and no part in the likelihood.
    sensed = replace(estimator, outputs=(), followed=())

    def at(theta: Float) -> tuple[float, float]:
        """Minus the logarithm of the likelihood, and the variance that all sizes are scaled by."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                squares, logs = _innovations(
                    _with(sensed, theta, 1.0, pinned), time, readings, initial, level
                )
        except (FitError, np.linalg.LinAlgError):
            return np.inf, 1.0
        if not np.isfinite(squares + logs):
            return np.inf, 1.0
        count = readings.size
        prior = (theta[-2] / DRIFT_PRIOR) ** 2 + (theta[-1] / DRIFT_TIME_PRIOR) ** 2
        # With all sizes free their common scale is known in closed form.
        scale = 1.0 if pinned else squares / count
        value = 0.5 * (count * np.log(2 * np.pi * scale) + squares / scale + logs + prior)
        return value if np.isfinite(value) else np.inf, scale

    start = np.zeros((1 if pinned else len(estimator.walk)) + 2)
    simplex = np.vstack([start, start + FIRST_STEP * np.eye(len(start))])
    found: Any = minimize(  # type: ignore[call-overload]
        lambda theta: at(theta)[0], start, method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": SIZE_TOLERANCE, "fatol": VALUE_TOLERANCE,
                 "maxfev": MAX_EVALUATIONS},
    )  # fmt: skip
    value, scale = at(found.x)
    if not np.isfinite(value):
        raise FitError("no size of the heat's changes has a likelihood; pin it with --walk")
    return FittedSizes(_with(estimator, found.x, scale, pinned), -value)


def log_likelihood(
    estimator: KalmanEstimator,
    time: Float,
    readings: Float,
    initial: Initial = "rest",
    level: Sequence[float] = (),
) -> float:
    """Logarithm of the likelihood of a record in a steady filter [nats].

    Parameters
    ----------
    estimator, time, readings, initial, level
        As for `fit_sizes`.

    Raises
    ------
    LogError
        Fewer than `MIN_READINGS` rows with a reading of every sensor.
    FitError
        The filter has no steady state.
    """
    known = np.asarray(np.isfinite(readings).all(axis=1))
    if np.sum(known) < MIN_READINGS:
        raise LogError(
            f"{counted(int(np.sum(known)), 'row')} with a reading of every sensor: too few"
        )
    read, initial = readings[known], _first(estimator, known, initial, level)
    squares, logs = _innovations(estimator, _counted(time[known]), read, initial, level)
    return -0.5 * float(squares + logs + read.size * np.log(2 * np.pi))


def _with(estimator: KalmanEstimator, theta: Float, scale: float, pinned: bool) -> KalmanEstimator:
    """An estimator with other sizes.

    Logarithms of the factors on walks (where these are given: on the white noise), on drifts and
    on drift times.
    """
    root = float(np.sqrt(scale))
    drift, drift_time = np.exp(theta[-2:]).tolist()
    white = root * float(np.exp(theta[0])) if pinned else root
    walk = estimator.walk
    if not pinned:
        walk = tuple((root * np.exp(theta[:-2]) * walk).tolist())
    noise = tuple(
        SensorNoise(white * each.white, root * drift * each.drift, drift_time * each.drift_time)
        for each in estimator.noise
    )
    return replace(estimator, walk=walk, noise=noise)


def _counted(time: Float) -> Float:
    """The clock, or where it is uneven throughout, its steps in whole median periods."""
    if sum(1 for _ in uniform_spans(time)) <= MAX_STRETCHES:
        return time
    steps = np.diff(time)
    period = float(np.median(steps))
    whole = period * np.maximum(np.round(steps / period), 1.0)
    return np.concatenate([[0.0], np.cumsum(whole)])


@dataclass(frozen=True)
class _SteadyFilter:
    """The steady filter over one length of sample: its gain, covariance of innovations, predictor.

    ``log_determinant`` is that of the covariance.
    """

    space: StateSpace
    G: Float
    S: Float
    predictor: Recursion
    log_determinant: float

    @staticmethod
    def of(space: StateSpace) -> _SteadyFilter:
        P = space.predicted()
        S = space.H @ P @ space.H.T + space.R
        G = space.filter_gain(P)
        K = space.F @ G
        predictor = Recursion(space.F - K @ space.H, K, np.zeros_like(K), space.H)
        return _SteadyFilter(space, G, S, predictor, float(np.linalg.slogdet(S)[1]))


def _first(
    estimator: KalmanEstimator, known: Rows, initial: Initial, level: Sequence[float]
) -> Initial:
    """The machine at the first row that is known: before it, it may have done anything."""
    return initial if known[:1].all() or not _may_be_warm(estimator, level) else "free"


def _may_be_warm(estimator: KalmanEstimator, level: Sequence[float]) -> bool:
    """Whether a state that is not known has a covariance."""
    if not level:
        return False
    F = estimator.state_space(1.0).F[: estimator.modal, : estimator.modal]
    return not len(F) or float(np.max(np.abs(np.linalg.eigvals(F)))) < 1.0


def _innovations(
    estimator: KalmanEstimator,
    time: Float,
    readings: Float,
    initial: Initial,
    level: Sequence[float],
) -> tuple[float, float]:
    """Sum of the whitened innovations' squares, and of their covariances' log determinants."""
    squares, logs, x = 0.0, 0.0, None
    # On an uneven clock stretches are many, lengths of a sample few.
    steady = cache(lambda ticks: _SteadyFilter.of(estimator.state_space(ticks * CLOCK_STEP)))
    innovations: dict[int, tuple[_SteadyFilter, list[Float]]] = {}
    steps, begins = np.diff(time), initial
    gap = MAX_GAP * float(np.median(steps)) if len(steps) else np.inf
    parted = 0 < np.count_nonzero(steps > gap) <= MAX_GAPS and _may_be_warm(estimator, level)
    for rows, dt in uniform_spans(time):
        if parted and dt > gap:
            # Nobody knows what the heat did: the machine begins anew, as warm as it may be.
            x, begins = None, "free"
            continue
        known = steady(max(round(dt / CLOCK_STEP), 1))
        space = known.space
        if x is None and begins != "rest":
            start = estimator.start_covariance(dt, level, begins)
            first = EvenSmoother(space, start, rows.stop - rows.start)
            state, more = first.start(readings[rows])
            squares += more
            logs += first.log_determinant
            predictor = Recursion(first.L, first.K, np.zeros_like(first.K), first.H)
            a = predictor.run(readings[rows], state)[1]
            x = a + space.filter_gain(first.P) @ (readings[rows][-1] - space.H @ a)
            continue
        G, predictor = known.G, known.predictor
        # The row that two spans share belongs to the earlier one: its sample ends there.
        y = readings[rows] if x is None else readings[rows][1:]
        a = np.zeros(len(space.F)) if x is None else space.F @ x
        if len(y) < SHORT_SPAN:
            v = np.empty(y.shape)
            for k, reading in enumerate(y):
                a = a if not k else predictor.F @ a + predictor.G0 @ y[k - 1]
                v[k] = reading - space.H @ a
        else:
            seen, a = predictor.run(y, a)
            v = y - seen
        x = a + G @ v[-1]
        innovations.setdefault(id(known), (known, []))[1].append(v)
    for known, several in innovations.values():
        v = np.concatenate(several)
        squares += float(np.sum(v * np.linalg.solve(known.S, v.T).T))
        logs += len(v) * known.log_determinant
    return squares, logs
