"""What a calibration knows of a response beyond its kind, and how surely.

No kind of response is exact. What is left of a calibration is explained by lags of the drives,
which all make as much a priori, by moves of the fitted parameters as far as the noise leaves them
open, and by white noise with a slow drift; sizes by marginal likelihood. Mean and covariance of
moves and weights are what later data have to contradict before a model counts as wrong (Kennedy &
O'Hagan 2001).

It is explained a second time beside a disturbance: a room that nobody logs warms a machine in a
smooth course, of which the parameters take up a part. One log hardly shows whether the kind is
wrong or the room's temperature changed. So the mean is that without the disturbance, and the
covariance covers both: of what later data have to contradict up to the largest disturbance that is
as likely as any, and of the parameters the likeliest one, where it is likelier than by chance.

The noise is that of signals/drift.py, with the same factors; but weights and moves are integrated
out beside it, which moves the maximum, and that is only looked for on a grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.calibration_posterior import CalibrationPosterior
from thermaltool.fitting.gaussian_columns import (
    beside,
    information_of,
    marginal,
)
from thermaltool.fitting.instants import Instants
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.signals.covariance_root import covariance_root
from thermaltool.signals.detrend import difference_sigma, find_outliers
from thermaltool.signals.row_groups import RowGroups

# Prior size of the most that a lag makes, in units of the white noise; drift over white, in
# variance; number of time constants of the drift: the grid of the marginal likelihood.
LAG_SIZES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
DRIFT_RATIOS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
DRIFT_TIMES = 5
# A disturbance bends at so many instants of a record, with so many rows at least to each, and in
# all records at so many together, though once in each. Prior sizes of what it makes at the end of
# the longest record, over the white noise; drift over white, in variance, beside it.
BENDS, ROWS_OF_A_BEND, MAX_BENDS = 16, 20, 96
DISTURBANCE_SIZES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
DRIFTS_BESIDE = (0.0, 0.03, 0.3, 3.0)
# 95 % limit of a profile of the likelihood.
AS_LIKELY = 1.92
# A calibration that leaves more than this many times the noise of a reading has an error of
# structure, and is no measure of what is wrong with a machine.
MAX_OVER_NOISE = 5.0
# Within so much of a reading's noise of the nearest all fits may be true, of one kind or another.
AS_NEAR = 1.0
# Instants at which kinds of response are compared; directions of their lags below this share of the
# largest are rounding.
SPREAD_INSTANTS, MIN_SPREAD_DIRECTION = 100, 1e-4


@dataclass(frozen=True)
class Discrepancy:
    """Posterior of parameter moves and lag weights.

    Attributes
    ----------
    mean : ndarray, shape (p + q,)
        Moves of the parameters (of logarithms, gains), then weights of the lags.
    covariance : ndarray, shape (p + q, p + q)
    white, drift : float
        Standard deviations of noise and of a discrepancy beside it [unit of the output], without
        a disturbance: a later log has one of its own.
    drift_time : float
        Time constant of the discrepancy [s].
    size : ndarray, shape (q,)
        Prior standard deviation of each lag's weight [unit of the output per unit of its drive].
    spread : ndarray, shape (m, q)
        Weights of the lags by which m other fits differ that come as near: of other kinds of
        response, or of one where drives share what they do in another way.
    instants : ndarray, shape (s,)
        How early each switch between the rows most likely is, over its standard deviation.
    confounded : ndarray, shape (f, f)
        Covariance that the f parameters of the fit have beside that of the noise, without lags: of
        the likeliest disturbance, and of what of it least squares took for the drives', as far as
        noise alone does not make it likely. Offsets are left out.
    """

    mean: Float
    covariance: Float
    white: float
    drift: float
    drift_time: float
    size: Float
    spread: Float
    instants: Float
    confounded: Float


@dataclass(frozen=True)
class _Level:
    """Sizes of what a residual is made of.

    Attributes
    ----------
    ratio : float
        Of drift over white noise, in variance.
    tau : float [s]
    disturbance, lags : float
        Prior standard deviations over the white noise.
    white : float [unit of the output]
    value : float
        Negative log marginal likelihood.
    """

    ratio: float
    tau: float
    disturbance: float
    lags: float
    white: float
    value: float


def calibration_error(fit: Mapping[str, Any]) -> float:
    """RMS that a model left of its calibration [unit of the output].

    Beside the instants of commands between the rows where these are part of the fit, else with the
    zero of each log free.

    Parameters
    ----------
    fit : mapping
        Of an output of a model file.
    """
    if "instants" in fit:
        return float(fit["instants"]["rmse"])
    return float(fit.get("rmse_zero_free", fit.get("rmse", 0.0)))


def discrepancy(
    time: Float,
    record: NDArray[np.int64],
    residual: Float,
    own: Float,
    free: Float,
    lags: Float,
    instants: Instants | None,
    gains: Float,
    levels: Float,
    spread: Float,
    fitted: Float,
) -> Discrepancy:
    """Posterior from the residual of a calibration.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    record : ndarray of int, shape (n,)
    residual : ndarray, shape (n,)
    own, free, lags : ndarray, shape (n, ·)
        Sensitivities to the parameters, columns without a prior (offsets), and lags of the drives
        in their units.
    instants : Instants, optional
        Of switches between the rows.
    gains : ndarray, shape (g,) [unit of the output per unit of a drive]
        Values of the last of the parameters; those before them are logarithms.
    levels : ndarray, shape (g + q,)
        Largest value of the drive of each gain and lag, for those that no row shows.
    spread : ndarray, shape (m, q)
        See `Discrepancy`.
    fitted : ndarray, shape (p, f)
        Zeros and ones: which parameter of the fit each one is, as several share a rate.
    """
    # The prior is one of what is seen, whatever the unit of a drive.
    level = _largest(lags, levels[len(gains) :])
    late = np.empty((len(residual), 0)) if instants is None else instants.columns
    left = residual if instants is None else instants.left(residual, np.ones(len(residual)))
    # What stands alone is no noise, and would pass for much of it.
    kept = np.concatenate(
        [
            np.flatnonzero(record == k)[~find_outliers(own_rows, difference_sigma(own_rows))]
            for k in np.unique(record)
            for own_rows in [left[record == k]]
        ]
    )
    time, record, residual = time[kept], record[kept], residual[kept]
    own, free, lags, late = own[kept], free[kept], (lags / level)[kept], late[kept]
    members = [record == k for k in np.unique(record)]
    groups = RowGroups.of([Record(time[each], {}) for each in members])
    assert groups is not None
    bends = _bends(time, members)
    table = np.column_stack([residual, own, lags, late, bends, free])
    rows, noise = groups.means([table[each] for each in members]), groups.noise
    p, q, m, w = own.shape[1], lags.shape[1], late.shape[1], bends.shape[1]
    sigma = max(difference_sigma(left[kept]), 1e-3 * float(np.std(residual)), 1e-12)
    tried: list[_Level] = []
    taus = np.geomspace(5 * noise.period, max(noise.span / 2, 10 * noise.period), DRIFT_TIMES)
    for ratio in DRIFT_RATIOS:
        for tau in taus.tolist() if ratio else taus[:1].tolist():
            factor = noise.factor(ratio, tau)
            # Beside the instants, whose prior is the same all over the grid.
            whole, cost = beside(rows.T @ factor.solve(rows), 1 + p + q, m, 1 / sigma)
            for disturbance in (0.0, *DISTURBANCE_SIZES * (ratio in DRIFTS_BESIDE)):
                gram, logdet = beside(whole, 1 + p + q, w, disturbance)
                for size in LAG_SIZES:
                    prior = information_of(len(gram) - 1, p, (q, size))
                    given = factor.logdet + cost + logdet
                    value, white = marginal(gram, given, len(rows), prior)
                    tried.append(_Level(ratio, tau, disturbance, size, white, value))
    span = _sizes(own, gains, levels[: len(gains)])
    still = min((level for level in tried if not level.disturbance), key=attrgetter("value"))
    limit = min(level.value for level in tried) + AS_LIKELY
    as_likely = [level for level in tried if level.value <= limit]
    likeliest = min((level for level in tried if level.disturbance), key=attrgetter("value"))
    disturbed = max(as_likely, key=lambda e: (e.disturbance * e.white, -e.value))
    linear = _linear_moves(own * span, still.white)

    # Two or all of the three are often one.
    @cache
    def posterior(at: _Level) -> CalibrationPosterior:
        gram = rows.T @ noise.factor(at.ratio, at.tau).solve(rows)
        sizes = (q, at.lags), (m, 1 / at.white), (w, at.disturbance)
        return CalibrationPosterior.of(gram, at.white, fitted, span, linear, sizes)

    first, second, third = (posterior(at) for at in (still, disturbed, likeliest))
    share = _share(disturbed.value - still.value)
    shift = second.mean - first.mean
    covariance = (1 - share) * first.covariance
    covariance += share * (second.covariance + np.outer(shift, shift))
    # The fit itself stands at zero.
    root = covariance_root(third.covariance_alone - first.covariance_alone)
    widened = root @ root.T + np.outer(third.mean_alone, third.mean_alone)
    # Noise alone makes so much of it likely.
    confounded = _share(likeliest.value - still.value + AS_LIKELY) * widened
    unit = np.append(np.ones(p), level)
    lag_size = np.sqrt(
        (1 - share) * (still.white * still.lags) ** 2
        + share * (disturbed.white * disturbed.lags) ** 2
    )
    return Discrepancy(
        first.mean / unit,
        covariance / np.outer(unit, unit),
        still.white,
        still.white * float(np.sqrt(still.ratio)),
        still.tau,
        lag_size / level,
        spread,
        first.instants,
        confounded,
    )


def spread(
    rates: Float, lags: NDArray[np.int64], duration: float, others: Sequence[Float], own: Float
) -> Float:
    """What other fits differ by that come as near, as weights of lags, shape (m, drives · lags).

    Of rates slower than the longest record a log shows what the lags can stand for.

    Parameters
    ----------
    rates : ndarray, shape (n,) [1/s]
    lags : ndarray of int
        Which of them are lags.
    duration : float [s]
        Of the longest record.
    others : sequence of ndarray, shape (drives, n)
        Weights of the rates, of every drive.
    own : ndarray, shape (drives · n,)
        Of the fit that was taken.
    """
    time = np.geomspace(1 / rates[-1], duration, SPREAD_INSTANTS)
    steps = -np.expm1(-np.outer(time, rates))
    inverse = np.linalg.pinv(steps[:, lags], rcond=MIN_SPREAD_DIRECTION)
    here = own.reshape(-1, len(rates))
    differ = np.reshape(others, (len(others), *here.shape)) - here
    return np.asarray((differ @ steps.T @ inverse.T).reshape(len(others), len(here) * len(lags)))


def _share(above: float) -> float:
    """Of a disturbance, by its negative log likelihood above that of none.

    One half at most even where it is the likelier one: an error of shape passes for a disturbance.
    """
    return float(min(0.5, 1 / (1 + np.exp(above))))


def _bends(time: Float, members: Sequence[NDArray[np.bool_]]) -> Float:
    """Courses that bend once in a record, shape (n, bends): an integrated random walk together.

    Of one prior size they make that size at the end of the longest record, and less in shorter
    ones, as a walk does.
    """
    longest = max(float(np.ptp(time[own])) for own in members)
    rows = min(int(np.sum(own)) for own in members)
    each = max(1, min(BENDS, MAX_BENDS // len(members), rows // ROWS_OF_A_BEND))
    ahead = 1.0 - np.arange(each) / each
    found = np.zeros((len(time), len(members) * each))
    for k, own in enumerate(members):
        since, length = time[own] - time[own][0], float(np.ptp(time[own]))
        share = since / max(length, 1e-300)
        ramps = np.maximum(share[:, None] + ahead - 1.0, 0.0) / np.sqrt(np.sum(ahead**2))
        height = (length / max(longest, 1e-300)) ** 1.5
        found[np.flatnonzero(own)[:, None], k * each + np.arange(each)] = height * ramps
    return found


def _largest(columns: Float, levels: Float) -> Float:
    """Largest absolute value of each column; that of its drive where no row shows any."""
    largest = np.max(np.abs(columns), axis=0, initial=0.0)
    return np.where(largest > 0, largest, levels)


def _sizes(own: Float, gains: Float, levels: Float) -> Float:
    """Size of each parameter, shape (p,): one for a logarithm, of a gain what it makes at most.

    All gains make as much as the strongest, whatever the units of their drives.
    """
    first = own.shape[1] - len(gains)
    makes = _largest(own[:, first:], levels)
    most = max(float(np.max(makes * np.abs(gains), initial=0.0)), 1e-300)
    return np.append(np.ones(first), most / makes)


def _linear_moves(makes: Float, white: float) -> Float:
    """Moves [1] whose second order is no more than the noise, shape (p,).

    Of a rate by its logarithm, or of a gain beside one, it is about half of the square of the move
    times what the parameter makes, column by column.
    """
    size = np.sqrt(np.mean(np.square(makes), axis=0))
    return np.asarray(np.sqrt(2 * white / np.maximum(size, 1e-300)))
